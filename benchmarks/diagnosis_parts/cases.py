"""Cases of each group: drawn, diagnosed, and compared with the truth.

Most arms are synthetic, some are in PyBullet. Motions have one seed, the arm and its
noise another. What an arm hides follows from the seeds alone, so that two diagnoses can
be compared, except in the group of detection: it asks whether the minimum detectable
sizes that the diagnosis states for the motions are right.
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from time import perf_counter

import numpy as np

from benchmarks.harness.cases import guarded, named, seed_range
from benchmarks.harness.logs import PAUSE, RATE, Logs, in_engine, list_motions
from benchmarks.harness.logs import record as record_log
from benchmarks.hidden.oracle import oracle
from benchmarks.hidden.score import NOTHING, PAIR, SINGLE, UNKNOWN, Name, case_row
from flows.specs import derive_seed
from residual.diagnosis.diagnose import diagnose
from residual.effects import number_reported_joints
from residual.robot.robot import Robot, load_robot
from residual.verdict.result import Detectable, Verdict
from sim.engine.plant_records import (
    PlantEffect,
    PlantSpec,
    SensorNoise,
    TrajectorySpec,
    create_random_stream,
)
from sim.plant.effect_catalogue import list_plant_effects
from sim.plant.plant_arm import build_plant_arm
from sim.plant.typical_sizes import draw_plant_effect, estimate_typical_sizes, read_nominal_drives
from sim.trajectories import plan_reference_motion
from tests.synthetic.amounts import list_unnamed_effects
from tests.synthetic.draws import draw_detectable, true_parameters, vocabulary
from tests.synthetic.laws import supports_synthetic_arm
from tests.synthetic.other_forms import FORMS
from tests.synthetic.quasi_static import Plant, true_friction
from tests.synthetic.sized import CLEAR, SHARES, draw_of_share, has_sizes
from tests.synthetic.visible import Stage

COST = "cost"
GROUPS = ("singles", "nulls", "unknown", "pairs", "forms", "detection", COST)
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
        ("fourier", "fourier", "cyclic", "cyclic", "move_stop_move"), ("welding", "fourier")
    ),
    "quick": Plan(("fourier", "cyclic", "move_stop_move"), ("fourier",), 12.0),
}


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
    plant = Plant(robot, effects, arm)
    motions = list_motions(robot, plan.fit, plan.held_out, plan.duration, motion)
    logs = [record_log(plant, made, name, arm, start) for name, made, start in motions]
    drives = true_friction(plant), estimate_typical_sizes(robot)
    return logs, [true_parameters(e, *drives) for e in effects]


@lru_cache(maxsize=2)
def _stages(data: str, seed: int) -> list[Stage]:
    """Return the motions to fit, on which sizes are shares of a joint's torque."""
    plan = PLANS[data]
    if data != PYBULLET:
        motions = list_motions(the_arm(), plan.fit, (), plan.duration, seed)
        return [Stage.of(the_arm(), made, start) for _, made, start in motions]
    return [
        Stage.of(the_arm(), plan_reference_motion(the_arm(), spec, RATE), start)
        for spec, start in _specs(plan, seed)[: len(plan.fit)]
    ]


def _specs(plan: Plan, seed: int) -> list[tuple[TrajectorySpec, float]]:
    """Return motion and start [s] of each log of an arm in the physics engine."""
    return [
        (
            TrajectorySpec(family, plan.duration, 2, 100 * seed + place),
            place * (plan.duration + PAUSE),
        )
        for place, family in enumerate((*plan.fit, *plan.held_out))
    ]


def _pybullet(plan: Plan, effects: tuple[PlantEffect, ...], motion: int, arm: int):
    plant, logs = PlantSpec(effects, noise=SensorNoise(), seed=arm), []
    for spec, start in _specs(plan, motion):
        logs.append(in_engine(the_arm(), plant, spec, start))
    drives = build_plant_arm(the_arm(), plant).base, read_nominal_drives(the_arm())
    return logs, [true_parameters(e, *drives) for e in effects]


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
_WITH_ORACLE = ("singles", "pairs")  # clear effects of the diagnosis' own forms


@dataclass(frozen=True, slots=True)
class Task:
    """One case to do."""

    group: str  # of the benchmark
    hides: str  # effect or form; "" if drawn or nothing
    data: str  # "synthetic", "pybullet" or "quick"
    motion: int  # seed of the motions
    arm: int  # seed of the arm, of what it hides, and of the noise
    # Size, as a share of the torque of the joint; None where the group has no sizes.
    share: float | None = None


def jobs(args: argparse.Namespace) -> dict[str, Task]:
    seeds = seed_range(args.seeds)
    some = [group for group in GROUPS if group in args.groups and group != COST]
    return named(t for group in some for t in tasks(group, seeds, args.quick))


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
    return [
        _task(group, hides, first, seed, share)
        for hides, seed in cases[group]
        for share in _sizes(group, hides, seed == first)
    ]


def _sizes(group: str, hides: str, every: bool) -> tuple[float | None, ...]:
    """Return the shares to draw; the small ones, which have no bar, of one seed."""
    if group != "singles" or not has_sizes(hides):
        return (None,)
    return SHARES if every else CLEAR


@lru_cache(maxsize=4)
def _detectable(data: str, motion: int) -> tuple[Detectable, ...]:
    """Return the minimum detectable sizes in some motions, with nothing hidden."""
    # An arm and noise of its own, not those of a case.
    made = make(data, (), motion, derive_seed(motion, "bench"))
    return diagnose(made.robot, made.fit, (), made.held_out).verdict.minimum_detectable


def run(task: Task) -> dict:
    """Draw a case, diagnose it and judge.

    Of a crash a row has the error, of an effect of which no arm has as much that it was
    left out.
    """
    return guarded(asdict(task), lambda: _done(task))


def _done(task: Task) -> dict:
    hides = hidden(task)
    if hides is None:
        return {**asdict(task), "left_out": True}
    drawn, true, shares = hides
    effects = [as_form(e, task.hides) for e in true] if task.group == "forms" else true
    made = make(task.data, effects, task.motion, task.arm)
    begun = perf_counter()
    verdict = diagnose(made.robot, made.fit, (), made.held_out).verdict
    seconds = round(perf_counter() - begun, 2)
    about = {**asdict(task), "seconds": seconds}
    truths = made.truths
    if task.group == "forms":
        true = _as_taken(task.hides, true, verdict)
        truths = tuple(dict(e.parameters) for e in true)
    dof = made.robot.dof
    told = [(e.name, number_reported_joints(e.name, e.joints, dof)) for e in true]
    there = [(Name(*one), share) for one, share in zip(told, shares, strict=True)]
    best = None
    clear = all(share is None or share in CLEAR for share in shares)
    if task.group in _WITH_ORACLE and clear:
        _, errors = oracle(made.robot, made.fit, made.held_out, told)
        best = errors.overall("filtered")
    row = case_row(drawn, there, truths, verdict, best)
    if task.group not in _WITH_ORACLE:
        del row["deviations"]
    names = [[e.name, list(e.joints), e.evidence.nats] for e in verdict.effects]
    return {**about, **row, "names": names}


Hides = tuple[str, list[PlantEffect], list[float | None]]


def hidden(task: Task) -> Hides | None:
    """Return what an arm hides: of which sort, and effects with their sizes.

    Sizes are shares of a joint's torque, None where the group has none or the torque is
    in proportion to no parameter. None for an effect of which no arm has as much.
    """
    robot, rng = the_arm(), create_random_stream(task.arm, f"{task.group}/{task.hides}")
    if task.group == "nulls":
        return NOTHING, [], []
    if task.group == "unknown":
        return UNKNOWN, [draw_plant_effect(robot, rng, task.hides)], [None]
    if task.group == "detection":
        least = _detectable(task.data, task.motion)
        effect = draw_detectable(robot, rng, task.hides, least)
        return effect and (SINGLE, [effect], [None])
    stages = _stages(task.data, task.motion)
    if task.group == "pairs":
        return PAIR, *_pair(rng, stages)
    if task.group == "forms":
        name, sizes = FORMS[task.hides][0], rng.permutation(CLEAR).tolist()
        written = partial(as_form, form=task.hides)
        drawn = draw_of_share(robot, rng, name, sizes, stages, written=written)
    else:
        sizes = [task.share or 0.0]
        drawn = draw_of_share(robot, rng, task.hides, sizes, stages)
    return drawn and (SINGLE, [drawn[0]], [drawn[1]])


def _pair(
    rng: np.random.Generator, stages: Sequence[Stage]
) -> tuple[list[PlantEffect], list[float | None]]:
    """Draw two effects that are not one: of two names, on joints of their own."""
    named, _ = vocabulary(the_arm())
    pair: list[tuple[PlantEffect, float | None]] = []
    for name in rng.permutation(named):
        taken = {joint for effect, _ in pair for joint in effect.joints}
        sizes = rng.permutation(CLEAR).tolist()
        one = draw_of_share(the_arm(), rng, str(name), sizes, stages, taken)
        pair += [one] if one else []
        if len(pair) == 2:
            break
    return [effect for effect, _ in pair], [share for _, share in pair]


def _as_taken(form: str, true_effects: list[PlantEffect], verdict: Verdict) -> list:
    """Return the effect that a form was taken for, if it may be taken for it."""
    said = {e.name for e in verdict.effects}
    name = next((n for n in FORMS[form] if n in said), true_effects[0].name)
    return [PlantEffect(name, e.joints, e.parameters) for e in true_effects]


def _task(group: str, hides: str, first: int, seed: int, share: float | None) -> Task:
    fifth = (seed - first) % _IN_ENGINE == _IN_ENGINE - 1
    known = list_plant_effects().get(hides)
    engine = (known is not None and not supports_synthetic_arm(known)) or (
        fifth and group in ("singles", "unknown")
    )
    # Nulls are cheap to vary: each has motions of its own.
    motion = seed if group == "nulls" else first + (seed - first) % BENCHES
    data = PYBULLET if engine else SYNTHETIC
    return Task(group, hides, data, motion, seed, share)


def _quick(group: str, seed: int) -> list[Task]:
    few = {
        "singles": ("offset", "stribeck"),
        "nulls": ("",),
        "unknown": (list_unnamed_effects()[0],),
        "pairs": ("",),
        "forms": ("one_way_viscous",),
        "detection": ("offset",),
    }
    share = SHARES[-1] if group == "singles" else None
    return [Task(group, h, "quick", seed, seed + i, share) for i, h in enumerate(few[group])]


def summary(row: Mapping) -> str:
    if "outcome" not in row:
        return "no arm has as much"
    names = "; ".join(f"{n[0]} {n[1]}" for n in row["names"]) or "nothing"
    there = f"{row['effect']} {row['joints']}"
    if row["share"]:
        there += f" {100 * row['share']:g} %"
    if row["second"]:
        there += f" + {row['second'][0]} {row['second'][1]}"
    return f"{row['outcome']}: {there} -> {names} ({row['seconds']} s)"
