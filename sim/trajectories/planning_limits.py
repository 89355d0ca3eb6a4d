"""What a motion may use, and whether it does.

Planned motions keep a part of what the arm has, so that a controller can still correct
and a heavier or stiffer arm than the nominal one can still follow.
"""

from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.recording import Array
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import Robot
from sim.engine.geometry import MARGIN, ArmCapsules, build_arm_capsules, compute_clearances
from sim.engine.plant_records import DriveParameters
from sim.plant.effect_catalogue import list_drive_effects
from sim.plant.typical_sizes import compute_usual_motion_range, read_declared_values
from sim.trajectories.motion_curves import Curve, Motion

SPEED, ACCELERATION, TORQUE = 0.8, 0.9, 0.8  # of the robot's own limits
_UNITS = {"range": "rad", "speed": "rad/s", "acceleration": "rad/s^2", "torque": "N m"}
_FINE, _COARSE = 1000.0, 100.0  # Hz, for limits and for clearance


@dataclass(frozen=True, eq=False, slots=True)
class PlanningLimits:
    """Limits of a planned motion, inf where the robot states none."""

    lower: Array  # lower end of the positions [rad], (dof,)
    upper: Array  # upper end of the positions [rad], (dof,)
    velocity: Array  # largest speed [rad/s], (dof,)
    acceleration: Array  # largest acceleration [rad/s^2], (dof,)
    torque: Array  # largest torque of the nominal model [N m], (dof,)

    @property
    def middle(self) -> Array:
        """Middle of the range [rad]. Shape (dof,)."""
        return (self.lower + self.upper) / 2

    @property
    def half(self) -> Array:
        """Half of the range [rad]. Shape (dof,)."""
        return (self.upper - self.lower) / 2


class MotionLimitError(InputError):
    """A motion asks for more than an arm may give.

    Attributes:
        joint: The joint, from 1; 0 where the arm as a whole is meant.
        time: When [s].
        value: What the motion needs there.
        limit: What it may need.
    """

    def __init__(self, message: str, joint: int, time: float, value: float, limit: float) -> None:
        super().__init__(message)
        self.joint, self.time, self.value, self.limit = joint, time, value, limit


def read_planning_limits(robot: Robot) -> PlanningLimits:
    """Return what planned motions of a robot may use.

    0.05 rad off the ends of each range, 80 % of speed and torque and 90 % of
    acceleration. Where the robot states none: one turn, 2 rad/s, and that speed within
    0.15 s; nothing is known of torque then.
    """
    space = compute_usual_motion_range(robot)
    speed = np.asarray(robot.velocity_limit, dtype=float)
    known = np.isfinite(speed) & (speed > 0)
    velocity = np.where(known, SPEED * speed, space.velocity)
    acceleration = velocity / 0.15
    if robot.acceleration_limit is not None:
        acceleration = ACCELERATION * robot.acceleration_limit
    torque = np.asarray(robot.torque_limit, dtype=float)
    torque = np.where(torque > 0, TORQUE * torque, np.inf)
    return PlanningLimits(space.lower, space.upper, velocity, acceleration, torque)


@dataclass(frozen=True, eq=False, slots=True)
class MotionWorkspace:
    """A robot with all that bounds its motion."""

    robot: Robot
    limits: PlanningLimits  # what a motion may use
    arm: ArmCapsules  # its capsules
    period: float  # length of one period of a motion [s]


def build_workspace(robot: Robot, period: float) -> MotionWorkspace:
    """Return what bounds motions of that period [s]."""
    return MotionWorkspace(
        robot, read_planning_limits(robot), build_arm_capsules(robot.model), period
    )


def read_declared_drives(robot: Robot) -> DriveParameters:
    """Return what a robot declares with values; zero where nothing."""
    nothing = np.zeros(robot.dof)
    known = {e.of_drive: read_declared_values(robot, e, nothing) for e in list_drive_effects()}
    return DriveParameters(**known)


def compute_torque_without_coulomb(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the nominal torque without Coulomb friction [N m]. Shape (n, dof)."""
    own = read_declared_drives(robot)
    rigid = compute_inverse_dynamics(robot.model, q, qd, qdd)
    return rigid + own.rotor * qdd + own.viscous * qd


def bound_nominal_torque(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the nominal torque, friction of the worse direction [N m]. (n, dof)."""
    level = read_declared_drives(robot).coulomb
    return np.abs(compute_torque_without_coulomb(robot, q, qd, qdd)) + level


def bound_overshoot_between_samples(values: Array) -> Array:
    """Return by how much a curve may exceed its samples between them. Shape (dof,).

    Half of the largest second difference: a smooth curve exceeds its chord by an
    eighth of it, one with a kink between two samples by less than a half.

    Args:
        values: Samples at a fine, even step. Shape (n, dof).
    """
    if len(values) < 3:
        return np.zeros(values.shape[1])
    return np.abs(np.diff(values, 2, axis=0)).max(axis=0) / 2


@dataclass(frozen=True, eq=False, slots=True)
class MotionPlan:
    """A motion at any time."""

    kind: str
    curve: Curve  # q, qd and qdd at any times from 0 to `duration`
    duration: float  # length [s]
    period: float  # length of one repetition [s]
    # Length from the start that shows all of it [s]: what comes after repeats.
    pattern_duration: float


def check_plan(robot: Robot, plan: MotionPlan) -> None:
    """Make sure that a motion keeps limits and clearance, between samples too.

    Raises:
        LimitError: With the joint, when, and by how much.
    """
    t = space_times_evenly(plan.pattern_duration, _FINE)
    motion = plan.curve(t)
    check_motion_limits(robot, plan.kind, t, motion)
    every = round(_FINE / _COARSE)
    check_motion_clearance(
        build_arm_capsules(robot.model), plan.kind, t[::every], motion[0][::every]
    )


def check_motion_limits(robot: Robot, kind: str, t: Array, motion: Motion) -> None:
    """Make sure that a motion keeps the limits at its samples and between them."""
    bounds = read_planning_limits(robot)
    q, qd, qdd = motion
    checks = {
        "range": (q - bounds.middle, bounds.half),
        "speed": (qd, bounds.velocity),
        "acceleration": (qdd, bounds.acceleration),
        "torque": (bound_nominal_torque(robot, q, qd, qdd), bounds.torque),
    }
    shares = {
        name: (np.abs(used) + bound_overshoot_between_samples(used)) / limit
        for name, (used, limit) in checks.items()
    }
    name = max(shares, key=lambda key: shares[key].max())
    share = shares[name]
    if share.max() <= 1 + 1e-9:
        return
    row, joint = divmod(int(share.argmax()), share.shape[1])
    used, limit = checks[name][0][row, joint], checks[name][1][joint]
    # Where no sample is beyond the limit, it is between samples that it is broken.
    size = abs(used) if abs(used) > limit else limit * share.max()
    excess, shift, side = size - limit, 0.0, 1.0
    if name == "range":
        shift, side = bounds.middle[joint], np.sign(used)
    needed, allowed = float(shift + side * size), float(shift + side * limit)
    worst = np.max([each.max(axis=0) for each in shares.values()], axis=0)
    other = [str(j + 1) for j in np.flatnonzero(worst > 1 + 1e-9) if j != joint]
    also = f" Beyond a limit too: joint {', '.join(other)}." if other else ""
    # Speeds fall with the time a motion takes, accelerations with its square.
    longer = share.max() if name == "speed" else np.sqrt(share.max())
    advice = f"Make a period about {longer:.1f} times as long, or try another seed."
    raise MotionLimitError(
        f"{kind}: joint {joint + 1} breaks its {name} limit at {t[row]:.2f} s: "
        f"{needed:.4g} {_UNITS[name]}, allowed {allowed:.4g}, {excess:.3g} too "
        f"much.{also} {'Try another seed.' if name == 'range' else advice}",
        joint + 1,
        float(t[row]),
        needed,
        allowed,
    )


def check_motion_clearance(arm: ArmCapsules, kind: str, t: Array, q: Array) -> None:
    """Make sure that an arm stays clear of the floor and of itself."""
    space = compute_clearances(arm, q)
    if not space.size:
        return
    space = space - bound_overshoot_between_samples(space)
    row, worst = np.unravel_index(int(space.argmin()), space.shape)
    least = float(space[row, worst])
    if least < MARGIN:
        raise MotionLimitError(
            f"{kind}: at {t[row]:.2f} s the room of {arm.names[worst]} is "
            f"{1000 * least:.0f} mm, needed {1000 * MARGIN:.0f} mm, "
            f"{1000 * (MARGIN - least):.0f} mm too little (arm as capsules of "
            f"{1000 * arm.radius:.0f} mm radius). Try another seed.",
            0,
            float(t[row]),
            least,
            MARGIN,
        )


def space_times_evenly(duration: float, rate: float) -> Array:
    """Return even times from 0 to the duration, both included [s]. Shape (n,)."""
    return np.arange(round(duration * rate) + 1) / rate
