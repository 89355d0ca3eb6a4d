"""Exciting motions, and how well a motion excites the rigid body's parameters.

A motion has five harmonics per joint,

q(t) = a0 + sum_k a_k cos(k w t) + b_k sin(k w t)    (G2017 eq. 4)

with sum_k k b_k = 0 and sum_k k^2 a_k = 0, so that speed and acceleration are zero
wherever a period begins. Each joint moves as far as its range, speed and acceleration
let it (eq. 5), which are bounded over the whole period and not only at samples. A
motion may also be given by its coefficients, for example a slow one, which no search
would yield.

W theta = tau stacks the base regressor over samples (G2017 eq. 6). Its columns are
normalized to length one, so that neither units nor the size of a parameter count; the
condition number of the result bounds the amplification of noise from tau to theta
(Swevers et al. 1997, cited there). log det measures the total information.

The search for the best motion needs no finite differences over coefficients. The regressor at
one sample depends on q, qd and qdd of that sample alone, so its 3 dof derivatives there
give the slope by every coefficient; they are taken by differences, since Pinocchio has
none of the regressor.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin
from scipy.linalg import eigh, null_space
from scipy.optimize import minimize

from residual.errors import InputError
from residual.recording import Array
from residual.robot.dynamics import (
    compute_inertial_regressor,
    find_independent_columns,
    read_inertial_parameters,
)
from residual.robot.robot import Robot
from sim.engine.geometry import MARGIN, compute_clearances
from sim.engine.plant_records import DriveParameters, ReferenceMotion
from sim.plant.typical_sizes import compute_usual_motion_range, draw_motion_centre
from sim.trajectories.planning_limits import (
    FourierSeries,
    MotionPlan,
    MotionWorkspace,
    bound_nominal_torque,
    bound_overshoot_between_samples,
    bound_series_peaks,
    build_workspace,
    differentiate_series,
    read_declared_drives,
)

HARMONICS = 5
FREE = 2 * (HARMONICS - 1)  # coefficients of a joint that rest at the ends leaves
_ORDER = np.arange(1, HARMONICS + 1)[:, None]
# b_k = beta_k / k and a_k = alpha_k / k^2, where the beta and the alpha add up to zero.
_BALANCED = null_space(np.ones((1, HARMONICS)))
_LEAST = 0.3  # a motion that must be made smaller than that is dropped
_SHRINK = 0.96
_KEPT = 0.998  # of the limits, for what coarser bounds add
_GRID = 400  # samples of a period that torque and clearance are taken at
_FEW = 10  # stride of the samples that are checked first
_TRIES = 100
_APART = 0.6  # of half of the range, where a centre may lie
DIGITS = 9  # of a number that is written down [rad]
_SLOW_TRIES = 50  # largest number of drawn slow motions


def expand_free_coefficients(free_coefficients: Array) -> tuple[Array, Array]:
    """Return sines and cosines at rest at t = 0. Shapes (8, dof) to 2 x (5, dof)."""
    sine, cosine = np.split(free_coefficients, 2)
    return _BALANCED @ sine / _ORDER, _BALANCED @ cosine / _ORDER**2


def sample_series(series: FourierSeries, t: Array) -> tuple[Array, Array, Array]:
    """Return positions, velocities and accelerations of a series. Shapes (n, dof)."""
    q, qd, qdd = (differentiate_series(series, t, d) for d in range(3))
    return series.centre + q, qd, qdd


def draw_feasible_series(workspace: MotionWorkspace, rng: np.random.Generator) -> FourierSeries:
    """Draw a random motion, scaled up to the limits."""
    for number in range(_TRIES):
        # Around the zero posture first, and anywhere if that fails.
        series = draw_unchecked_series(workspace, rng, anywhere=number >= _TRIES // 2)
        fitted = shrink_to_feasible(workspace, series)
        if fitted is not None:
            return fitted
    raise InputError(
        f"fourier: found no motion of {workspace.robot.name} that stays clear of "
        f"the floor "
        "and itself within its torque. Check effort limits and geometry of the URDF."
    )


def draw_unchecked_series(
    workspace: MotionWorkspace, rng: np.random.Generator, anywhere: bool
) -> FourierSeries:
    """Draw a motion that only keeps range, speed and acceleration.

    Args:
        anywhere: Whether its centre may lie anywhere in the range; else it is up to
            0.3 rad off the feasible posture nearest to zero.
    """
    limits = workspace.limits
    free = rng.normal(size=(FREE, workspace.robot.dof))
    near = draw_motion_centre(compute_usual_motion_range(workspace.robot), rng)
    far = limits.middle + rng.uniform(-_APART, _APART, len(near)) * limits.half
    centre = far if anywhere else near
    series = FourierSeries(centre, *expand_free_coefficients(free), workspace.period)
    # Every joint to the end of its range, speed or acceleration.
    return scale_series(series, compute_growth_factors(workspace, series))


def compute_growth_factors(workspace: MotionWorkspace, series: FourierSeries) -> Array:
    """Return the factor by which each joint may still grow about its centre. (dof,)."""
    limits = workspace.limits
    position, velocity, acceleration = bound_series_peaks(series)
    q = differentiate_series(series, np.arange(_GRID) / _GRID * workspace.period, 0)
    # What the bound of |q - centre| adds to the grid may be on either side.
    beyond = position - np.abs(q).max(axis=0)
    shares = [
        (limits.upper - series.centre) / (q.max(axis=0) + beyond),
        (series.centre - limits.lower) / (beyond - q.min(axis=0)),
        limits.velocity / velocity,
        limits.acceleration / acceleration,
    ]
    return np.clip(np.min(shares, axis=0) * _KEPT, 0.0, None)


def scale_series(series: FourierSeries, scale: Array | float) -> FourierSeries:
    """Return the series with a motion of another size about the same centre."""
    return replace(series, sine=scale * series.sine, cosine=scale * series.cosine)


def shrink_to_feasible(workspace: MotionWorkspace, series: FourierSeries) -> FourierSeries | None:
    """Shrink a motion until it keeps all limits and clearances."""
    series = scale_series(series, np.minimum(compute_growth_factors(workspace, series), 1.0))
    t, size = np.arange(_GRID) / _GRID * workspace.period, 1.0
    while size > _LEAST:
        smaller = scale_series(series, size)
        # A few samples reject most motions; accepting one needs all samples.
        few = _free(workspace, smaller, t[::_FEW], False)
        if few and _free(workspace, smaller, t, True):
            return smaller
        size *= _SHRINK
    return None


def _free(place: MotionWorkspace, series: FourierSeries, t: Array, fully: bool) -> bool:
    """Return whether torque and clearance hold at some times, `fully` also between them."""
    motion = sample_series(series, t)
    torque = bound_nominal_torque(place.robot, *motion)
    space = compute_clearances(place.arm, motion[0])
    if fully:
        torque = torque + bound_overshoot_between_samples(torque)
        space = space - bound_overshoot_between_samples(space)
    return bool((torque <= place.limits.torque).all() and (space >= MARGIN).all())


def export_series_coefficients(series: FourierSeries) -> tuple[tuple[float, ...], ...]:
    """Return the coefficients of a series at rest at its ends, rounded.

    Returns:
        Centre, then the free coefficients: 9 rows of dof numbers [rad].
    """
    # What `expand_free_coefficients` made the series of.
    free = _BALANCED.T @ (series.sine * _ORDER), _BALANCED.T @ (series.cosine * _ORDER**2)
    rows = np.vstack([series.centre, *free]).round(DIGITS) + 0.0
    return tuple(tuple(row) for row in rows.tolist())


def draw_excitation(
    robot: Robot, duration: float, periods: int, rng: np.random.Generator, optimised: bool = True
) -> Iterator[Iterable[MotionPlan]]:
    """Search for the most exciting motion, or draw one."""
    space = build_workspace(robot, duration / periods)
    find = optimize_excitation if optimised else draw_feasible_series
    yield [_plan_of(find(space, rng), duration)]


def build_given_series(
    robot: Robot, duration: float, periods: int, rows: Sequence[Sequence[float]]
) -> MotionPlan:
    """Return the motion of coefficients that `export_series_coefficients` gives."""
    shapes, dof = {len(row) for row in rows}, robot.dof
    if len(rows) != 1 + FREE or shapes != {dof}:
        raise InputError(
            f"coefficients: expected {1 + FREE} rows of {dof} numbers, got "
            f"{len(rows)} rows of {', '.join(str(n) for n in sorted(shapes))}."
        )
    values = np.array(rows, dtype=float)
    if not np.isfinite(values).all():
        raise InputError("coefficients: expected finite numbers.")
    free, period = expand_free_coefficients(values[1:]), duration / periods
    return _plan_of(FourierSeries(values[0], *free, period), duration)


def _plan_of(series: FourierSeries, duration: float) -> MotionPlan:
    curve, period = partial(sample_series, series), series.period
    return MotionPlan("fourier", curve, duration, period, period)


def draw_slow_coefficients(
    robot: Robot, period: float, speed: float, rng: np.random.Generator
) -> tuple[tuple[float, ...], ...]:
    """Draw a slow motion, for friction at low speed.

    Args:
        speed: Largest speed of any joint [rad/s].
    """
    place = build_workspace(robot, period)
    for _ in range(_SLOW_TRIES):
        series = draw_feasible_series(place, rng)
        slow = scale_series(series, np.minimum(1.0, speed / bound_series_peaks(series)[1]))
        fitted = shrink_to_feasible(place, slow)
        if fitted is not None:
            return export_series_coefficients(fitted)
    raise InputError(f"fourier: found no motion of {robot.name} below {speed:g} rad/s.")


_SHARP = 12  # power of the mean that stands for the extreme eigenvalues
_AMOUNT = 0.1  # weight of log det per parameter beside log condition
_FLOOR = 1e-13  # least eigenvalue that is distinguished from zero
_JUDGED = 1000  # samples for the evaluation of a motion

# Of the search.
_SAMPLES = 44  # of a period; the fastest harmonic has nine of them
_WEIGHT = 300.0  # of torque and clearance, which are penalties
_SPACE = 2.5 * MARGIN  # aimed at, since clearance is seen at few samples here
_INSIDE = 0.985  # of the limits, for the same reason
_STEP = 1e-6  # of the differences, in SI units
_PEAKED = 60  # power that stands for the largest of the samples
_DRAWN = 40  # random motions to choose the starts from
_STARTS = 2
_STEPS = (50, 120)  # of each start, and of the better one on its way on
_ENOUGH = 1e-5  # change of the cost that ends the search
_ASLEEP = 10.0  # a joint that could move so many times farther hardly moves
_STIRRED = 0.3  # of what it could


@dataclass(frozen=True, slots=True)
class Excitation:
    """The information in the samples of one motion on the base parameters."""

    # Condition number of the column-normalised base regressor W, inf where a parameter
    # is not excited.
    condition: float
    log_det: float  # log det(W' W / samples) of the regressor as it is, in SI units
    parameters: int  # number of base parameters


def measure_excitation(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Excitation:
    """Return how well some samples excite the base parameters."""
    columns = find_independent_columns(model)
    count = len(columns)
    stacked = compute_inertial_regressor(model, q, qd, qdd)[:, :, columns].reshape(-1, count)
    size = np.linalg.norm(stacked, axis=0)
    if len(stacked) < count or size.min() == 0:
        return Excitation(float("inf"), float("-inf"), count)
    values = np.linalg.svd(stacked / size, compute_uv=False)
    if values[-1] <= _FLOOR * values[0]:
        return Excitation(float("inf"), float("-inf"), count)
    amount = 2 * np.log(values * size).sum() - count * np.log(len(q))
    return Excitation(float(values[0] / values[-1]), float(amount), count)


@dataclass(frozen=True, eq=False, slots=True)
class LimitUsage:
    """Shares of the robot's own limits, NaN where it states none. Shapes (dof,)."""

    range: Array  # sweep of the motion, of the range
    speed: Array  # largest speed
    acceleration: Array  # largest acceleration
    torque: Array  # largest torque of the nominal model
    excitation: Excitation  # excitation of the base parameters by the motion


def compute_limit_usage(robot: Robot, reference: ReferenceMotion) -> LimitUsage:
    """Return the shares of a robot's limits that a motion uses."""
    q, qd, qdd = reference.q, reference.qd, reference.qdd
    torque = bound_nominal_torque(robot, q, qd, qdd)
    rows = np.unique(np.linspace(0, len(q) - 1, _JUDGED).astype(int))
    return LimitUsage(
        _share(np.ptp(q, axis=0), robot.upper - robot.lower),
        _share(np.abs(qd).max(axis=0), robot.velocity_limit),
        _share(np.abs(qdd).max(axis=0), robot.acceleration_limit),
        _share(torque.max(axis=0), robot.torque_limit),
        measure_excitation(robot.model, q[rows], qd[rows], qdd[rows]),
    )


def _share(used: Array, limit: Array | None) -> Array:
    limit = np.full(len(used), np.inf) if limit is None else np.asarray(limit)
    known = np.isfinite(limit) & (limit > 0)
    return np.where(known, used / np.where(known, limit, 1.0), np.nan)


def compute_excitation_cost(regressor: Array) -> tuple[float, Array]:
    """Return the cost that a better motion lowers, and its gradient.

    log condition - 0.1 log det(W' W) / b. The extreme eigenvalues of the
    column-normalised C = D^-1 W' W D^-1 are replaced by power means, since the true
    ones have no gradient where two of them meet:

    log condition ~ (log mean l^p + log mean l^-p) / 2p, p = 12.

    Args:
        regressor: W, more rows than columns. Shape (rows, b).

    Returns:
        The cost and its derivative by every entry of W. Shape (rows, b).
    """
    count = regressor.shape[1]
    gram = regressor.T @ regressor
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    values, vectors = eigh(gram / np.outer(size, size))
    values = np.maximum(values, _FLOOR)
    high, low = values**_SHARP, (values[0] / values) ** _SHARP
    condition = np.log(high.mean()) + np.log(low.mean()) - _SHARP * np.log(values[0])
    amount = (np.log(values).sum() + 2 * np.log(size).sum()) / count
    slope = (high / high.sum() - low / low.sum()) / (2 * values)
    by_c = (vectors * slope) @ vectors.T
    inverse = (vectors / values) @ vectors.T / np.outer(size, size)
    # C depends on the gram matrix G through its own diagonal too:
    # df/dG = D^-1 S D^-1 - diag((S C)_cc / G_cc), S = df/dC.
    by_gram = by_c / np.outer(size, size)
    by_gram -= np.diag((vectors**2 @ (slope * values)) / size**2)
    by_gram -= _AMOUNT / count * inverse
    return condition / (2 * _SHARP) - _AMOUNT * amount, 2 * regressor @ by_gram


@dataclass(frozen=True, eq=False, slots=True)
class ExcitationProblem:
    """Cost and limits of a motion, by unknowns x.

    x holds the centre, then FREE coefficients, per joint, all in units of half of that
    joint's range. Shape ((1 + FREE) * dof,).
    """

    place: MotionWorkspace
    columns: Array
    parameters: Array
    friction: DriveParameters
    basis: tuple[Array, Array, Array]  # q, qd, qdd per coefficient, (samples, FREE)

    def series(self, x: Array) -> FourierSeries:
        """Return the motion of x."""
        centre, free = self._unpack(x)
        return FourierSeries(centre, *expand_free_coefficients(free), self.place.period)

    def encode_series(self, series: FourierSeries) -> Array:
        """Return the unknowns of a motion that is at rest at its ends."""
        limits = self.place.limits
        both = np.vstack([series.sine, series.cosine])
        free = np.linalg.lstsq(np.vstack(expand_free_coefficients(np.eye(FREE))), both)[0]
        centre = (series.centre - limits.middle) / limits.half
        return np.vstack([centre, free / limits.half]).ravel()

    def cost(self, x: Array) -> tuple[float, Array]:
        """Return the cost of excitation, torque and clearance, and its slope."""
        q, qd, qdd = self._motion(x)
        value, slopes = self._excitation(q, qd, qdd)
        extra, slope = self._clearance(q)
        slopes[0] = slopes[0] + slope
        by_free = sum(b.T @ s for b, s in zip(self.basis, slopes, strict=True))
        gradient = np.vstack([slopes[0].sum(axis=0), by_free])
        return value + extra, (gradient * self.place.limits.half).ravel()

    def compute_margins(self, x: Array) -> Array:
        """Return the margins to range, speed and acceleration. Shape (3 * dof,)."""
        return np.concatenate([_INSIDE - _largest(u)[0] for u in self._shares(x)])

    def compute_margin_gradients(self, x: Array) -> Array:
        """Return the derivative of `compute_margins` by x. Shape (3 * dof, x)."""
        limits = self.place.limits
        dof, joints = len(limits.half), np.arange(len(limits.half))
        bounds = (limits.half, limits.velocity, limits.acceleration)
        out = np.zeros((3, dof, 1 + FREE, dof))
        for i, share in enumerate(self._shares(x)):
            slope = _largest(share)[1] * limits.half / bounds[i]
            out[i, joints, 1:, joints] = -(self.basis[i].T @ slope).T
            if i == 0:
                out[i, joints, 0, joints] = -slope.sum(axis=0)
        return out.reshape(3 * dof, -1)

    def _unpack(self, x: Array) -> tuple[Array, Array]:
        x = x.reshape(1 + FREE, -1) * self.place.limits.half
        return self.place.limits.middle + x[0], x[1:]

    def _motion(self, x: Array) -> tuple[Array, Array, Array]:
        centre, free = self._unpack(x)
        q, qd, qdd = (b @ free for b in self.basis)
        return centre + q, qd, qdd

    def _shares(self, x: Array) -> tuple[Array, Array, Array]:
        limits, (q, qd, qdd) = self.place.limits, self._motion(x)
        return ((q - limits.middle) / limits.half, qd / limits.velocity, qdd / limits.acceleration)

    def _excitation(self, q: Array, qd: Array, qdd: Array) -> tuple[float, list]:
        """Return the cost of excitation and torque, and its slopes by q, qd, qdd."""
        n, dof = q.shape
        rows = self._regressors(q, qd, qdd)
        value, slope = compute_excitation_cost(rows[0][:, :, self.columns].reshape(n * dof, -1))
        by_row = np.zeros(rows.shape[1:])
        by_row[:, :, self.columns] = slope.reshape(n, dof, -1)
        own = self.friction
        torque = rows[0] @ self.parameters + own.rotor * qdd + own.viscous * qd
        bound = np.maximum(_INSIDE * self.place.limits.torque - own.coulomb, 1e-9)
        extra, by_torque = _penalty(np.abs(torque) / bound - 1.0)
        by_torque = by_torque * np.sign(torque) / bound
        by_row += by_torque[:, :, None] * self.parameters
        turned = (rows[1:] - rows[0]).reshape(3 * dof, n, -1)
        turned = np.einsum("snp,np->sn", turned, by_row.reshape(n, -1)) / _STEP
        slopes = list(turned.reshape(3, dof, n).transpose(0, 2, 1))
        slopes[1] = slopes[1] + own.viscous * by_torque
        slopes[2] = slopes[2] + own.rotor * by_torque
        return value + extra, slopes

    def _regressors(self, *motion: Array) -> Array:
        """Return regressors of the samples, then with each value a step further."""
        n, dof = motion[0].shape
        states = np.tile(np.stack(motion), (1, 1 + 3 * dof, 1))
        for i in range(3 * dof):
            states[i // dof, (1 + i) * n : (2 + i) * n, i % dof] += _STEP
        rows = compute_inertial_regressor(self.place.robot.model, *states)
        return rows.reshape(1 + 3 * dof, n, dof, -1)

    def _clearance(self, q: Array) -> tuple[float, Array]:
        """Return the penalty of samples too near to the floor or the arm itself."""
        arm, slope = self.place.arm, np.zeros_like(q)
        missing = (_SPACE - compute_clearances(arm, q)) / arm.radius
        value, by_missing = _penalty(missing)
        near = np.flatnonzero((missing > 0).any(axis=1))
        if len(near):
            for joint in range(q.shape[1]):
                moved = q[near]
                moved[:, joint] += _STEP
                change = (_SPACE - compute_clearances(arm, moved)) / arm.radius - missing[near]
                slope[near, joint] = (by_missing[near] * change).sum(axis=1) / _STEP
        return value, slope


def build_excitation_problem(workspace: MotionWorkspace) -> ExcitationProblem:
    """Return the search for the best motion in a workspace."""
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * workspace.period
    unit = FourierSeries(np.zeros(FREE), *expand_free_coefficients(np.eye(FREE)), workspace.period)
    model = workspace.robot.model
    return ExcitationProblem(
        workspace,
        find_independent_columns(model),
        read_inertial_parameters(model),
        read_declared_drives(workspace.robot),
        sample_series(unit, t),
    )


def _penalty(missing: Array) -> tuple[float, Array]:
    """Return the penalty of violations (above 0), and its slope. Shapes (n, m)."""
    missing = np.maximum(missing, 0.0)
    weight = _WEIGHT / len(missing)
    return weight * float((missing**2).sum()), 2 * weight * missing


def _largest(values: Array) -> tuple[Array, Array]:
    """Return the p-norm of each column, p = 60, and its slope. Shapes (n, dof).

    It stands for the largest magnitude, which it exceeds by little, and is smooth.
    """
    size = np.abs(values)
    top = size.max(axis=0) + 1e-12
    total = ((size / top) ** _PEAKED).sum(axis=0)
    slope = (size / top) ** (_PEAKED - 1) * total ** (1 / _PEAKED - 1)
    return top * total ** (1 / _PEAKED), slope * np.sign(values)


def optimize_excitation(workspace: MotionWorkspace, rng: np.random.Generator) -> FourierSeries:
    """Return the best motion that a seeded search from several starts finds.

    Random motions are ranked by cost; sequential quadratic programming improves the
    best few and continues with the better of them. The result is scaled to keep the
    limits exactly, also between samples.
    """
    search = build_excitation_problem(workspace)
    drawn = [draw_unchecked_series(workspace, rng, anywhere=bool(i % 2)) for i in range(_DRAWN)]
    drawn = [search.encode_series(series) for series in drawn]
    drawn.sort(key=lambda x: search.cost(x)[0])
    points = [_improved(search, x, _STEPS[0]) for x in drawn[:_STARTS]]
    points.sort(key=lambda x: search.cost(x)[0])
    points.append(_improved(search, points[0], _STEPS[1]))
    found = [s for x in points if (s := shrink_to_feasible(workspace, search.series(x)))]
    found = [s for series in found if (s := _stirred(workspace, series))]
    t = np.arange(100) / 100 * workspace.period

    def condition(series: FourierSeries) -> float:
        return measure_excitation(workspace.robot.model, *sample_series(series, t)).condition

    return min(found or [draw_feasible_series(workspace, rng)], key=condition)


def _stirred(place: MotionWorkspace, series: FourierSeries) -> FourierSeries | None:
    """Give motion to joints that the search left at rest, which the cost ignores."""
    more = compute_growth_factors(place, series)
    if more.max() < _ASLEEP:
        return series
    return shrink_to_feasible(
        place, scale_series(series, np.where(more < _ASLEEP, 1.0, _STIRRED * more))
    )


def _improved(search: ExcitationProblem, x: Array, steps: int) -> Array:
    bounds = {"type": "ineq", "fun": search.compute_margins, "jac": search.compute_margin_gradients}
    options = {"maxiter": steps, "ftol": _ENOUGH}
    return minimize(search.cost, x, jac=True, method="SLSQP", constraints=bounds, options=options).x
