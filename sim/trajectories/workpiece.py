"""Where a work piece may stand: a plane in front of the arm that a tool works on."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.geometry import (
    MARGIN,
    NEAR_SINGULAR,
    Body,
    Kinematics,
    body,
    clearances,
    dexterity,
    inverse,
    kinematics,
    pose,
)
from sim.sizes import room
from sim.trajectories.limits import Limits, plan_limits

_GUESSES = 6  # postures that the arm is tried in
# Ranges that a work piece is drawn from; lengths as shares of the stretched arm.
_ASIDE = (-0.4, 0.4)  # rad
_AWAY, _HIGH = (0.35, 0.6), (0.15, 0.6)
_DOWN = (0.35, 1.4)  # rad that the tool points below the horizon
_SIDEWAYS = (-0.6, 0.6)  # rad that it points away from straight ahead
_WIDE, _TALL = (0.10, 0.18), (0.05, 0.10)  # half sizes


@dataclass(frozen=True, eq=False, slots=True)
class Cell:
    """An arm with all that bounds a path of its tool.

    Attributes:
        robot: The arm.
        limits: What a motion may use.
        arm: Its capsules.
        ways: Its kinematics.
    """

    robot: Robot
    limits: Limits
    arm: Body
    ways: Kinematics

    def fits(self, q: Array) -> bool:
        """Say whether postures are in range, clear of all and not near singular."""
        inside = (q >= self.limits.lower) & (q <= self.limits.upper)
        return bool(
            inside.all()
            and dexterity(self.ways, q).min() > NEAR_SINGULAR
            and (clearances(self.arm, q) >= MARGIN).all()
        )


@dataclass(frozen=True, eq=False, slots=True)
class Piece:
    """A plane to work on.

    Attributes:
        origin: Pose of the flange over its middle.
        across: Level direction in the plane. Shape (3,).
        along: Direction in the plane that is square to it. Shape (3,).
        half: Half sizes across and along [m]. Shape (2,).
        posture: Joint angles with the tool in the middle [rad]. Shape (dof,).
    """

    origin: pin.SE3
    across: Array
    along: Array
    half: Array
    posture: Array

    def pose(self, x: float, y: float, turn: Array, lift: float = 0.0) -> pin.SE3:
        """Return the pose of the flange over a point.

        Args:
            x: Place across, from -1 to 1.
            y: Place along, from -1 to 1.
            turn: Rotation away from the upright tool, a vector in the base frame
                [rad]. Shape (3,).
            lift: Height above the plane [m].
        """
        off = np.cross(self.across, self.along)
        place = self.origin.translation + x * self.half[0] * self.across
        place = place + y * self.half[1] * self.along + lift * off
        return pin.SE3(pin.exp3(turn) @ self.origin.rotation, place)


def cell(robot: Robot, family: str) -> Cell:
    """Return the cell of a robot; the error of `kinematics` for a short arm."""
    limits = plan_limits(robot)
    return Cell(robot, limits, body(robot.model), kinematics(robot, family))


def draw_piece(space: Cell, rng: np.random.Generator) -> Piece | None:
    """Draw a work piece in front of the arm; None where the arm cannot work on it."""
    ways = space.ways
    angle = _front(ways) + rng.uniform(*_ASIDE)
    away, high = (ways.length * rng.uniform(*share) for share in (_AWAY, _HIGH))
    down, roll = rng.uniform(*_DOWN), rng.uniform(0, 2 * np.pi)
    half = ways.length * np.array([rng.uniform(*_WIDE), rng.uniform(*_TALL)])
    ahead = angle + rng.uniform(*_SIDEWAYS)
    across = np.array([-np.sin(ahead), np.cos(ahead), 0.0])
    tool = np.array([np.cos(ahead), np.sin(ahead), -np.tan(down)]) * np.cos(down)
    place = np.array([away * np.cos(angle), away * np.sin(angle), high])
    rotation = _turned(ways.tool, tool) @ pin.exp3(roll * ways.tool)
    posture = _best_posture(space, pin.SE3(rotation, place), rng)
    if posture is None:
        return None
    # across x along points back along the tool, so that a lift leaves the piece.
    along = np.cross(across, tool)
    return Piece(pin.SE3(rotation, place), across, along, half, posture)


def _best_posture(
    space: Cell, target: pin.SE3, rng: np.random.Generator
) -> Array | None:
    """Return the posture for a pose that is farthest from singular ones. (dof,)."""
    limits, found, usual = space.limits, [], room(space.robot)
    for share in rng.uniform(-1, 1, (_GUESSES, space.robot.dof)):
        guess = usual.centre + share * usual.amplitude
        q = inverse(space.ways, target, guess)
        if q is None:
            continue
        # Whole turns are the same posture; the one amid the range has most room.
        q = q - 2 * np.pi * np.round((q - limits.middle) / (2 * np.pi))
        if space.fits(q[None]):
            found.append(q)
    free = [float(dexterity(space.ways, q[None])[0]) for q in found]
    return found[int(np.argmax(free))] if found else None


def no_room(family: str, robot: Robot) -> InputError:
    """Return the error where no work piece was found that the arm can reach."""
    return InputError(
        f"{family}: found no place for a work piece that {robot.name} reaches within "
        "its ranges, clear of the floor and itself and away from singular postures. "
        "Try another seed, or fourier."
    )


def _front(ways: Kinematics) -> float:
    """Return the direction in which the arm points at its zero posture [rad]."""
    place = pose(ways, pin.neutral(ways.model)).translation
    if np.hypot(*place[:2]) < 0.05 * ways.length:
        return 0.0
    return float(np.arctan2(place[1], place[0]))


def _turned(a: Array, b: Array) -> Array:
    """Return the rotation that turns direction a into b. Shape (3, 3)."""
    return pin.Quaternion.FromTwoVectors(a, b).toRotationMatrix()
