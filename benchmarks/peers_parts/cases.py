"""Cases of each program: what it answers on an exported study, and if it is so."""

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from time import perf_counter

from benchmarks.peers_parts import ours, sparse, squares
from benchmarks.peers_parts.opened import Answer, Case
from benchmarks.seeded import guarded
from flows.blind.export import score
from flows.blind.export.case import OPEN, SEALED

PROGRAMS: Mapping[str, Callable[[Case], Answer]] = {
    "ours": ours.answer,
    "squares": squares.answer,
    "sparse": sparse.answer,
}


@dataclass(frozen=True, slots=True)
class Task:
    """One case for one program.

    Attributes:
        program: One of PROGRAMS.
        seed: Seed of the study.
        case: Name of the case.
        folder: The exported study.
    """

    program: str
    seed: int
    case: str
    folder: str

    @property
    def name(self) -> str:
        """Key of the result."""
        return f"{self.seed} {self.case} {self.program}"


def names(folder: Path) -> list[str]:
    """Return the cases of an exported study."""
    content = json.loads((folder / OPEN / "cases.json").read_text(encoding="utf-8"))
    return list(content["cases"])


def run(task: Task) -> dict:
    """Let a program answer, then open the truth.

    Returns:
        A row as of the judge, with what was hidden and said; of a crash the error.
    """
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
    """Return one line on a case for the log of a run."""
    if "outcome" not in row:
        return "done"
    hidden = "; ".join(f"{name} {on}" for name, on in row["hidden"]) or "nothing"
    found = row["said"]["findings"]
    said = "; ".join(f"{f['effect']} {f.get('joints', [])}" for f in found) or "nothing"
    left = f", unknown {row['said']['unknown']}" if row["flagged"] else ""
    return f"{row['outcome']}: {hidden} -> {said}{left} ({row['seconds']} s)"
