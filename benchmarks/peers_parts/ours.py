"""Our own program on an exported case: `modelgap diagnose` of its fit logs.

The last quarter of the longest log is its proof, as always where no log is held out.
"""

import json

import numpy as np

import modelgap as mg
from benchmarks.peers_parts.opened import Answer, Case, Log
from flows.blind.score import Said, members
from residual.recording import Recording
from residual.robot.robot import Robot, robot_from_texts


def answer(case: Case) -> Answer:
    """Return what the diagnosis says."""
    text = json.dumps(case.declared, sort_keys=True)
    robot = robot_from_texts(case.entry["robot"], case.urdf, text)
    fit = [_recording(robot, name, log) for name, log in case.logs("fit").items()]
    found = mg.diagnose(robot, fit, trust_log=True)
    said = members(found.verdict)
    left = list(found.verdict.unexplained.joints)
    model, predictions = found.models["augmented"], {}
    for name, log in case.logs("held_out").items():
        predictions[name] = model.predict(_recording(robot, name, log))
    for k, one in enumerate(said, start=1):
        without = model.without(one.name.effect, one.name.joints or None)
        for name, log in case.logs("after").items():
            recording = _recording(robot, name, log)
            predictions[f"finding_{k}_{name}"] = without.predict(recording)
    unknown = left or found.verdict.verdict == "unknown"
    return Answer(tuple(map(_finding, said)), unknown, predictions)


def _recording(robot: Robot, name: str, log: Log) -> Recording:
    # A torque that is to be predicted is not looked at.
    tau = np.zeros_like(log.q) if log.tau is None else log.tau
    return Recording(name, robot.name, log.t, log.q, tau)


def _finding(said: Said) -> dict:
    near = [{"effect": n.effect, "joints": list(n.joints)} for n in said.alike]
    out = {"effect": said.name.effect, "joints": list(said.name.joints), "or": near}
    sure = said.finding.probability
    return out | ({} if sure is None else {"confidence": sure})
