"""Cases that each program answers: one hidden effect, two, none, or one without a name.

A program gets logs to fit, logs whose torque it predicts, and two logs of the same arm
without one of its effects. All cases of a seed have one robot file and the same
motions. Ours is `modelgap diagnose` of the fit logs, with the default held-out part.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import product
from time import perf_counter

import numpy as np

import modelgap as mg
from benchmarks.harness.cases import guarded, named, seed_range
from benchmarks.harness.logs import CONTROL, PAUSE, RATE
from benchmarks.hidden.draw import vocabulary
from benchmarks.hidden.oracle import oracle
from benchmarks.hidden.score import NOTHING, PAIR, SINGLE, UNKNOWN, Name, members
from benchmarks.hidden.sized import CLEAR, SHARES, draw_of_share
from benchmarks.peers_parts import judge, sparse, squares
from benchmarks.peers_parts.linear_model import Answer, Case
from benchmarks.synthetic.light_arm import draw_light_arm
from benchmarks.synthetic.visible import Stage
from flows.specs import derive_seed
from residual.effects import load_effects, number_reported_joints
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from sim.effect_draws import draw_plant_effect
from sim.engine.plant_records import (
    PlantEffect,
    PlantSpec,
    ReferenceMotion,
    SampleRates,
    SensorNoise,
    TrajectorySpec,
    create_random_stream,
)
from sim.experiment import run_experiment
from sim.trajectories import plan_reference_motion

_KINDS = (*5 * (SINGLE,), PAIR, PAIR, NOTHING, NOTHING, UNKNOWN)  # of ten cases
_FAMILIES, _EXPERIMENTS = ("fourier", "cyclic"), (3, 4, 5, 6)
_HELD_OUT = ("move_stop_move", "fourier")  # one of a family that is never fitted
_AFTER = ("fourier", "cyclic")
_TORQUE, _ENCODER = (0.005, 0.015, 0.03), (5e-5, 1e-4, 2e-4)  # share of range; rad


def answer(case: Case) -> Answer:
    found = mg.diagnose(case.robot, list(case.fit.values()), trust_log=True)
    said = members(found.verdict)
    left = list(found.verdict.unexplained.joints)
    model = found.models["augmented"]
    predictions = {name: model.predict(log) for name, log in case.held_out.items()}
    for k, one in enumerate(said, start=1):
        without = model.without(one.name.effect, one.name.joints or None)
        for name, log in case.after.items():
            predictions[f"finding_{k}_{name}"] = without.predict(log)
    unknown = left or found.verdict.verdict == "unknown"
    return Answer(tuple((s.name, *s.alike) for s in said), unknown, predictions)


PROGRAMS: Mapping[str, Callable[[Case], Answer]] = {
    "ours": answer,
    "squares": squares.answer,
    "sparse": sparse.answer,
}


@dataclass(frozen=True, slots=True)
class Task:
    """One case for some programs."""

    seed: int
    number: int  # of the case
    seconds: float  # length of a log
    programs: tuple[str, ...]

    @property
    def name(self) -> str:
        """Key of the result."""
        parts = (self.seed, self.seconds, self.number, *self.programs)
        return " ".join(map(str, parts))


def jobs(args: argparse.Namespace) -> dict[str, Task]:
    """Return ten cases a seed; two with short logs in a quick run."""
    count, seconds = (2, 8.0) if args.quick else (len(_KINDS), 20.0)
    each = product(seed_range(args.seeds), range(count))
    return named(Task(*one, seconds, tuple(args.groups)) for one in each)


def run(task: Task) -> dict:
    """Let the programs answer one case; a row for each, or the crash."""
    return guarded({}, lambda: _rows(task))


def _rows(task: Task) -> dict:
    robot, number = _arm(task.seed), task.number
    kind, effects = _hidden(task)
    there = [
        Name(e.name, tuple(sorted(number_reported_joints(e.name, e.joints, robot.dof))))
        for e in effects
    ]
    # Which effect the arm has no more in each log after; none where it has none.
    after = (name for name in _motions(task) if name[0] == "a")
    gone = {name: min(i, len(effects) - 1) for i, name in enumerate(after)}
    logs, case = _logs(task, f"case/{number}", effects, gone)
    truth = judge.Truth(kind, tuple(there))
    if kind != UNKNOWN:
        fit, held = ([logs[n] for n in own] for own in (case.fit, case.held_out))
        model, _ = oracle(robot, fit, held, [(n.effect, n.joints) for n in there])
        for name, log in zip(case.held_out, held, strict=True):
            truth.torque[name] = log, model.predict(log), None
        for name, number in gone.items() if effects else ():
            left = model.without(there[number].effect, there[number].joints or None)
            truth.torque[name] = logs[name], left.predict(logs[name]), number
    asked = (
        (program, partial(_answered, program, case, truth)) for program in PROGRAMS
    )
    rows = [guarded({"group": k}, ask) for k, ask in asked if k in task.programs]
    return {"rows": rows}


def _answered(program: str, case: Case, truth: judge.Truth) -> dict:
    start = perf_counter()
    found = PROGRAMS[program](case)
    seconds = round(perf_counter() - start, 2)
    return {
        "group": program,
        "seconds": seconds,
        **judge.compare(truth, found),
        "hidden": list(map(str, truth.effects)),
        "said": [list(map(str, names)) for names in found.findings],
    }


def summary(row: Mapping) -> str:
    hidden = next((r["hidden"] for r in row["rows"] if "hidden" in r), ["?"])
    said = [f"{r['group']} {[n[0] for n in r.get('said', ())]}" for r in row["rows"]]
    return f"{'; '.join(hidden) or 'nothing'}: {', '.join(said)}"


@lru_cache(maxsize=4)
def _arm(seed: int) -> Robot:
    """Return the built-in arm for odd seeds, and a drawn one for even ones."""
    return (
        load_robot("irb140") if seed % 2 else draw_light_arm(derive_seed(seed, "arm/1"))
    )


def _excitation(seed: int) -> tuple[tuple[str, ...], SensorNoise]:
    """Draw the families of the logs to fit, and the noise; one is always Fourier."""
    rng = create_random_stream(seed, "excitation/0")
    count = int(rng.choice(_EXPERIMENTS))
    more = map(str, rng.choice(_FAMILIES, count - 1))
    fit = ("fourier", *more)
    return fit, SensorNoise(float(rng.choice(_TORQUE)), float(rng.choice(_ENCODER)))


def _motions(task: Task) -> dict[str, tuple[TrajectorySpec, float]]:
    """Return each log's motion and when it begins [s], by its name."""
    fit, _ = _excitation(task.seed)
    roles = {"fit": fit, "held_out": _HELD_OUT, "after": _AFTER}
    named = [
        (f"{role}_{i}", kind)
        for role, kinds in roles.items()
        for i, kind in enumerate(kinds, start=1)
    ]
    out = {}
    for place, (name, kind) in enumerate(named):
        seed = derive_seed(task.seed, f"excitation/0/{place}")
        spec = TrajectorySpec(kind, task.seconds, seed=seed)
        out[name] = spec, place * (task.seconds + PAUSE)
    return out


@lru_cache(maxsize=12)
def _reference(seed: int, spec: TrajectorySpec) -> ReferenceMotion:
    return plan_reference_motion(_arm(seed), spec, CONTROL)


def _logs(
    task: Task, label: str, effects: Sequence[PlantEffect], gone: Mapping[str, int]
) -> tuple[dict[str, Recording], Case]:
    """Record a case, and what anybody may know of it.

    Args:
        label: Whose arm; each has scatter and noise of its own.
        gone: Number of the effect that it has no more, by the logs after to record.
    """
    robot, (_, noise) = _arm(task.seed), _excitation(task.seed)
    seed, out = derive_seed(task.seed, f"plant/{label}"), {}
    for name, (spec, start) in _motions(task).items():
        if name[0] == "a" and name not in gone:
            continue
        left = tuple(e for i, e in enumerate(effects) if i != gone.get(name))
        plant = PlantSpec(left, noise=noise, seed=seed)
        ref = _reference(task.seed, spec)
        made = run_experiment(robot, ref, plant, SampleRates(CONTROL, RATE), start)
        out[name] = replace(made.log, id=name, q_ref=None)
    parts: dict[str, dict] = {role: {} for role in "fha"}
    for name, log in out.items():
        kept = log if name[0] == "f" else replace(log, tau=np.zeros_like(log.tau))
        parts[name[0]][name] = kept
    return out, Case(robot, *parts.values())


@lru_cache(maxsize=4)
def _stages(seed: int, seconds: float) -> list[Stage]:
    """Return the motions to fit, on which sizes are shares of a joint's torque."""
    robot, each = _arm(seed), _motions(Task(seed, 0, seconds, ())).items()
    fit = [motion for name, motion in each if name[0] == "f"]
    return [
        Stage.of(robot, plan_reference_motion(robot, spec, RATE), t) for spec, t in fit
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
