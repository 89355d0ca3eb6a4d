"""Cases of each group: drawn, diagnosed, and compared with the truth."""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from time import perf_counter

from benchmarks.attribution_parts import arms
from benchmarks.harness.cases import guarded, named, seed_range
from benchmarks.hidden.score import Name, members, paired
from flows.specs import derive_seed
from residual.diagnosis.diagnose import diagnose
from residual.verdict.result import Place, Verdict
from sim.engine.plant_records import create_random_stream


def compare(verdict: Verdict, planted: Sequence[Name]) -> dict:
    """Compare the set of names with the set of changes.

    A name is true if it, or one that the verdict says the logs cannot tell from it, is
    among what changed and no other name stands for that already.
    """
    said = members(verdict)
    classes = [[s.name, *s.alike] for s in said]
    true = len(paired(planted, classes, lambda truth, own: truth in own))
    listed = [[n for place in one.set for n in _apart(place)] for one in verdict.alternatives]
    exact, wanted = len(said) == len(planted), sorted(map(str, planted))
    return {
        "said": [[_plain(n) for n in names] for names in classes],
        "true": true,
        "exact": exact and true == len(planted),
        "listed": any(sorted(map(str, one)) == wanted for one in listed),
        "unexplained": list(verdict.unexplained.joints),
    }


def _apart(place: Place) -> list[Name]:
    """One name per joint, as findings on several joints count."""
    if len(place.joints) < 2 or place.name == "coupled_friction":
        return [Name.of(place)]
    return [Name(place.name, (j,)) for j in sorted(place.joints)]


def _plain(name: Name) -> list:
    return [name.effect, list(name.joints)]


UNCHANGED, SETS = "unchanged", "sets"
GROUPS = (UNCHANGED, SETS)


@dataclass(frozen=True, slots=True)
class Task:
    """One case."""

    group: str
    arm: str  # "six" or "seven"
    off: int  # how far the given values are off [%]
    seed: int
    quick: bool = False  # whether its logs are few and short

    @property
    def name(self) -> str:
        """What its draws are called by."""
        return " ".join(str(part) for part in asdict(self).values())

    @property
    def drawn_arm(self) -> arms.Arm:
        """The arm with its noise."""
        noise = derive_seed(self.seed, f"noise/{self.name}")
        # Arms whose values are off by more are other arms: a case is a draw.
        seed = derive_seed(self.seed, f"arm/{self.arm}/{self.off}")
        return arms.Arm(self.arm, self.off / 100, seed, noise, self.quick)


def jobs(args: argparse.Namespace) -> dict[str, Task]:
    """Return the cases; a quick run has one arm a group, in few and short logs."""
    seeds = seed_range(args.seeds)
    if args.quick:
        return named(Task(g, arms.SEVEN, 0, seeds[0], True) for g in args.groups)
    each = product(args.groups, seeds, arms.KINDS, arms.OFF)
    return named(Task(g, arm, round(100 * off), seed) for g, seed, arm, off in each)


def run(task: Task) -> dict:
    """Draw a case, diagnose it and compare; a row, or its crash."""
    return guarded(asdict(task), lambda: _row(task))


def _row(task: Task) -> dict:
    arm, effects = task.drawn_arm, []
    if task.group == SETS:
        rng = create_random_stream(derive_seed(task.seed, f"changes/{task.name}"), "changes")
        effects = arms.draw_set(arm, rng)
    made = arms.make(arm, effects)
    start = perf_counter()
    verdict = diagnose(made.robot, made.fit, (), made.held_out).verdict
    seconds = round(perf_counter() - start, 2)
    names = [Name.hidden(effect, arm.robot.dof) for effect in effects]
    return {
        **asdict(task),
        "seconds": seconds,
        "planted": [_plain(name) for name in names],
        **compare(verdict, names),
        "outcome": verdict.verdict,
    }


def summary(row: Mapping) -> str:
    planted, said = (
        "; ".join(f"{name} {joints}" for name, joints in names) or "nothing"
        for names in (row["planted"], [known[0] for known in row["said"]])
    )
    result = "exact" if row["exact"] else "listed" if row["listed"] else "-"
    return f"{result}: {planted} -> {said} ({row['seconds']} s)"
