"""Cases of each group: drawn, diagnosed, and compared with the truth.

Most arms are synthetic, some are in PyBullet. Motions have one seed, the arm and its
noise another, so that several arms share motions whose minimum detectable sizes are
known.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from time import perf_counter

from benchmarks.harness.cases import guarded
from benchmarks.harness.logs import PAUSE, RATE, in_engine, sensed
from benchmarks.hidden.draw import (
    CLEAR,
    MULTIPLES,
    OF_A_PAIR,
    ROUNDING,
    draw_sized,
    measured,
    true_parameters,
    vocabulary,
)
from benchmarks.hidden.oracle import oracle
from benchmarks.hidden.score import NOTHING, PAIR, SINGLE, UNKNOWN, case_row
from benchmarks.synthetic.motions import make_motion
from benchmarks.synthetic.other_forms import FORMS
from benchmarks.synthetic.quasi_static import Plant, true_friction, true_torque
from flows.specs import derive_seed
from residual.diagnosis.diagnose import diagnose
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from residual.verdict.result import Detectable, Verdict
from sim.engine.plant_records import (
    PlantEffect,
    PlantSpec,
    SensorNoise,
    SyntheticEffect,
    TrajectorySpec,
    create_random_stream,
)
from sim.plant.effect_catalogue import list_plant_effects, list_unnamed_effects
from sim.plant.typical_sizes import compute_usual_motion_range, estimate_typical_sizes

SYNTHETIC, PYBULLET = "synthetic", "pybullet"


@dataclass(frozen=True, slots=True)
class Plan:
    """Which logs a case has."""

    fit: tuple[str, ...]  # motion families to diagnose
    held_out: tuple[str, ...]  # motion families for the proof
    duration: float = 20.0  # length of each log [s]


PLANS = {
    SYNTHETIC: Plan(
        ("fourier", "fourier", "cyclic", "slow_cyclic", *2 * ("move_stop_move",)),
        ("fourier", "move_stop_move", "cyclic"),
    ),
    PYBULLET: Plan(
        ("fourier", "fourier", "cyclic", "cyclic", "move_stop_move"),
        ("welding", "fourier"),
    ),
    "quick": Plan(("fourier", "cyclic", "move_stop_move"), ("fourier",), 12.0),
}


@dataclass(frozen=True, eq=False, slots=True)
class Logs:
    """One case with the truth beside it."""

    robot: Robot  # the arm as the diagnosis may know it
    fit: tuple[Recording, ...]  # logs to diagnose
    held_out: tuple[Recording, ...]  # logs for the proof
    # True parameters of each hidden effect, as a verdict states them
    truths: tuple[dict, ...]


@lru_cache(maxsize=1)
def the_arm() -> Robot:
    """Return the built-in arm with the friction that its file declares."""
    return load_robot("irb140")


def make(data: str, effects: Sequence[PlantEffect], motion: int, arm: int) -> Logs:
    """Record one case; forms of other authors only on synthetic arms."""
    plan = PLANS[data]
    record = _pybullet if data == PYBULLET else _synthetic
    logs, truths = record(plan, tuple(effects), motion, arm)
    count = len(plan.fit)
    return Logs(the_arm(), tuple(logs[:count]), tuple(logs[count:]), tuple(truths))


def _synthetic(plan: Plan, effects: tuple[PlantEffect, ...], motion: int, arm: int):
    robot = the_arm()
    hidden = tuple(
        SyntheticEffect(e.name, e.joints, dict(e.parameters)) for e in effects
    )
    plant = Plant(robot, hidden, arm)
    logs = []
    for place, family in enumerate((*plan.fit, *plan.held_out)):
        name = f"{'fit' if place < len(plan.fit) else 'held_out'}_{place}_{family}"
        rng = create_random_stream(motion, f"motion/{name}")
        made = make_motion(
            family, compute_usual_motion_range(robot), plan.duration, RATE, rng
        )
        start = place * (plan.duration + PAUSE)
        torque = true_torque(plant, made, name, start)
        signals = sensed(robot, torque, name, arm)
        logs.append(Recording(name, robot.name, start + made.t, *signals))
    return logs, [_with_scatter(plant, e) for e in effects]


def _with_scatter(plant: Plant, effect: PlantEffect) -> dict:
    """Return the parameters relative to the declared values, as a verdict has them."""
    values, known = dict(effect.parameters), list_plant_effects().get(effect.name)
    if known is not None and known.of_drive:
        key, field = known.amount[0], known.of_drive
        joint = effect.joints[0] - 1
        true, told = true_friction(plant), estimate_typical_sizes(plant.robot)
        values[key] += float(getattr(true, field)[joint] - getattr(told, field)[joint])
    return values


def _pybullet(plan: Plan, effects: tuple[PlantEffect, ...], motion: int, arm: int):
    plant, logs = PlantSpec(effects, noise=SensorNoise(), seed=arm), []
    for place, family in enumerate((*plan.fit, *plan.held_out)):
        spec = TrajectorySpec(family, plan.duration, 2, 100 * motion + place)
        start = place * (plan.duration + PAUSE)
        logs.append(in_engine(the_arm(), plant, spec, start))
    return logs, true_parameters(the_arm(), plant)


def as_form(effect: PlantEffect, form: str) -> PlantEffect:
    """Return an effect as another author writes it down."""
    values = dict(effect.parameters)
    if form == "lugre":
        values["displacement"] = 2e-3  # rad: the bristles of a heavy gear
    assert effect.name in FORMS[form]
    return PlantEffect(form, effect.joints, tuple(sorted(values.items())))


BENCHES = 10  # excitations that all cases of one run share
# Every fifth draw of an effect is an arm in the physics engine.
_IN_ENGINE = 5
_TRIES = 20
_WITH_ORACLE = ("singles", "pairs")  # clear effects of the diagnosis' own forms


@dataclass(frozen=True, slots=True)
class Task:
    """One case to do."""

    group: str  # "bench" or a group of the benchmark
    hides: str  # effect or form; "" if drawn or nothing
    data: str  # "synthetic", "pybullet" or "quick"
    motion: int  # seed of the motions
    arm: int  # seed of the arm, of what it hides, and of the noise

    @property
    def name(self) -> str:
        """Key of the result."""
        parts = asdict(self).values()
        return " ".join(str(part) for part in parts if part != "")


def tasks(group: str, seeds: range, quick: bool) -> list[Task]:
    """Return the cases of a group; if it needs more, from the last seed on."""
    if quick:
        return _quick(group, seeds[0])
    named, strange = vocabulary(the_arm())
    first = seeds[0]
    cases = {
        "singles": [(e, s) for s in seeds for e in named],
        "detection": [(e, s) for s in seeds[: (len(seeds) + 1) // 2] for e in named],
        "nulls": [("", first + i) for i in range(20 * len(seeds))],
        "pairs": [("", first + i) for i in range(10 * len(seeds))],
        "forms": [(form, s) for s in seeds for form in FORMS],
        "unknown": [(e, s) for s in seeds for e in strange],
    }
    return [_task(group, hides, first, seed) for hides, seed in cases[group]]


def benches(tasks: Sequence[Task]) -> list[Task]:
    """Return the null cases that say the minimum detectable sizes of their motions."""
    unique = {(t.data, t.motion) for t in tasks if t.group != "nulls"}
    return [
        # An arm and noise of its own, not those of a case.
        Task("bench", "", data, motion, derive_seed(motion, "bench"))
        for data, motion in sorted(unique)
    ]


def run(job: tuple[Task, Sequence[Detectable]]) -> dict:
    """Draw a case by the detectable sizes of its motions, diagnose it and judge.

    Of a bench a row has the sizes, of a crash the error.
    """
    task, minimum = job
    return guarded(asdict(task), lambda: _done(task, minimum))


def _done(task: Task, minimum: Sequence[Mapping]) -> dict:
    # Kept as plain values between two parts of the benchmark.
    minimum = [Detectable(**entry) for entry in minimum]
    drawn, true = _hidden(task, minimum)
    effects = [as_form(e, task.hides) for e in true] if task.group == "forms" else true
    made = make(task.data, effects, task.motion, task.arm)
    begun = perf_counter()
    verdict = diagnose(made.robot, made.fit, (), made.held_out).verdict
    seconds = round(perf_counter() - begun, 2)
    about = {**asdict(task), "seconds": seconds}
    if task.group == "bench":
        return {**about, "minimum": [asdict(d) for d in verdict.minimum_detectable]}
    truths = made.truths
    if task.group == "forms":
        true = _as_taken(task.hides, true, verdict)
        truths = tuple(dict(e.parameters) for e in true)
    hidden = [measured(e, minimum, made.robot) for e in true]
    told = [(h.effect.name, h.joints) for h in hidden]
    best = None
    if task.group in _WITH_ORACLE:
        _, errors = oracle(made.robot, made.fit, made.held_out, told)
        best = errors.overall("filtered")
    row = case_row(drawn, hidden, truths, verdict, best)
    if task.group not in _WITH_ORACLE:
        del row["deviations"]
    names = [[e.name, list(e.joints), e.evidence.nats] for e in verdict.effects]
    return {**about, **row, "names": names}


def _hidden(task: Task, minimum: Sequence[Detectable]) -> tuple[str, list[PlantEffect]]:
    robot, rng = the_arm(), create_random_stream(task.arm, f"{task.group}/{task.hides}")
    if task.group in ("bench", "nulls"):
        return NOTHING, []
    if task.group == "unknown":
        return UNKNOWN, [draw_sized(robot, rng, task.hides, None, minimum)]
    if task.group == "pairs":
        return PAIR, _pair(rng, minimum)
    name = FORMS[task.hides][0] if task.group == "forms" else task.hides
    if task.group == "detection":
        return SINGLE, [draw_sized(robot, rng, name, 1.0, minimum)]
    return SINGLE, [_clear(rng, name, MULTIPLES[1:], minimum)]


def _clear(rng, name: str, multiples: Sequence[float], minimum) -> PlantEffect:
    """Draw an effect that is so many times detectable, on a joint where it can be.

    Where noise and motion hide even three times what arms usually have, or any size,
    another joint is drawn. If there is none, it stays too small.
    """
    robot = the_arm()
    for _ in range(_TRIES):
        one = draw_sized(robot, rng, name, float(rng.choice(multiples)), minimum)
        found = measured(one, minimum, robot)
        # In proportion to no parameter, or large enough; not where no size would show.
        if found.size is None or (found.multiple or 0.0) >= CLEAR - ROUNDING:
            break
    return one


def _pair(rng, minimum: Sequence[Detectable]) -> list[PlantEffect]:
    """Draw two effects that are not one: of two names, on joints of their own."""
    named, _ = vocabulary(the_arm())
    made: list[PlantEffect] = []
    for name in rng.choice(named, 2, replace=False):
        for _ in range(_TRIES):
            one = _clear(rng, str(name), OF_A_PAIR, minimum)
            if not any(set(one.joints) & set(other.joints) for other in made):
                break
        made.append(one)
    return made


def _as_taken(form: str, true_effects: list[PlantEffect], verdict: Verdict) -> list:
    """Return the effect that a form was taken for, if it may be taken for it."""
    said = {e.name for e in verdict.effects}
    name = next((n for n in FORMS[form] if n in said), true_effects[0].name)
    return [PlantEffect(name, e.joints, e.parameters) for e in true_effects]


def _task(group: str, hides: str, first: int, seed: int) -> Task:
    fifth = (seed - first) % _IN_ENGINE == _IN_ENGINE - 1
    known = list_plant_effects().get(hides)
    engine = (known is not None and not known.supports_synthetic_arm) or (
        fifth and group in ("singles", "unknown")
    )
    # Nulls are cheap to vary: each has motions of its own.
    motion = seed if group == "nulls" else first + (seed - first) % BENCHES
    data = PYBULLET if engine else SYNTHETIC
    return Task(group, hides, data, motion, seed)


def _quick(group: str, seed: int) -> list[Task]:
    few = {
        "singles": ("offset", "stribeck"),
        "nulls": ("",),
        "unknown": (list_unnamed_effects()[0],),
        "pairs": ("",),
        "forms": ("one_way_viscous",),
        "detection": ("offset",),
    }
    return [Task(group, h, "quick", seed, seed + i) for i, h in enumerate(few[group])]


def summary(row: Mapping) -> str:
    if "outcome" not in row:
        return "done"
    names = "; ".join(f"{n[0]} {n[1]}" for n in row["names"]) or "nothing"
    hidden = f"{row['effect']} {row['joints']}"
    if row["second_effect"]:
        hidden += f" + {row['second_effect']} {row['second_joints']}"
    return f"{row['outcome']}: {hidden} -> {names} ({row['seconds']} s)"
