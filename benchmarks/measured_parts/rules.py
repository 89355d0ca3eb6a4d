"""The rules by which a name may fall, each with a switch; and what is said without it.

The switches replace functions of the diagnosis in this process alone: no product code
knows of them.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from types import ModuleType
from unittest.mock import patch

from benchmarks.changes_parts.ask import make
from benchmarks.changes_parts.case import Case
from benchmarks.measured_parts.arms import KR300, LWR4, SPLITS, UR10, UR10E, read_split
from residual.diagnosis import angle_noise, conclude, examine, held_out, standing
from residual.diagnosis.result import Verdict
from residual.method import diagnose
from residual.recording import Recording
from residual.robot.robot import Robot

NONE, SPLIT = "none", "measured_split"
CLEAN = "clean"
# What a simulated arm in use has on every joint (sim/background), and names that are
# forms of it: friction that leans to one side is a constant while a joint moves.
HAS = {
    "stribeck",
    "presliding",
    "coulomb_asymmetry",
    "offset",
    "viscous_asymmetry",
    "quadratic_viscous",
    "position_friction",
    "load_friction",
    "warmup",
    "ripple",
    "elasticity",
    "torque_gain",
    "delay",
    "coulomb",
    "viscous",
}
# What is known of measured arms: docs of their logs, and what every split says alike.
KNOWN = {
    (UR10E, "load_friction"),
    (KR300, "balancer"),
    (KR300, "spring"),
    (UR10, "offset"),
    (UR10, "load_friction"),
    (LWR4, "offset"),
    (LWR4, "balancer"),
    (LWR4, "ripple"),
}


@dataclass(frozen=True, slots=True)
class Job:
    """One case, or one split of measured logs."""

    case: Case | None = None
    split: str = ""

    @property
    def name(self) -> str:
        """What it is called."""
        return self.case.name if self.case else self.split


def ask(job: Job) -> list[dict]:
    """Return a row for every rule that is switched off, and one with all on."""
    robot, fit, proof, truth = _logs(job)
    arm = job.case.arm if job.case else SPLITS[job.split].arm
    used = job.case is not None and job.case.background not in ("", CLEAN)
    rows, found = [], _Once(examine._search)
    for rule in (NONE, *RULES):
        with _searched_once(found), _without(rule):
            verdict = diagnose.diagnose(robot, fit, (), proof).verdict
        counts = _counted(
            verdict, truth, lambda n: (arm, n) in KNOWN or (used and n in HAS)
        )
        rows.append({"case": job.name, "rule": rule, **counts})
    return rows


def _logs(
    job: Job,
) -> tuple[Robot, list[Recording], list[Recording], list[tuple[str, tuple[int, ...]]]]:
    if job.case is None:
        robot, logs = read_split(SPLITS[job.split])
        return robot, logs["fit"], logs["held_out"], []
    made = make(job.case)
    truth = [(t.name, tuple(t.joints)) for t in made.truth]
    return made.robot, list(made.second), list(made.held_out), truth


def _counted(verdict: Verdict, truth, has: Callable[[str], bool]) -> dict:
    """Names, counted joint by joint: planted, otherwise true, false."""
    planted = true = false = 0
    for effect in verdict.effects:
        others = [(effect.name, effect.joints)]
        others += [(a.name, a.joints) for a in effect.equivalent]
        hit = [
            len(joints) or 1
            for name, joints in truth
            if any(name == n and set(joints) <= set(js) for n, js in others)
        ]
        many = len(effect.joints) or 1
        planted += sum(hit)
        rest = many - sum(hit)
        if has(effect.name):
            true += many
        else:
            true, false = true + sum(hit), false + max(rest, 0)
    return {
        "planted": planted,
        "true": true,
        "false": false,
        "said": [[e.name, list(e.joints)] for e in verdict.effects],
    }


# -- the switches ----------------------------------------------------------------------

Switch = tuple[ModuleType, str, Callable]


def _nothing(*_: object) -> list:
    return []


def _no_noise(examined, judged, recordings):
    if not judged.kept:
        return judged, None, ()
    return judged, angle_noise.checked(examined, judged.fit, recordings), ()


_gains = held_out._gains

RULES: dict[str, tuple[Switch, ...]] = {
    "resembles": ((examine, "_resembles", lambda *_: False),),
    "only_curves": ((examine, "only_curves", _nothing),),
    "wrong_form": ((examine, "wrong_forms", _nothing),),
    "angle_noise": ((standing, "drop_noise", _no_noise),),
    "unlikely_or_nothing": ((standing, "_weak", _nothing),),
    "refuted": (
        (held_out, "_gains", lambda *a: [max(gain, 0.0) for gain in _gains(*a)]),
    ),
    "harms_the_arm": ((standing, "harmful", _nothing),),
    "substitutes": ((standing, "substitutes", _nothing),),
}


@contextmanager
def _without(rule: str) -> Iterator[None]:
    with ExitStack() as stack:
        for module, name, instead in RULES.get(rule, ()):
            stack.enter_context(patch.object(module, name, instead))
        # What is not asked here costs most of the time.
        stack.enter_context(patch.object(conclude, "minimum_detectable", _nothing))
        stack.enter_context(patch.object(diagnose, "_hint", lambda case: None))
        yield


class _Once:
    """A function whose answers are kept by how often it was asked."""

    def __init__(self, work: Callable) -> None:
        self._work, self._known = work, []
        self.asked = 0

    def __call__(self, *arguments: object) -> object:
        if self.asked == len(self._known):
            self._known.append(self._work(*arguments))
        self.asked += 1
        return self._known[self.asked - 1]


@contextmanager
def _searched_once(found: _Once) -> Iterator[None]:
    """The search by evidence knows none of the rules, and is the same for all."""
    found.asked = 0
    with patch.object(examine, "_search", found):
        yield
