"""Logs of arms whose given values are off by little, much or not at all.

One seed makes the arm and the motions, another the noise and what changed: all
cases of one arm share the sizes that its logs would show.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from benchmarks.synthetic.motions import make_motion
from residual.recording import Recording
from residual.robot.robot import Robot, load_robot, robot_from_texts
from sim.catalogue import of_drives
from sim.draw import light_arm
from sim.plant.sensors import WHITE_TORQUE, encoder, torque_noise
from sim.quasi_static import Plant, true_friction, true_torque
from sim.records import Hidden, PlantEffect, Reference, stream
from sim.sizes import room, sizes

Array = np.ndarray

SIX, SEVEN = "six", "seven"
KINDS = (SIX, SEVEN)
OFF = (0.0, 0.01, 0.03, 0.1)  # what is given, off the truth: a relative deviation
RATE, PAUSE = 250.0, 10.0  # Hz, s
FIT = ("fourier", "fourier", "cyclic", "slow_cyclic", "move_stop_move")
HELD_OUT = ("fourier", "cyclic")
EDITED = "edited"  # name of the log of the arm that never had a change
_QUICK_FIT, _QUICK_HELD_OUT = ("fourier", "cyclic", "move_stop_move"), ("fourier",)
_NOISE = 0.003  # of the torque range, white; a third of it slow
_STEP = 2.5e-5  # rad, of the encoders: 18 bits a turn


@dataclass(frozen=True, slots=True)
class Arm:
    """One arm and its motions.

    Attributes:
        kind: "six" or "seven".
        off: How far its given values are off, as a share.
        seed: Seed of the arm and of the motions.
        noise: Seed of the noise.
        quick: Whether its logs are few and short.
    """

    kind: str
    off: float
    seed: int
    noise: int
    quick: bool = False

    @property
    def robot(self) -> Robot:
        """Its description, with values of friction and rotors."""
        return six() if self.kind == SIX else light_arm(self.seed)

    def plant(self, effects: Sequence[PlantEffect]) -> Plant:
        """Return the arm itself with what changed."""
        hidden = tuple(Hidden(e.name, e.joints, dict(e.parameters)) for e in effects)
        return Plant(self.robot, hidden, self.seed, scatter=self.off)


@dataclass(frozen=True, eq=False, slots=True)
class Made:
    """The logs of one case."""

    robot: Robot
    fit: tuple[Recording, ...]
    held_out: tuple[Recording, ...]


@lru_cache(maxsize=1)
def six() -> Robot:
    """Return the built-in arm; what its file assumes of the drives is given here."""
    robot = load_robot("irb140")
    content = json.loads(robot.toml)
    for table in content["declared"].values():
        table.pop("assumed")
        table.pop("source")
    return robot_from_texts(robot.name, robot.urdf, json.dumps(content, sort_keys=True))


def make(arm: Arm, effects: Sequence[PlantEffect]) -> Made:
    """Record one case.

    Args:
        effects: What changed.
    """
    plant, seconds = arm.plant(effects), 12.0 if arm.quick else 20.0
    families = (_QUICK_FIT, _QUICK_HELD_OUT) if arm.quick else (FIT, HELD_OUT)
    logs = []
    for place, family in enumerate((*families[0], *families[1])):
        part = "fit" if place < len(families[0]) else "held_out"
        name = f"{part}_{place}_{family}"
        start = place * (seconds + PAUSE)
        logs.append(record(arm, plant, name, motion(arm, name, family, seconds), start))
    count = len(families[0])
    return Made(arm.robot, tuple(logs[:count]), tuple(logs[count:]))


def make_edited(arm: Arm, effects: Sequence[PlantEffect]) -> Recording:
    """Record the arm with other changes in a motion of its own, with other noise."""
    seconds = 12.0 if arm.quick else 20.0
    made = motion(arm, EDITED, "fourier", seconds)
    return record(arm, arm.plant(effects), EDITED, made, 0.0)


def motion(arm: Arm, name: str, family: str, seconds: float) -> Reference:
    """Return the motion of one log."""
    rng = stream(arm.seed, f"motion/{name}")
    return make_motion(family, room(arm.robot), seconds, RATE, rng)


def record(
    arm: Arm, plant: Plant, name: str, moved: Reference, start: float
) -> Recording:
    """Return what the sensors make of one motion."""
    torque = true_torque(plant, moved, name, start)
    span = sizes(arm.robot).torque * _NOISE / WHITE_TORQUE
    noise = torque_noise(len(moved.t), span, RATE, stream(arm.noise, f"torque/{name}"))
    rng = stream(arm.noise, f"encoder/{name}")
    q = encoder(torque.reading, rng, _STEP)
    log = Recording(name, arm.robot.name, moved.t, q, torque.tau + noise)
    return replace(log, t=start + moved.t)


def moved_values(
    arm: Arm, effects: Sequence[PlantEffect]
) -> dict[tuple[str, int], tuple[float, float]]:
    """Return what is given of each drive and what it is, changes included.

    Returns:
        By name and joint from 1: the given value and the true one, SI.
    """
    robot = arm.robot
    true, given = true_friction(arm.plant(())), sizes(robot)
    out = {}
    for what in of_drives():
        for joint in range(1, robot.dof + 1):
            there, said = (
                float(getattr(x, str(what.of_drive))[joint - 1]) for x in (true, given)
            )
            there += sum(
                dict(e.parameters)[what.amount[0]]
                for e in effects
                if e.name == what.name and joint in e.joints
            )
            out[what.name, joint] = said, there
    return out
