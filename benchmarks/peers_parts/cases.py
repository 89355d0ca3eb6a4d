"""Cases of each program: what it answers on an exported study, and if it is so.

Ours is `modelgap diagnose` of the fit logs of a case. The last quarter of the longest
log is its proof, as always where no log is held out.
"""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from time import perf_counter

import numpy as np

import modelgap as mg
from benchmarks.harness.cases import guarded
from benchmarks.peers_parts import sparse, squares
from benchmarks.peers_parts.opened import Answer, Case, Log
from flows.blind.export import score
from flows.blind.export.write import OPEN, SEALED
from flows.blind.score import Said, members
from residual.recording import Recording
from residual.robot.robot import Robot, robot_from_texts


def answer(case: Case) -> Answer:
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


PROGRAMS: Mapping[str, Callable[[Case], Answer]] = {
    "ours": answer,
    "squares": squares.answer,
    "sparse": sparse.answer,
}


@dataclass(frozen=True, slots=True)
class Task:
    """One case for one program."""

    program: str
    seed: int
    case: str
    folder: str

    @property
    def name(self) -> str:
        """Key of the result."""
        return f"{self.seed} {self.case} {self.program}"


def names(folder: Path) -> list[str]:
    content = json.loads((folder / OPEN / "cases.json").read_text(encoding="utf-8"))
    return list(content["cases"])


def run(task: Task) -> dict:
    """Let a program answer, then open the truth; of a crash the error."""
    about = {k: v for k, v in asdict(task).items() if k != "folder"}
    return guarded(about, lambda: about | _done(task))


def _done(task: Task) -> dict:
    folder = Path(task.folder)
    begun = perf_counter()
    found = PROGRAMS[task.program](Case(folder / OPEN, task.case))
    seconds = round(perf_counter() - begun, 2)
    own = folder.parent / "answers" / folder.name / task.program / task.case
    found.write(own)
    truth = _truth(folder)
    true, known = truth["cases"][task.case], truth["classes"]
    answer = score.read_answer(task.case, found.entry, known)
    sealed = folder / SEALED / task.case
    row = score.judged(true, answer, known)
    return {
        "answered": True,
        "seconds": seconds,
        **row,
        **score.torque_ratios(true, answer, known, (sealed, own)),
        "hidden": [[e["effect"], e["joints"]] for e in true["effects"]],
        "said": found.entry,
        "outcome": _outcome(row["levels"]),
    }


@lru_cache(maxsize=4)
def _truth(folder: Path) -> dict:
    return json.loads((folder / SEALED / "truth.json").read_text(encoding="utf-8"))


def _outcome(levels: Mapping) -> str:
    """One word for the log of a run: the finest level at which all is right."""
    right = (level for level in score.LEVELS if levels[level]["exact"])
    return next(right, "wrong")


def words(row: Mapping) -> str:
    if "outcome" not in row:
        return "done"
    hidden = "; ".join(f"{name} {on}" for name, on in row["hidden"]) or "nothing"
    found = row["said"]["findings"]
    said = "; ".join(f"{f['effect']} {f.get('joints', [])}" for f in found) or "nothing"
    left = f", unknown {row['said']['unknown']}" if row["flagged"] else ""
    return f"{row['outcome']}: {hidden} -> {said}{left} ({row['seconds']} s)"
