"""Cases of each group: what is drawn, how it is diagnosed, what came of it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from time import perf_counter

from benchmarks.dirty_parts.arms import (
    AGAINST,
    ALONE,
    OTHER,
    PYBULLET,
    QUICK,
    SEVEN,
    Arm,
    make,
    the_arm,
)
from benchmarks.seeded import guarded
from flows.blind.draw import vocabulary
from flows.blind.row import case_row
from flows.blind.score import NOTHING, SINGLE, UNKNOWN, members
from flows.blind.size import draw_sized, measured
from flows.blind.sums import CLEAR
from flows.specs.experiment import derived_seed
from residual.close import close_the_loop
from residual.diagnosis.result import Detectable, Verdict
from sim.catalogue import kinds
from sim.records import CLEAN, PlantEffect
from sim.streams import stream
from warehouse.ids import plain

GROUPS = ("unchanged", "worn", "drift", "change", "detection", "alone", "strange")
_SIZED = ("change", "detection", "alone")  # in detectable sizes of the same arm
_WITHOUT_BASELINE = ("alone", "strange")
# Arms per seed of each kind.
_UNCHANGED = {PYBULLET: 10, SEVEN: 5, OTHER: 5}
_WORN = {PYBULLET: 5, SEVEN: 3, OTHER: 2}
_DRIFTED = {PYBULLET: 1, SEVEN: 2, OTHER: 2}
_ENGINES = (OTHER, SEVEN, OTHER, SEVEN, PYBULLET)  # of the arms of changes, in turn
_TRIES = 20


@dataclass(frozen=True, slots=True)
class Task:
    """One case to do.

    Attributes:
        group: One of GROUPS, "bench" or "bench alone".
        what: Effect, or "" for none.
        data: Kind of arm.
        background: How dirty it is.
        arm: Seed of the arm and of the motions.
        noise: Seed of the noise and of what is hidden.
    """

    group: str
    what: str
    data: str
    background: str
    arm: int
    noise: int

    @property
    def name(self) -> str:
        """Key of the result."""
        parts = asdict(self).values()
        return " ".join(str(part) for part in parts if part != "")

    @property
    def bench(self) -> str:
        """Key of the unchanged arm that says the sizes of this one."""
        return _bench(self).name


def tasks(group: str, seeds: Sequence[int], quick: bool) -> list[Task]:
    """Return the cases of a group.

    Args:
        group: Its name.
        seeds: Seeds of the draws.
        quick: A handful only.
    """
    if quick:
        return _quick(group, seeds[0])
    many = {"unchanged": _UNCHANGED, "worn": _WORN, "drift": _DRIFTED}
    if group in many:
        word = "worn" if group == "worn" else "workshop"
        return [
            Task(group, "", data, word, derived_seed(seed, f"{group}/{data}/{i}"), 1)
            for seed in seeds
            for data, count in many[group].items()
            for i in range(count)
        ]
    named, strange = vocabulary(the_arm())
    few = seeds[: (len(seeds) + 1) // 2]
    wanted = {
        "change": [(e, s) for s in seeds for e in named],
        "detection": [(e, s) for s in few for e in named],
        "alone": [(e, s) for s in few for e in named],
        "strange": [(e, s) for s in seeds for e in strange],
    }
    return [_task(group, e, seeds.index(s), s) for e, s in wanted[group]]


def benches(wanted: Sequence[Task]) -> list[Task]:
    """Return the unchanged arms that say the detectable sizes of those that change."""
    unique = {_bench(t).name: _bench(t) for t in wanted if t.group in _SIZED}
    return list(unique.values())


def run(job: tuple[Task, Sequence[Mapping]]) -> dict:
    """Draw one case, diagnose it and judge the answer.

    Args:
        job: The case, and the detectable sizes of its arm.

    Returns:
        A row as in the view ``blind`` and where it is from; of a bench its sizes; of a
        crash the error.
    """
    task, minimum = job
    return guarded(asdict(task), lambda: _done(task, minimum))


def _done(task: Task, minimum: Sequence[Mapping]) -> dict:
    minimum = [Detectable(**entry) for entry in minimum]
    arm = Arm(task.data, task.background, task.arm, task.noise, task.group == "drift")
    drawn, effects = _hidden(task, arm, minimum)
    without = task.group in _WITHOUT_BASELINE or task.group == "bench alone"
    made = make(arm, effects, ALONE if without else AGAINST)
    begun = perf_counter()
    verdict = close_the_loop(made.robot, made.fit, made.baseline, made.held_out).verdict
    about = {**asdict(task), "seconds": round(perf_counter() - begun, 2)}
    if task.group.startswith("bench"):
        return {**about, "minimum": [asdict(d) for d in verdict.minimum_detectable]}
    hidden = [measured(e, minimum, made.robot, None) for e in effects]
    truths = [dict(e.parameters) for e in effects]
    row = case_row(drawn, hidden, truths, verdict, None)
    return {**about, **row, **_said(verdict), "true_factor": made.factor}


def _said(verdict: Verdict) -> dict:
    """Return every name with its class, and what is told of drift and background."""
    drift, folded = (getattr(verdict, key, None) for key in ("drift", "background"))
    least = (d.value for d in verdict.minimum_detectable if d.name == "drift")
    return {
        "names": [[e.name, list(e.joints), e.evidence.nats] for e in verdict.effects],
        "classes": [
            [[n.effect, list(n.joints)] for n in (said.name, *said.alike)]
            for said in members(verdict)
        ],
        "drift": plain(drift),
        "drift_detectable": next(least, None),
        "background_names": [[e["name"], e["joints"]] for e in plain(folded) or ()],
    }


def _hidden(
    task: Task, arm: Arm, minimum: Sequence[Detectable]
) -> tuple[str, list[PlantEffect]]:
    """Draw what a case hides: its kind and its effects."""
    rng = stream(task.noise, f"{task.group}/{task.what}/{task.arm}")
    if not task.what:
        return NOTHING, []
    if task.group == "strange":
        return UNKNOWN, [draw_sized(arm.robot, rng, task.what, None, minimum)]
    multiple = 1.0 if task.group == "detection" else CLEAR
    for _ in range(_TRIES):
        one = draw_sized(arm.robot, rng, task.what, multiple, minimum)
        found = measured(one, minimum, arm.robot, None)
        # In proportion to no parameter, or as large as asked; no arm has more than
        # three times the usual, and where no size would show another joint is drawn.
        if found.size is None or (found.multiple or 0.0) >= multiple - 1e-6:
            break
    return SINGLE, [one]


def _task(group: str, what: str, place: int, seed: int) -> Task:
    known = kinds()[what]
    data = _ENGINES[place % len(_ENGINES)]
    if group in _WITHOUT_BASELINE and data == SEVEN:
        data = OTHER  # of an arm without known friction no change of it can be seen
    data = data if known.on_synthetic else PYBULLET
    arm, noise = derived_seed(seed, "arm"), derived_seed(seed, f"{group}/{what}")
    if group in _WITHOUT_BASELINE and data == OTHER:
        arm -= arm % 4  # the built-in arm, whose friction is declared
    return Task(group, what, data, "workshop", arm, noise)


def _bench(task: Task) -> Task:
    """Return the same arm with nothing hidden, and another noise."""
    group = "bench alone" if task.group in _WITHOUT_BASELINE else "bench"
    noise = derived_seed(task.arm, "bench")
    return Task(group, "", task.data, task.background, task.arm, noise)


def _quick(group: str, seed: int) -> list[Task]:
    few = {"change": "payload", "detection": "offset", "alone": "offset"}
    what = few.get(group, "x_friction_jump" if group == "strange" else "")
    word = "worn" if group == "worn" else "workshop"
    return [Task(group, what, QUICK, word, seed, seed + 1)]


def cost_tasks(seeds: Sequence[int], quick: bool) -> list[tuple[Task, Task]]:
    """Return pairs of one arm, clean and in use, in the same motions."""
    data = QUICK if quick else OTHER
    arms = [derived_seed(seed, "cost") // 4 * 4 for seed in seeds[: 1 if quick else 3]]
    return [
        tuple(Task("cost", "", data, word, arm, 1) for word in (CLEAN, "workshop"))
        for arm in arms
    ]
