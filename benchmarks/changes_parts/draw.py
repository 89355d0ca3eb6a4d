"""Cases: an arm in two epochs and what changes between them, drawn from a seed."""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.changes_parts import arms, real
from benchmarks.harness.cases import named, seed_range
from sim.engine.plant_records import PlantEffect, create_random_stream
from sim.plant.typical_sizes import draw_plant_effect
from tests.synthetic.amounts import scale_effect
from tests.synthetic.sized import solve_size
from tests.synthetic.visible import Stage

UNCHANGED, CHANGE, UNNAMED, DRIFT = "unchanged", "change", "unnamed", "drift"
REAL_UNCHANGED, LOAD = "measured_unchanged", "load"
GROUPS = (UNCHANGED, CHANGE, UNNAMED, DRIFT, REAL_UNCHANGED, LOAD)
SIZES = (0.10, 0.05, 0.025)
# Cases of each seed; of those with a size, of each size.
_COUNTS = {UNCHANGED: 12, CHANGE: 6, UNNAMED: 5, DRIFT: 4}
# What can change on an arm, in the order of the cases.
EFFECTS = (
    *("offset", "payload", "viscous", "delay", "torque_gain", "ripple", "stribeck"),
    *("encoder_offset", "coulomb", "base_tilt", "spring", "quadratic_viscous"),
    *("elasticity", "load_friction", "rotor_inertia", "coulomb_asymmetry"),
    *("link_inertia", "position_friction", "tool_force", "backlash"),
    *("viscous_asymmetry", "balancer", "coupled_friction", "presliding", "warmup"),
    "encoder_eccentricity",
)
STRANGE = ("x_vibration", "x_cogging_sum", "x_friction_jump", "x_square_wave")
STRANGE += ("x_random_walk",)
# Parameters that torque grows with, where the plant's catalogue has no amount.
_AMPLITUDES = ("x_vibration", "x_square_wave", "x_random_walk", "x_cogging_sum")
_GROWS = {
    **dict.fromkeys(_AMPLITUDES, "amplitude"),
    **dict.fromkeys(("presliding", "x_friction_jump"), "level"),
}
_MOST = 5.0  # times a usual size: no arm has more
_BACKGROUNDS, _ODDS = ("workshop", "worn", "clean"), (0.5, 0.3, 0.2)
_FAMILIES = ("fourier", "cyclic", "move_stop_move")
_LOGS, _LENGTH, _TOTAL = (2, 4), (10.0, 20.0), 60.0  # s
_WARM = (300.0, 1500.0)  # s of work before a session that begins warm
_SAME_EFFECT, _TRIES = 8, 80  # draws of one effect, and in all


@dataclass(frozen=True, slots=True)
class Slot:
    """One case before it is drawn."""

    group: str
    seed: int
    index: int
    target: float = 0.0  # size of the change; 0 for none

    @property
    def name(self) -> str:
        """What its draws are called by."""
        return f"{self.group} {self.seed}/{self.index} {self.target:g}"


def jobs(args: argparse.Namespace) -> dict[str, Slot]:
    seeds = seed_range(args.seeds)
    return named(s for group in args.groups for s in slots(group, seeds, args.quick))


def slots(group: str, seeds: Sequence[int], quick: bool) -> list[Slot]:
    """Return the cases of a group; orders of measured logs have no seed."""
    if group in (REAL_UNCHANGED, LOAD):
        count = len(real.epochs(group == LOAD))
        return [Slot(group, 0, i) for i in range(1 if quick else count)]
    targets = {CHANGE: SIZES, UNNAMED: SIZES[:1]}.get(group, (0.0,))
    every = [
        Slot(group, seed, index, target)
        for seed in seeds
        for target in targets
        for index in range(_COUNTS[group])
    ]
    return every[:1] if quick else every


def draw(slot: Slot) -> arms.Case:
    """Draw a case; an effect that no arm has so much of is drawn again.

    Raises:
        ValueError: If no draw has the size.
    """
    if slot.group in (REAL_UNCHANGED, LOAD):
        arm, first, second = real.epochs(slot.group == LOAD)[slot.index]
        return arms.Case(arm, first=first, second=second)
    for attempt in range(_TRIES):
        rng = create_random_stream(slot.seed, f"changes/{slot.name}/{attempt}")
        case = _arm(slot, rng)
        if not slot.target:
            return case
        # Every effect comes equally often, each size in an order of its own.
        names = STRANGE if slot.group == UNNAMED else EFFECTS
        turn = slot.seed * _COUNTS[slot.group] + slot.index + attempt // _SAME_EFFECT
        turn += 9 * SIZES.index(slot.target)
        changed = _changed(case, names[turn % len(names)], rng, slot.target)
        if changed is not None:
            return changed
    raise ValueError(f"no arm has {slot.name} in {_TRIES} draws")


def _arm(slot: Slot, rng: np.random.Generator) -> arms.Case:
    kind = arms.SIX if (slot.seed + slot.index) % 2 else arms.SEVEN
    first = _motions(rng)
    second = first if rng.integers(2) else _motions(rng)  # the same in half of all
    warm = rng.uniform(*_WARM, 2)
    cold, again = (int(x) for x in rng.integers(2, size=2))
    background = str(rng.choice(_BACKGROUNDS, p=_ODDS))
    drifts = slot.group == DRIFT  # exactly one session begins warm
    if drifts and background == "clean":  # nothing warms on a clean arm
        background = "workshop"
    warm *= np.array([cold, 1 - cold if drifts else again])
    return arms.Case(
        arm=str(rng.choice(kind)),
        background=background,
        plant=int(rng.integers(2**31)),
        noise=int(rng.integers(2**31)),
        worked=(float(warm[0]), float(warm[1])),
        first=first,
        second=second,
        held_out=_motions(rng)[:1],
    )


def _motions(rng: np.random.Generator) -> tuple[arms.Part, ...]:
    count = int(rng.integers(_LOGS[0], _LOGS[1] + 1))
    longest = min(_LENGTH[1], _TOTAL / count)
    return tuple(
        arms.Part(
            str(rng.choice(_FAMILIES)),
            seed=int(rng.integers(2**31)),
            duration=float(round(rng.uniform(_LENGTH[0], longest))),
        )
        for _ in range(count)
    )


def _changed(
    case: arms.Case, name: str, rng: np.random.Generator, target: float
) -> arms.Case | None:
    """Return the case with a change of a size, None where the arm cannot have it."""
    robot = arms.robot_of(case.arm)
    usual = draw_plant_effect(robot, rng, name)
    stages = [Stage.of(robot, *one) for one in arms.list_motions(robot, case.second)]

    def times(factor: float) -> PlantEffect:
        if name not in _GROWS:
            return scale_effect(usual, factor)
        values = dict(usual.parameters)
        values[_GROWS[name]] *= factor
        return replace(usual, parameters=tuple(sorted(values.items())))

    sized = solve_size(robot, times, target, stages, _MOST)
    return sized and replace(case, effect=sized[0], size=sized[1])
