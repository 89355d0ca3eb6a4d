"""Curves in time, limits of planned motions, and their checks.

Planned motions leave a reserve, so that a controller can still correct, and an arm
heavier or stiffer than the nominal one can still follow.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from residual.errors import InputError
from residual.recording import Array
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import Robot
from sim.engine.geometry import MARGIN, ArmCapsules, build_arm_capsules, compute_clearances
from sim.engine.plant_records import DriveParameters
from sim.plant.effect_catalogue import list_drive_effects
from sim.plant.typical_sizes import compute_usual_motion_range, read_declared_values

# Curves in time: Fourier series, quick moves, paths; sequences of stages.
#
# Each starts and ends at rest.


Motion = tuple[Array, Array, Array]  # q, qd and qdd, shapes (n, dof)
Curve = Callable[[Array], Motion]  # at any times, shape (n,)

RAMP = 1.0  # s in which a series goes from rest to full speed, and back at the end
_STROKE_RAMP = 0.2  # share of a stroke in which it accelerates, and decelerates
# Largest speed and acceleration of the quintic, for a unit move in unit time.
_SPEED, _ACCELERATION = 1.875, 10 / np.sqrt(3)


@dataclass(frozen=True, eq=False, slots=True)
class FourierSeries:
    """q(s) = centre + sum_k sine_k sin(k w s) + cosine_k cos(k w s).

    w = 2 pi / period.
    """

    centre: Array  # middle of the motion [rad], (dof,)
    sine: Array  # coefficients of harmonics 1 to h [rad], (h, dof)
    cosine: Array  # coefficients of harmonics 1 to h [rad], (h, dof)
    period: float  # length of one period [s]


def evaluate_ramped_series(
    series: FourierSeries, t: Array, duration: float
) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations at the times t.

    The path time s(t) starts and ends at rest: q = q(s), qd = q' s', and
    qdd = q'' s'^2 + q' s''.
    """
    s, sd, sdd = compute_ramped_time(t, duration)
    q, first, second = (differentiate_series(series, s, d) for d in range(3))
    sd, sdd = sd[:, None], sdd[:, None]
    return series.centre + q, first * sd, second * sd**2 + first * sdd


def bound_series_peaks(series: FourierSeries) -> tuple[Array, Array, Array]:
    """Return bounds of |q - centre|, |q'| and |q''| that hold for every s. (dof,)."""
    s = np.linspace(0, series.period, 400)
    size = np.hypot(series.sine, series.cosine)
    rate = 2 * np.pi / series.period * np.arange(1, len(size) + 1)[:, None]
    step = s[1] - s[0]

    def largest(times: int) -> Array:
        # Between two grid points a curve exceeds them by at most h^2/8 max|f''|.
        bend = (size * rate ** (times + 2)).sum(axis=0)
        grid = np.abs(differentiate_series(series, s, times)).max(axis=0)
        return grid + step**2 / 8 * bend

    position, velocity, acceleration = (largest(d) for d in range(3))
    return position, velocity, acceleration


def differentiate_series(series: FourierSeries, s: Array, order: int) -> Array:
    """Return the d-th derivative of q - centre with respect to s. Shape (n, dof)."""
    rate = 2 * np.pi / series.period * np.arange(1, len(series.sine) + 1)
    angle = np.outer(s, rate) + order * np.pi / 2
    factor = rate[:, None] ** order
    return np.sin(angle) @ (factor * series.sine) + np.cos(angle) @ (factor * series.cosine)


def compute_ramped_time(
    t: Array, duration: float, ramp: float = RAMP
) -> tuple[Array, Array, Array]:
    """Return s, s' and s'': s' rises over one ramp by 10x^3 - 15x^4 + 6x^5.

    Args:
        duration: Length of the motion, at least two ramps [s].
        ramp: Time from rest to s' = 1 and back [s].

    Returns:
        Path time [s], which ends at duration - ramp, and its derivatives. Shape (n,).
    """
    rise, fall = (np.clip(x / ramp, 0, 1) for x in (t, duration - t))

    def area(x: Array) -> Array:
        return ramp * (2.5 * x**4 - 3 * x**5 + x**6)

    def height(x: Array) -> Array:
        return 10 * x**3 - 15 * x**4 + 6 * x**5

    def slope(x: Array) -> Array:
        return 30 * x**2 * (1 - x) ** 2 / ramp

    plateau = np.clip(t - ramp, 0, duration - 2 * ramp)
    s = area(rise) + plateau + ramp / 2 - area(fall)
    return s, height(rise) + height(fall) - 1, slope(rise) - slope(fall)


def evaluate_quintic_move(
    start: Array, end: Array, time: float, x: Array
) -> tuple[Array, Array, Array]:
    """Return position, velocity and acceleration of a move from rest to rest. (n, dof).

    Args:
        x: Shares of that time, from 0 to 1. Shape (n, 1).
    """
    return (
        start + (end - start) * (10 * x**3 - 15 * x**4 + 6 * x**5),
        (end - start) / time * 30 * x**2 * (1 - x) ** 2,
        (end - start) / time**2 * 60 * x * (1 - x) * (1 - 2 * x),
    )


def find_shortest_move_time(way: Array, velocity: Array, acceleration: Array) -> float:
    """Return the shortest time in which all joints keep their limits [s]."""
    way = np.abs(way)
    by_speed = _SPEED * way / velocity
    by_acceleration = np.sqrt(_ACCELERATION * way / acceleration)
    return max(0.4, float(by_speed.max()), float(by_acceleration.max()))


@dataclass(frozen=True, eq=False, slots=True)
class MotionStage:
    """A part of a program."""

    time: float  # how long it takes [s]
    motion: Curve  # q, qd and qdd at times from its own start


def build_dwell(q: Array, time: float) -> MotionStage:
    """Return a stage in which nothing moves. Shape of q (dof,)."""

    def motion(t: Array) -> Motion:
        still = np.zeros((len(t), len(q)))
        return still + q, still, still

    return MotionStage(time, motion)


def build_joint_move(start: Array, end: Array, time: float) -> MotionStage:
    """Return a move of all joints together, by a polynomial of fifth order."""
    return MotionStage(time, lambda t: evaluate_quintic_move(start, end, time, t[:, None] / time))


@dataclass(frozen=True, eq=False, slots=True)
class JointPath:
    """Joint angles along a path, q(x) for x from 0 to 1."""

    coefficients: Array  # of Chebyshev polynomials in 2 x - 1, (order + 1, dof)

    def at(self, x: Array, order: int = 0) -> Array:
        """Return the d-th derivative by x. Shape (n, dof)."""
        slope = chebyshev.chebder(self.coefficients, order) * 2.0**order
        return chebyshev.chebval(2 * x - 1, slope).T


def compute_path_nodes(count: int) -> Array:
    """Return where a path must be known, from 0 to 1, both included. (count,)."""
    return (chebyshev.chebpts2(count) + 1) / 2


def interpolate_joint_path(q: Array) -> JointPath:
    """Return the path through joint angles at the nodes. Shape (nodes, dof)."""
    points = chebyshev.chebpts2(len(q))
    return JointPath(chebyshev.chebfit(points, q, len(q) - 1))


def build_path_stage(path: JointPath, time: float, constant_speed: bool) -> MotionStage:
    """Return a stage that follows a path.

    Args:
        constant_speed: Whether the speed along the path is constant except at its ends;
            else the path is run through like a quick move.
    """

    def motion(t: Array) -> Motion:
        if constant_speed:
            ramp = _STROKE_RAMP * time
            x, xd, xdd = (v / (time - ramp) for v in compute_ramped_time(t, time, ramp))
        else:
            unit = evaluate_quintic_move(np.zeros(1), np.ones(1), time, t[:, None] / time)
            x, xd, xdd = (v[:, 0] for v in unit)
        first, second = path.at(x, 1), path.at(x, 2)
        xd, xdd = xd[:, None], xdd[:, None]
        return path.at(x), first * xd, second * xd**2 + first * xdd

    return MotionStage(time, motion)


def find_shortest_stage_time(stage: MotionStage, velocity: Array, acceleration: Array) -> float:
    """Return the shortest time in which a stage keeps speeds and accelerations [s].

    Slower by a factor, a stage from rest to rest has speeds lower by that factor and
    accelerations by its square.
    """
    _, qd, qdd = stage.motion(np.linspace(0, stage.time, 400))
    by_speed = (np.abs(qd) / velocity).max()
    by_acceleration = np.sqrt((np.abs(qdd) / acceleration).max())
    return stage.time * float(max(by_speed, by_acceleration))


def repeat_stages(stages: list[MotionStage]) -> Curve:
    """Return the motion that runs through the stages again and again."""
    ends = np.cumsum([stage.time for stage in stages])

    def motion(t: Array) -> Motion:
        own = np.mod(t, ends[-1])
        which = np.minimum(np.searchsorted(ends, own, side="right"), len(stages) - 1)
        parts = np.zeros((3, len(t), stages[0].motion(np.zeros(1))[0].shape[1]))
        for i, stage in enumerate(stages):
            rows = np.flatnonzero(which == i)
            inside = own[rows] - (ends[i] - stage.time)
            parts[:, rows] = stage.motion(np.clip(inside, 0.0, stage.time))
        q, qd, qdd = parts
        return q, qd, qdd

    return motion


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
    """A motion exceeds a limit of the arm.

    Attributes:
        joint: The joint, from 1; 0 where the arm as a whole is meant.
        time: When [s].
        value: The value of the motion there.
        limit: The allowed value.
    """

    def __init__(self, message: str, joint: int, time: float, value: float, limit: float) -> None:
        super().__init__(message)
        self.joint, self.time, self.value, self.limit = joint, time, value, limit


def read_planning_limits(robot: Robot) -> PlanningLimits:
    """Return the limits of planned motions of a robot.

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
    """A robot with all limits of its motion."""

    robot: Robot
    limits: PlanningLimits  # limits of a motion
    arm: ArmCapsules  # its capsules
    period: float  # length of one period of a motion [s]


def build_workspace(robot: Robot, period: float) -> MotionWorkspace:
    """Return the workspace for motions of a period [s]."""
    return MotionWorkspace(
        robot, read_planning_limits(robot), build_arm_capsules(robot.model), period
    )


def read_declared_drives(robot: Robot) -> DriveParameters:
    """Return the declared values of a robot; zero where there are none."""
    nothing = np.zeros(robot.dof)
    known = {e.of_drive: read_declared_values(robot, e, nothing) for e in list_drive_effects()}
    return DriveParameters(**known)


def bound_nominal_torque(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the nominal torque, friction of the worse direction [N m]. (n, dof)."""
    own = read_declared_drives(robot)
    rigid = compute_inverse_dynamics(robot.model, q, qd, qdd)
    return np.abs(rigid + own.rotor * qdd + own.viscous * qd) + own.coulomb


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
        MotionLimitError: With the joint, when, and by how much.
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
            f"{kind}: at {t[row]:.2f} s the clearance of {arm.names[worst]} is "
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
