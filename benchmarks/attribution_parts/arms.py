"""Logs of arms whose given values are off, and sets of changed values.

One seed makes the arm and the motions, another the noise and the changes.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from benchmarks.harness.logs import Logs, list_motions, record
from residual.robot.robot import Robot, build_robot, load_robot
from sim.engine.plant_records import PlantEffect, ReferenceMotion
from sim.plant.sensors import WHITE_TORQUE
from sim.plant.typical_sizes import draw_plant_effect, estimate_typical_sizes
from tests.synthetic.amounts import scale_effect
from tests.synthetic.light_arm import draw_light_arm
from tests.synthetic.quasi_static import Plant, true_torque

Array = np.ndarray

SIX, SEVEN = "six", "seven"
KINDS = (SIX, SEVEN)
OFF = (0.0, 0.01, 0.03)  # relative deviation of given values from the truth
FIT = ("fourier", "fourier", "cyclic", "slow_cyclic", "move_stop_move")
HELD_OUT = ("fourier", "cyclic")
_QUICK_FIT, _QUICK_HELD_OUT = ("fourier", "cyclic", "move_stop_move"), ("fourier",)
_NOISE = 0.003  # of the torque range, white; a third of it slow
_STEP = 2.5e-5  # rad, of the encoders: 18 bits a turn


@dataclass(frozen=True, slots=True)
class Arm:
    """One arm and its motions."""

    kind: str  # "six" or "seven"
    off: float  # how far its given values are off, as a share
    seed: int  # seed of the arm and of the motions
    noise: int  # seed of the noise
    quick: bool = False  # whether its logs are few and short

    @property
    def robot(self) -> Robot:
        """Its description, with values of friction and rotors."""
        return six() if self.kind == SIX else draw_light_arm(self.seed)

    def plant(self, effects: Sequence[PlantEffect]) -> Plant:
        """Return the arm itself with what changed."""
        return Plant(self.robot, tuple(effects), self.seed, scatter=self.off)


@lru_cache(maxsize=1)
def six() -> Robot:
    """Return the built-in arm; what its file assumes of the drives is given here."""
    robot = load_robot("irb140")
    content = json.loads(robot.toml)
    for table in content["declared"].values():
        table.pop("assumed")
        table.pop("source")
    return build_robot(robot.name, robot.urdf, json.dumps(content, sort_keys=True))


def make(arm: Arm, effects: Sequence[PlantEffect]) -> Logs:
    plant, seconds = arm.plant(effects), 12.0 if arm.quick else 20.0
    fit, held_out = (_QUICK_FIT, _QUICK_HELD_OUT) if arm.quick else (FIT, HELD_OUT)
    span = estimate_typical_sizes(arm.robot).torque * _NOISE / WHITE_TORQUE
    made = [
        record(plant, path, name, arm.noise, start, span=span, step=_STEP)
        for name, path, start in list_motions(arm.robot, fit, held_out, seconds, arm.seed)
    ]
    return Logs(arm.robot, tuple(made[: len(fit)]), tuple(made[len(fit) :]))


Rng = np.random.Generator

BODIES = PAYLOAD, LINK = "payload", "link_inertia"
DRIVES = {"coulomb": "level", "viscous": "coefficient"}
# How often there is a load, of which share of the arm's mass, links by which share off,
# friction by which share more, and the least share of a joint's torque [rms].
_LOADS, _LOAD, _LINK, _DRIVE, _LEAST = 0.7, (0.01, 0.06), (0.08, 0.25), (0.2, 1.5), 0.02


def draw_set(arm: Arm, rng: Rng) -> list[PlantEffect]:
    """Draw a load, links of another mass and friction, sized by what they do.

    The unit is physical, not the diagnosis's: each moves some joint's torque by 2 % of
    its rms on the first motion. What does less is left out, and a set may be empty.
    """
    made: list[PlantEffect] = []
    joints = np.arange(1, arm.robot.dof + 1)
    if rng.uniform() < _LOADS:
        usual = draw_plant_effect(arm.robot, rng, PAYLOAD)
        weight = sum(body.mass for body in list(arm.robot.model.inertias)[1:])
        mass = weight * rng.uniform(*_LOAD)
        made.append(scale_effect(usual, mass / dict(usual.parameters)["mass"]))
    links = rng.choice(joints[1:-1], size=int(rng.integers(0, 3)), replace=False)
    for link in links:
        scale = float(rng.uniform(*_LINK) * rng.choice([-1, 1]))
        made.append(PlantEffect(LINK, (int(link),), (("scale", scale),)))
    given = estimate_typical_sizes(arm.robot)
    for joint in rng.choice(joints, size=int(rng.integers(0, 3)), replace=False):
        kind = str(rng.choice(list(DRIVES)))
        size = float(rng.uniform(*_DRIVE) * getattr(given, kind)[joint - 1])
        made.append(PlantEffect(kind, (int(joint),), ((DRIVES[kind], size),)))
    ((_, first, _),) = list_motions(arm.robot, FIT[:1], (), 20.0, arm.seed)
    return [effect for effect in made if _share_of(arm, first, effect) >= _LEAST]


def _share_of(arm: Arm, path: ReferenceMotion, effect: PlantEffect) -> float:
    """Rms torque of an effect as a share of its joint's, where it is largest."""
    there, bare = (
        true_torque(arm.plant(effects), path, "share").tau for effects in ((effect,), ())
    )
    rms = [np.sqrt(np.mean(x**2, axis=0)) for x in (there - bare, bare)]
    return float(np.max(rms[0] / rms[1]))
