"""Cases of each group: what is drawn, how it is diagnosed, what came of it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter

from benchmarks.attribution_parts.arms import KINDS, OFF, SEVEN, Arm, make, moved_values
from benchmarks.attribution_parts.changes import BODIES, draw_changes
from benchmarks.attribution_parts.edits import edit_rows
from benchmarks.attribution_parts.judge import judged, moved
from benchmarks.seeded import guarded
from flows.blind.score import Name
from flows.blind.size import measured
from flows.specs.experiment import derived_seed
from residual.close import close_the_loop
from residual.diagnosis.result import Detectable
from residual.effects import reported_joints
from sim.records import PlantEffect, stream

UNCHANGED, CHANGED = "unchanged", "changed"
GROUPS = (UNCHANGED, CHANGED)
MOST = 4  # changes at once


@dataclass(frozen=True, slots=True)
class Task:
    """One case to do.

    Attributes:
        group: One of GROUPS.
        arm: "six" or "seven".
        off: How far the given values are off, in per cent.
        count: How many changes.
        seed: Seed of the arm; with the others that of the noise and the changes.
        quick: Whether its logs are few and short.
    """

    group: str
    arm: str
    off: int
    count: int
    seed: int
    quick: bool = False

    @property
    def name(self) -> str:
        """Key of the result."""
        return " ".join(str(part) for part in asdict(self).values())

    @property
    def bench(self) -> str:
        """Key of the same arm without a change, which says the sizes."""
        return self._alike.name

    @property
    def _alike(self) -> "Task":
        return Task(UNCHANGED, self.arm, self.off, 0, self.seed, self.quick)

    @property
    def made_of(self) -> Arm:
        """The arm with its noise."""
        noise = derived_seed(self.seed, f"noise/{self.name}")
        # Not the very arm and motions where values are off by more: a case is a draw.
        seed = derived_seed(self.seed, f"arm/{self.arm}/{self.off}")
        return Arm(self.arm, self.off / 100, seed, noise, self.quick)


def tasks(group: str, seeds: Sequence[int], quick: bool) -> list[Task]:
    """Return the cases of a group.

    Args:
        quick: Two arms only, in few and short logs.
    """
    counts = (0,) if group == UNCHANGED else tuple(range(1, MOST + 1))
    if quick:
        return [Task(group, SEVEN, 3, counts[-1] // 2, s, True) for s in seeds[:1]]
    every = [round(100 * off) for off in OFF]
    return [
        Task(group, arm, off, count, seed)
        for seed in seeds
        for arm in KINDS
        for off in every
        for count in counts
    ]


def benches(wanted: Sequence[Task]) -> list[Task]:
    """Return the unchanged arms that say the detectable sizes of those that change."""
    unique = {t.bench: t._alike for t in wanted}
    return list(unique.values())


def run(job: tuple[Task, Sequence[Mapping]]) -> dict:
    """Draw one case, diagnose it and judge the answer.

    Args:
        job: The case, and the detectable sizes of its arm; none for an unchanged one.

    Returns:
        Its row; of a crash the error.
    """
    task, minimum = job
    return guarded(asdict(task), lambda: _done(task, minimum))


def _done(task: Task, minimum: Sequence[Mapping]) -> dict:
    least = [Detectable(**entry) for entry in minimum]
    arm, effects = task.made_of, changes_of(task, minimum)
    made = make(arm, effects)
    begun = perf_counter()
    found = close_the_loop(made.robot, made.fit, (), made.held_out)
    seconds = round(perf_counter() - begun, 2)
    verdict = found.verdict
    sizes = least or list(verdict.minimum_detectable)
    body = any(e.name in BODIES for e in effects)
    names = planted(effects, arm)
    row = {
        **asdict(task),
        "seconds": seconds,
        "planted": [
            [n.effect, list(n.joints), dict(e.parameters), m]
            for n, e, m in zip(
                names, effects, _multiples(effects, arm, least), strict=True
            )
        ],
        **judged(verdict, names),
        **moved(verdict, moved_values(arm, effects), sizes, body),
        "edits": edit_rows(arm, effects, names, made, found),
        "errors": dict(verdict.error.overall_filtered),
        "outcome": "",
    }
    row["outcome"] = _outcome(row)
    if task.group == UNCHANGED:
        row["minimum"] = [asdict(d) for d in verdict.minimum_detectable]
    return row


def changes_of(task: Task, minimum: Sequence[Mapping]) -> list[PlantEffect]:
    """Return what changed in a case."""
    if task.group == UNCHANGED:
        return []
    rng = stream(derived_seed(task.seed, f"changes/{task.name}"), "changes")
    least = [Detectable(**entry) for entry in minimum]
    return draw_changes(task.made_of, rng, task.count, least)


def planted(effects: Sequence[PlantEffect], arm: Arm) -> list[Name]:
    """Return what changed in the convention of the verdict."""
    dof = arm.robot.dof
    return [
        Name(e.name, tuple(sorted(reported_joints(e.name, e.joints, dof))))
        for e in effects
    ]


def _multiples(effects, arm: Arm, least: Sequence[Detectable]) -> list[float | None]:
    return [measured(e, least, arm.robot, None).multiple for e in effects]


def words(row: Mapping) -> str:
    """Return one line on a case for the log of a run."""
    if "outcome" not in row:
        return "done"
    there, said = (
        "; ".join(f"{one[0]} {one[1]}" for one in names) or "nothing"
        for names in (row["planted"], [known[0] for known in row["said"]])
    )
    return f"{row['outcome']}: {there} -> {said} ({row['seconds']} s)"


def _outcome(row: Mapping) -> str:
    """One word for the log of a run."""
    if row["exact"]:
        return "exact"
    if row["listed"]:
        return "listed"
    if len(row["said"]) > row["true"]:
        return "false name"
    return "part" if row["said"] else "silent"
