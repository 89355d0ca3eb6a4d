"""Ask the program and a peer what changed, and compare the answers with the truth.

Silence about a change is a miss. A name is right if it is the true effect and joints,
or if the answer itself says that the logs cannot tell the two apart.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from time import process_time

import numpy as np

from benchmarks.changes_parts import arms, draw, peer, real
from benchmarks.harness.cases import guarded
from benchmarks.hidden.score import Claim, Name, deviation, matched, members
from benchmarks.measured_parts import arms as measured
from residual.diagnosis.diagnose import diagnose
from residual.effects import number_reported_joints
from residual.errors import ModelgapError
from residual.recording import Recording
from residual.robot.robot import Robot
from tests.synthetic.amounts import find_main_parameter

# Effects whose parameters no log tells by themselves: no size is compared.
_NO_SIZE = ("presliding", "warmup")
# Torques that a drive reports in its own unit: a scale error of all torque it reports
# scales these too, and no log can tell.
_LEVELS = ("coulomb", "stribeck", "coulomb_asymmetry", "presliding", "warmup")
_RATES = ("viscous", "viscous_asymmetry", "quadratic_viscous")
_IN_TORQUE = {
    **dict.fromkeys(_LEVELS, ("level",)),
    **dict.fromkeys(_RATES, ("coefficient",)),
    **dict.fromkeys(("position_friction", "balancer"), ("cos", "sin")),
    "offset": ("torque",),
    "spring": ("stiffness",),
    "ripple": ("amplitude",),
    "rotor_inertia": ("inertia",),
    "coupled_friction": ("level", "coefficient"),
}
PROGRAM, PEER = "program", "peer"
GROUPS, jobs = draw.GROUPS, draw.jobs


@dataclass(frozen=True, slots=True)
class Answer:
    """What a method says of two epochs."""

    claims: tuple[Claim, ...] = ()  # the most important first
    flagged: tuple[int, ...] = ()  # joints with a change that it has no name for
    seconds: float = 0.0  # processor time [s]
    # Friction of all joints over the first epoch's, and its standard deviation
    factor: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Logs:
    """The logs of a case, with the truth."""

    robot: Robot
    first: tuple[Recording, ...]
    second: tuple[Recording, ...]
    held_out: tuple[Recording, ...]
    # Name and parameters of the change, in the torque that the drives report
    truth: tuple[Name, Mapping[str, float]] | None
    factor: float | None  # friction of the second epoch over the first, by warmth


def record(slot: draw.Slot) -> tuple[arms.Case, Logs]:
    case = draw.draw(slot)
    if slot.group in (draw.REAL_UNCHANGED, draw.LOAD):
        robot = measured.robot_of(case.arm)
        first, second = (
            tuple(real.read(case.arm, part) for part in parts)
            for parts in (case.first, case.second)
        )
        load = Name("payload", (robot.dof,)), {"mass": real.LOAD_MASS}
        truth = load if slot.group == draw.LOAD else None
        return case, Logs(robot, first, second, (), truth, None)
    robot = arms.robot_of(case.arm)
    first, second = (arms.record(case, e) for e in (arms.FIRST, arms.SECOND))
    count, truth = len(case.second), None
    if case.effect:
        effect, values = case.effect, dict(case.effect.parameters)
        for key in _IN_TORQUE.get(effect.name, ()):
            values[key] *= float(arms.reported(case)[effect.joints[0] - 1])
        # The torque of a sum over a pair acts on the first joint.
        joints = effect.joints[:1] if effect.name == "x_cogging_sum" else effect.joints
        if not effect.name.startswith("x_"):
            joints = number_reported_joints(effect.name, joints, robot.dof)
        truth = Name(effect.name, tuple(sorted(joints))), values
    factor = arms.warmed(case) if slot.group == draw.DRIFT else None
    return case, Logs(robot, first, second[:count], second[count:], truth, factor)


def run(slot: draw.Slot) -> dict:
    """Ask the program and the peer about one case; a row for each."""
    return guarded(asdict(slot), lambda: _rows(slot))


def _rows(slot: draw.Slot) -> dict:
    case, logs = record(slot)
    effect = case.effect.name if case.effect else ""
    about = asdict(slot) | {
        "arm": case.arm,
        "dof": logs.robot.dof,
        "effect": effect,
        "size": case.size,
        "true_factor": logs.factor,
    }
    rows = []
    for method, ask in ((PROGRAM, ask_program), (PEER, ask_peer)):
        try:
            answer, refused = ask(logs), ""
        except ModelgapError as error:  # logs that are too short
            answer, refused = Answer(), str(error)
        row = {"method": method, "refused": refused} | about
        rows.append(row | compare(logs.truth, answer))
    return {"rows": rows}


def ask_program(logs: Logs) -> Answer:
    start = process_time()
    verdict = diagnose(logs.robot, logs.second, logs.first, logs.held_out).verdict
    seconds, drift = process_time() - start, verdict.drift
    factor = None if drift is None else (float(drift.factor), float(drift.std))
    flagged = tuple(verdict.unexplained.joints)
    return Answer(tuple(members(verdict)), flagged, seconds, factor)


def ask_peer(logs: Logs) -> Answer:
    """Ask the peer, which names one effect at most."""
    start = process_time()
    best = peer.find_change(logs.robot.model, logs.first, logs.second)
    seconds = process_time() - start
    if best is None:
        return Answer(seconds=seconds)
    joints = (best.joint,) if best.joint else ()
    if best.name == "payload":
        joints = (logs.robot.dof,)
    values = {"mass": (float(best.estimate[0]), None)}
    return Answer((Claim(Name(best.name, joints), (), values),), (), seconds)


def compare(truth: tuple[Name, Mapping] | None, answer: Answer) -> dict:
    # What has no name cannot be named rightly.
    named = [truth[0]] if truth and not truth[0].effect.startswith("x_") else []
    hits, _, extra = matched(named, answer.claims)
    first = answer.claims[0] if answer.claims else None
    return {
        "truth": [[n.effect, list(n.joints)] for n in ([truth[0]] if truth else [])],
        "names": [[c.name.effect, list(c.name.joints)] for c in answer.claims],
        "right_first": first is not None and all(first is not c for c in extra),
        "extra": [c.name.effect for c in extra],
        "flagged": list(answer.flagged),
        "flagged_right": bool(truth and {*truth[0].joints} & {*answer.flagged}),
        "seconds": round(answer.seconds, 3),
        "factor": answer.factor,
        **(_estimate(truth, hits[0]) if named else {}),
    }


def _estimate(truth: tuple[Name, Mapping], claim: Claim | None) -> dict:
    """Return the main parameter of the change, where its very name is stated."""
    key = find_main_parameter(truth[0].effect, truth[1])
    value, std = claim.values.get(str(key), (None, None)) if claim else (None, None)
    true = float(truth[1][key]) if key else None
    sized = std and np.isfinite(std) and truth[0].effect not in _NO_SIZE
    z = deviation(claim, truth[1]) if sized else None
    return {"key": key, "value": value, "true": true, "z": z}


def summary(result: Mapping) -> str:
    lines = []
    for row in result["rows"]:
        names = "; ".join(f"{n} {j}" for n, j in row["names"]) or "nothing"
        truth = "; ".join(f"{n} {j}" for n, j in row["truth"]) or "nothing"
        lines.append(f"{row['method']} {truth} -> {names} ({row['seconds']:.1f} s)")
    return "; ".join(lines)
