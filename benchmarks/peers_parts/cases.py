"""Cases that each program answers: one hidden effect, two, none, or one without a name.

A program gets logs of the physics engine and the robot file. All cases of a seed have
one robot and the same motions. Ours is `modelgap diagnose`, with the default held-out
part.
"""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache, partial
from itertools import product
from time import perf_counter

import modelgap as mg
from benchmarks.harness.cases import guarded, named, seed_range
from benchmarks.harness.logs import PAUSE, RATE, in_engine
from benchmarks.hidden.score import NOTHING, PAIR, SINGLE, UNKNOWN, Name, members
from benchmarks.peers_parts import judge, sparse, squares
from benchmarks.peers_parts.linear_model import Answer, Case
from flows.specs import derive_seed
from residual.effects import load_effects
from residual.robot.robot import Robot, load_robot
from sim.engine.plant_records import (
    PlantEffect,
    PlantSpec,
    SensorNoise,
    TrajectorySpec,
    create_random_stream,
)
from sim.plant.typical_sizes import draw_plant_effect
from sim.trajectories import plan_reference_motion
from tests.synthetic.draws import vocabulary
from tests.synthetic.light_arm import draw_light_arm
from tests.synthetic.sized import CLEAR, SHARES, draw_of_share
from tests.synthetic.visible import Stage

_KINDS = (*5 * (SINGLE,), PAIR, PAIR, NOTHING, NOTHING, UNKNOWN)  # of ten cases
_FAMILIES, _EXPERIMENTS = ("fourier", "cyclic"), (3, 4, 5, 6)
_TORQUE, _ENCODER = (0.005, 0.015, 0.03), (5e-5, 1e-4, 2e-4)  # share of range; rad


def answer(case: Case) -> Answer:
    verdict = mg.diagnose(case.robot, list(case.fit), trust_log=True).verdict
    left = list(verdict.unexplained.joints) or verdict.verdict == "unknown"
    return Answer(tuple((s.name, *s.alike) for s in members(verdict)), left)


PROGRAMS: Mapping[str, Callable[[Case], Answer]] = {
    "ours": answer,
    "squares": squares.answer,
    "sparse": sparse.answer,
}
GROUPS = tuple(PROGRAMS)


@dataclass(frozen=True, slots=True)
class Task:
    """One case for some programs."""

    seed: int
    number: int  # of the case
    seconds: float  # length of a log
    programs: tuple[str, ...]


def jobs(args: argparse.Namespace) -> dict[str, Task]:
    """Return ten cases a seed; two with short logs in a quick run."""
    count, seconds = (2, 8.0) if args.quick else (len(_KINDS), 20.0)
    each = product(seed_range(args.seeds), range(count))
    return named(Task(*one, seconds, tuple(args.groups)) for one in each)


def run(task: Task) -> dict:
    """Let the programs answer one case; a row for each, or the crash."""
    return guarded({}, lambda: _rows(task))


def _rows(task: Task) -> dict:
    robot, (kind, effects) = _arm(task.seed), _hidden(task)
    motions, noise = _excitation(task.seed, task.seconds)
    seed = derive_seed(task.seed, f"plant/case/{task.number}")
    plant = PlantSpec(effects, noise=noise, seed=seed)
    fit = tuple(in_engine(robot, plant, *motion) for motion in motions)
    there = tuple(Name.hidden(effect, robot.dof) for effect in effects)
    ask = partial(_answered, case=Case(robot, fit), kind=kind, there=there)
    return {"rows": [guarded({"group": k}, partial(ask, k)) for k in task.programs]}


def _answered(program: str, case: Case, kind: str, there: tuple[Name, ...]) -> dict:
    start = perf_counter()
    found = PROGRAMS[program](case)
    return {
        "group": program,
        "seconds": round(perf_counter() - start, 2),
        **judge.compare(kind, there, found),
        "hidden": list(map(str, there)),
        "said": [list(map(str, names)) for names in found.findings],
    }


def summary(row: Mapping) -> str:
    hidden = next((r["hidden"] for r in row["rows"] if "hidden" in r), ["?"])
    said = [f"{r['group']} {[n[0] for n in r.get('said', ())]}" for r in row["rows"]]
    return f"{'; '.join(hidden) or 'nothing'}: {', '.join(said)}"


@lru_cache(maxsize=4)
def _arm(seed: int) -> Robot:
    """Return the built-in arm for odd seeds, and a drawn one for even ones."""
    return load_robot("irb140") if seed % 2 else draw_light_arm(derive_seed(seed, "arm/1"))


Motions = list[tuple[TrajectorySpec, float]]  # each with its start [s]


def _excitation(seed: int, seconds: float) -> tuple[Motions, SensorNoise]:
    """Draw the motions of a seed, of which the first is Fourier, and the noise."""
    rng = create_random_stream(seed, "excitation/0")
    count = int(rng.choice(_EXPERIMENTS))
    kinds = ("fourier", *map(str, rng.choice(_FAMILIES, count - 1)))
    seeds = [derive_seed(seed, f"excitation/0/{place}") for place in range(count)]
    pairs = enumerate(zip(kinds, seeds, strict=True))
    motions = [
        (TrajectorySpec(kind, seconds, seed=s), place * (seconds + PAUSE))
        for place, (kind, s) in pairs
    ]
    return motions, SensorNoise(float(rng.choice(_TORQUE)), float(rng.choice(_ENCODER)))


@lru_cache(maxsize=4)
def _stages(seed: int, seconds: float) -> list[Stage]:
    """Return the motions, on which sizes are shares of a joint's torque."""
    robot, (motions, _) = _arm(seed), _excitation(seed, seconds)
    return [
        Stage.of(robot, plan_reference_motion(robot, spec, RATE), start) for spec, start in motions
    ]


def _hidden(task: Task) -> tuple[str, tuple[PlantEffect, ...]]:
    """Draw what a case hides: its kind, and effects with joints and sizes."""
    robot = _arm(task.seed)
    rng = create_random_stream(task.seed, f"hidden/{task.number}")
    kind, (known, unknown) = _KINDS[task.number], vocabulary(robot)
    if kind == UNKNOWN:
        return kind, (draw_plant_effect(robot, rng, str(rng.choice(unknown))),)
    stages, made = _stages(task.seed, task.seconds), []
    while len(made) < {NOTHING: 0, SINGLE: 1, PAIR: 2}[kind]:
        name = str(rng.choice(known))
        sizes = rng.permutation(CLEAR if kind == PAIR else SHARES).tolist()
        one = draw_of_share(robot, rng, name, sizes, stages)
        if one and not any(_same_thing(one[0], other) for other in made):
            made.append(one[0])
    return kind, tuple(made)


def _same_thing(one: PlantEffect, other: PlantEffect) -> bool:
    """Whether two effects are one: of one name or one family, on a common joint."""

    def family(effect: PlantEffect) -> str:
        known = load_effects().get(effect.name)
        return (known and known.family) or effect.name

    apart = one.joints and other.joints and not set(one.joints) & set(other.joints)
    return family(one) == family(other) and not apart
