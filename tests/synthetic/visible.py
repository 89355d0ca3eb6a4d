"""Draw a hidden effect that is large enough to show in the motions of the arm.

    python -m tests.synthetic.visible [FILE]

writes what `modelgap demo` hides where a usual size would not show; run it after a
change of effects, motions or usual sizes. Without FILE it writes the program's table.
How much shows follows from the plant's exact torque along those motions:

    share = rms((tau - RNEA(q)) with it - (tau - RNEA(q)) without it) / rms(tau without)

on the rows where the joint moves, with q as its encoder reads it.
"""

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np
from scipy.ndimage import binary_dilation
from scipy.signal import butter, sosfiltfilt

from flows.steps import demo
from residual.recording import Array
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import Robot, load_robot
from sim.effects.base import Rng
from sim.engine.friction_laws import BRISTLE
from sim.engine.plant_records import HIDDEN, PlantEffect, TrajectorySpec
from sim.engine.plant_records import ReferenceMotion as Motion
from sim.engine.plant_records import SyntheticEffect as Effect
from sim.engine.plant_records import create_random_stream as make_rng
from sim.plant.effect_catalogue import list_drive_effects, list_plant_effects
from sim.plant.typical_sizes import draw_plant_effect
from sim.trajectories import plan_reference_motion
from tests.synthetic.amounts import compute_effect_amount, scale_effect
from tests.synthetic.draws import MOST
from tests.synthetic.laws import supports_synthetic_arm
from tests.synthetic.quasi_static import Plant, resolve_synthetic_effects, true_torque

VISIBLE = 0.05  # share of a joint's torque that an effect has at least
# Asked for: the arm that runs is a few per cent off its description, does not follow
# its motions to the last sample, and some of those are only like the ones looked at.
_ASKED = 1.3 * VISIBLE
_OF_BRISTLES = 2.5  # times that: in the engine their damper takes half of it off
# Nearer to standstill dry friction may be anything up to breakaway.
_FASTER, _AWAY = 0.03, 0.1  # rad/s, s
_CUTOFF = 8.0  # Hz: faster torque is noise to whoever reads a log
_FEWEST = 0.05  # of the rows: a joint that moves on fewer has no torque to compare with
_DRAWS, _STEPS = 24, 4


@dataclass(frozen=True, eq=False, slots=True)
class Stage:
    """A motion on which an effect is to be seen, of the arm without it."""

    motion: Motion
    start: float  # session time of the first one [s]
    moves: Array  # where each joint moves, standstill well away, (n, dof)
    torque: Array  # torque of the arm as described, smooth [N m], (n, dof)
    residual: Array  # the same less what the rigid body takes [N m], (n, dof)

    @classmethod
    def of(cls, robot: Robot, reference: Motion, start: float = 0.0) -> Self:
        """Return the stage of one motion, of an arm just as its description says."""
        r = reference
        rate = 1 / (r.t[1] - r.t[0])
        slow = np.abs(r.qd) < _FASTER
        slow |= np.diff(np.sign(r.qd), axis=0, prepend=np.sign(r.qd[:1])) != 0
        torque, rest = _torques(Plant(robot, (), 0, scatter=0.0), r, start)
        near = np.ones((2 * round(_AWAY * rate) + 1, 1), dtype=bool)
        return cls(r, start, ~binary_dilation(slow, near), torque, rest)


def draw_visible(
    robot: Robot, stream: Rng, stages: Sequence[Stage], name: str | None = None
) -> PlantEffect:
    """Draw one hidden effect that shows on some motions.

    A usual one is made larger where it shows too little; where no arm has so much of
    it, another of its name is drawn. Errors of angles may show less in any arm: of
    several that one is hidden that shows most.
    """
    effect = draw_plant_effect(robot, stream, name)
    best, most = effect, -1.0
    if not supports_synthetic_arm(list_plant_effects()[effect.name]):
        return best  # no torque of it is known but by the engine
    asked = _ASKED * (_OF_BRISTLES if _has_bristles(effect) else 1.0)
    for _ in range(_DRAWS):
        larger, now = _enlarged(robot, effect, stages)
        if now >= asked:
            return larger
        if now > most:
            best, most = larger, now
        effect = draw_plant_effect(robot, stream, effect.name)
    return best


def share(robot: Robot, effect: PlantEffect, stages: Sequence[Stage]) -> float:
    """Return the share of an effect in the torque of the joint where it is largest."""
    plant = Plant(robot, _as_in_engine(effect), 0, scatter=0.0)
    own, total = np.zeros((2, robot.dof))
    for stage in stages:
        rest = _torques(plant, stage.motion, stage.start)[1]
        own += np.square((rest - stage.residual) * stage.moves).sum(axis=0)
        total += np.square(stage.torque * stage.moves).sum(axis=0)
    rows = np.mean([stage.moves.mean(axis=0) for stage in stages], axis=0)
    shares = np.sqrt(own / np.maximum(total, 1e-30)) * (rows >= _FEWEST)
    return float(shares.max())


def _enlarged(
    robot: Robot, effect: PlantEffect, stages: Sequence[Stage]
) -> tuple[PlantEffect, float]:
    """Return the effect, as large as it must and an arm may have it, and its share."""
    larger, factor, now = effect, 1.0, share(robot, effect, stages)
    grows = compute_effect_amount(effect.name, dict(effect.parameters)) is not None
    for _ in range(_STEPS):
        if now >= _ASKED or factor >= MOST or not grows:
            break
        # A little more, so that what grows less than in proportion arrives as well.
        factor = min(factor * 1.02 * _ASKED / max(now, 1e-9), MOST)
        larger = scale_effect(effect, factor)
        now = share(robot, larger, stages)
    return larger, now


def _as_in_engine(effect: PlantEffect) -> tuple[Effect, ...]:
    """Return what gives a synthetic arm the torque that the effect has in the engine.

    Bristles bear a part of the dry friction there, and come on top of it here.
    """
    p = dict(effect.parameters)
    hidden = Effect(effect.name, effect.joints, p)
    if not _has_bristles(effect):
        return (hidden,)
    # By unit, since the drive's effects have their names in their own files.
    dry = next(e for e in list_drive_effects() if e.parameters[e.amount[0]] == "N m")
    borne = {dry.amount[0]: -p["level"]}
    return hidden, Effect(dry.name, effect.joints, borne)


def _has_bristles(effect: PlantEffect) -> bool:
    kind, p, *_ = resolve_synthetic_effects([effect])[0]
    return bool(kind.friction) and kind.friction(p, 0.0)[0] == BRISTLE


def _torques(plant: Plant, motion: Motion, start: float) -> tuple[Array, Array]:
    """Return torque, and torque less that of the rigid body where encoders read.

    Both without what is too fast to be seen [N m]. Shapes (n, dof).
    """
    step = float(motion.t[1] - motion.t[0])
    made = true_torque(plant, motion, "stage", start)
    off = made.reading - motion.q
    first = np.gradient(off, step, axis=0)
    second = np.gradient(first, step, axis=0)
    rigid = compute_inverse_dynamics(
        plant.robot.model, made.reading, motion.qd + first, motion.qdd + second
    )
    low = butter(4, 2 * _CUTOFF * step, output="sos")
    torque, rest = (sosfiltfilt(low, x, axis=0) for x in (made.tau, made.tau - rigid))
    return torque, rest


SEEDS, OF_A_NAME = 500, 20  # drawn by the demonstration, of any name and of each
TABLE = Path(demo.__file__).with_name("visible.json")
_RATE = 100.0  # Hz


def stages_of(seed: int) -> list[Stage]:
    """Return the motions of a demonstration; other Fourier ones stand in for its own.

    The search for those takes as long as the experiments.
    """
    robot, stages = load_robot(demo.ROBOT), []
    for _, start, motion in demo.generate_motion_tables(seed, demo.FIT):
        reference = plan_reference_motion(robot, TrajectorySpec(**motion), _RATE, False)
        stages.append(Stage.of(robot, reference, start))
    return stages


def larger(name: str, seed: int, stages: Sequence[Stage]) -> list | None:
    """Return what is hidden instead of the usual draw; None if that is visible."""
    robot = load_robot(demo.ROBOT)
    usual = draw_plant_effect(robot, make_rng(seed, HIDDEN), name or None)
    shown = draw_visible(robot, make_rng(seed, HIDDEN), stages, name or None)
    same = shown == usual
    return None if same else [shown.name, list(shown.joints), dict(shown.parameters)]


def main() -> None:
    table: dict[str, dict] = {
        name: {"seeds": OF_A_NAME if name else SEEDS, "larger": {}}
        for name in ("", *sorted(list_plant_effects()))
    }
    for seed in range(SEEDS):
        stages = stages_of(seed)
        for name, entry in table.items():
            if seed < entry["seeds"] and (one := larger(name, seed, stages)):
                entry["larger"][seed] = one
        print(f"seed {seed}", flush=True)
    text = json.dumps(table).replace('], "', '],\n  "').replace('}, "', '},\n "')
    Path(*sys.argv[1:] or [TABLE]).write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
