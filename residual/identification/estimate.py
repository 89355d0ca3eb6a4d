"""The rows of a fit, their observability, and one fit by the chosen method.

- ols: every row of every joint weighs the same;
- wls: a joint weighs by its noise, w_j = 1 / (s_j^2 t_j), with s_j the standard
  deviation of its residual and t_j the autocorrelation time of it;
- irls: also each row by its own residual u = r / s_j, with s_j the joint's noise by the
  median absolute residual: weight min(1, k / |u|), k = 1.345 (Huber 1981: a loss of 5 %
  efficiency on Gaussian noise).

The covariance is the sandwich B M B, B = (sum w_j x'x + L)^-1, M = sum w_j^2 s_j^2 t_j
x'x + L, right for each of them as long as the model is.

Nothing is ever squared: the rows of joint j are replaced by the triangle R_j of
[x_j y_j] = Q_j R_j, the "blocks": as few rows as columns, and the same least squares
for every choice of columns and of the weights w_j between joints:

min  sum_j w_j |x_j theta - y_j|^2 + (theta - theta_0)' L (theta - theta_0)
"""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from residual.effects.base import State
from residual.errors import InputError, check_name
from residual.evidence.design import LAGS
from residual.evidence.fit import estimate_autocorrelation_time
from residual.evidence.priors import compute_inertial_precision
from residual.model.model import Model, compute_torque_columns
from residual.recording import Array
from residual.robot.dynamics import (
    BaseParameters,
    StandardParameter,
    compute_base_parameters,
    compute_robot_regressor,
    draw_random_states,
    extend_independent_columns,
    list_inertial_parameters,
    reduce_to_base_parameters,
)
from residual.signals.track import Track

# The parameters of a fit, and their observability by a motion.
#
# Base parameters of the body and its effects together: some effects have the same torque
# as an inertia (the rotor of joint 1 turns about the same axis as link 1). They become part
# of the base parameter, so that fitted parameters are independent; the mapping lists the
# parts.
#
# The standard deviation of a parameter would be sqrt((A^-1)_ii), with A the information of
# the rows under the noise of each joint. A parameter is unobserved if that exceeds its
# largest plausible error: its full nominal value and more than a typical load would add.


_AMPLITUDE = 0.3  # of torque rms: the typical size of an effect of unknown value
_LOAD, _REACH = 0.08, 0.2  # a typical load: of the arm's mass, m off its link
_STATES = 120  # number of states of a tried motion
_LIMIT = 1.0
_FAST, _HARD = 1.5, 5.0  # rad/s, rad/s^2 for a robot without limits
_LARGEST = 1e9


@dataclass(frozen=True, eq=False, slots=True)
class JointRows:
    """The rows of each joint that count, filtered: y_j = x_j theta + noise."""

    x: tuple[Array, ...]  # columns of the base parameters, per joint, (m_j, b)
    y: tuple[Array, ...]  # filtered torque, per joint [N m], (m_j,)
    series: tuple[Array, ...]  # log and row index of each row, (m_j, 2)

    @property
    def counts(self) -> Array:
        """Rows of each joint. Shape (dof,)."""
        return np.array([len(y) for y in self.y])

    @property
    def rms(self) -> Array:
        """Torque rms of each joint, 0 where it has no rows [N m]. Shape (dof,)."""
        return np.array([np.sqrt(np.mean(y**2)) if len(y) else 0.0 for y in self.y])


def compute_model_base_parameters(model: Model) -> BaseParameters:
    """Return the base parameters of a model, effects included."""
    states = draw_random_states(model.robot.model)
    columns = compute_torque_columns(model, build_sampled_states(model, *states))
    rows = columns.reshape(-1, columns.shape[2])
    rigid = compute_base_parameters(model.robot.model).columns
    effects = range(len(model.inertial), rows.shape[1])
    names = (*list_inertial_parameters(model.robot.dof), *name_effect_coefficients(model))
    return reduce_to_base_parameters(rows, extend_independent_columns(rows, rigid, effects), names)


def name_effect_coefficients(model: Model) -> tuple[StandardParameter, ...]:
    """Return names of the coefficients of the effects."""
    out = []
    for term in model.terms:
        joints = [j + 1 for j in term.joints]
        place = " and ".join(map(str, joints))
        if joints:
            place = f" of joint{'s' if len(joints) > 1 else ''} {place}"
        words = term.effect.name.replace("_", " ")
        # The effect's own keys where coefficients and parameters are the same thing.
        count = len(term.theta)
        probe = 1.5 + np.arange(count)
        values = term.effect.values(probe, term.shape, model.robot)[:count]
        keys = [(f"coefficient {i + 1}", "") for i in range(count)]
        if np.array_equal(values, probe):
            keys = list(term.effect.units(term.joints, model.robot).items())[:count]
        for key, unit in keys:
            name = words if words.endswith(key) else f"{words} {key}"
            out.append(StandardParameter(f"{name}{place}", unit, joints[0] if joints else 1))
    return tuple(out)


def build_sampled_states(model: Model, q: Array, qd: Array, qdd: Array) -> State:
    """Return single states as inputs of effects, a second apart. Shapes (n, dof)."""
    regressor = compute_robot_regressor(model.robot, q, qd, qdd)
    rigid = regressor @ model.inertial
    t = np.arange(len(q), dtype=float)
    # A drive that is off in a part separates its damping from the joint's.
    on = np.broadcast_to((np.arange(len(q)) % 2)[:, None], q.shape)
    own = model.robot, 1.0, t, q, qd, qdd, np.sign(qd), regressor, rigid, rigid
    return State(*own, enabled=on)


def build_joint_rows(model: Model, tracks: tuple[Track, ...], base: BaseParameters) -> JointRows:
    """Filter torque and base columns alike, and keep the rows that count.

    Rows of joint j are samples at which joint j moves (`Track`).
    """
    dof = model.robot.dof
    joint_rows: list[list[tuple]] = [[] for _ in range(dof)]
    for number, track in enumerate(tracks):
        columns = compute_torque_columns(model, model.observe(track))
        for j in range(dof):
            use = np.flatnonzero(track.moving[:, j] & (np.ptp(track.tau[:, j]) > 0))
            active = columns[:, j, base.columns]
            some = np.flatnonzero(np.any(active, axis=0))
            x = np.zeros((len(use), len(base)))
            x[:, some] = track.filter(active[:, some])[use]
            series = np.column_stack([np.full(len(use), number), use])
            joint_rows[j].append((x, track.tau[use, j], series))
    parts = ([np.concatenate(p) for p in zip(*active, strict=True)] for active in joint_rows)
    return JointRows(*map(tuple, zip(*parts, strict=True)))


def compute_nominal_covariance(model: Model, torque_rms: Array, columns: Array) -> Array:
    """Return the prior covariance of nominal coefficients, at a relative scale of 1.

    Shape (s, s): inertia as in `compute_inertial_precision`; the coefficient of an effect
    by its size, or if that is 0, by the size that makes 30 % of the torque, given the
    torque rms of each joint [N m] and all columns on some states (n, dof, s).
    """
    size = len(model.inertial)
    coefficients = model.coefficients()
    out = np.zeros((len(coefficients), len(coefficients)))
    out[:size, :size] = np.linalg.inv(compute_inertial_precision(model.robot))
    share = np.sqrt(np.mean(columns[:, :, size:] ** 2, axis=0))
    per_joint = _AMPLITUDE * np.maximum(torque_rms, 1e-3 * torque_rms.max())[:, None]
    with np.errstate(divide="ignore"):
        typical = (per_joint / share).min(axis=0)
    typical = np.where(np.isfinite(typical), typical, 1.0)
    sd = np.maximum(np.abs(coefficients[size:]), typical)
    out[range(size, len(out)), range(size, len(out))] = sd**2
    return out


def compute_load_parameters(model: Model) -> Array:
    """Return the change of each coefficient by a typical load, 0 for effects. Shape (s,).

    However small a link's nominal inertia is, it may carry a tool.
    """
    out = np.zeros(len(model.coefficients()))
    mass = _LOAD * sum(body.mass for body in model.robot.model.inertias)
    per_link = mass * np.array([1.0] + 3 * [_REACH] + 6 * [_REACH**2])
    out[: len(model.inertial)] = np.tile(per_link, model.robot.dof)
    return out


@dataclass(frozen=True, eq=False, slots=True)
class UnobservedParameter:
    """A parameter that the motion does not determine."""

    index: int  # index of the base parameter
    sd: float  # standard deviation that it would have [SI]
    remedy: str  # motion that would determine it, in words


@dataclass(frozen=True, eq=False, slots=True)
class Observability:
    """The observability of parameters by a motion."""

    free: Array  # parameters that the motion determines, (k,)
    # Parameters that stay at their nominal value.
    fixed: tuple[UnobservedParameter, ...]
    standing: tuple[int, ...]  # joints that never move, from 1

    def lines(self, base: BaseParameters) -> list[str]:
        """The result in words, a line each."""
        out = []
        if self.standing:
            joints = ", ".join(map(str, self.standing))
            out.append(f"joint {joints} never moves: nothing acts on it that can be told")
        for parameter in self.fixed:
            lead = base.leading[parameter.index]
            out.append(
                f"{lead.name} cannot be told from this motion (at best to "
                f"{parameter.sd:.3g} {lead.unit}) and stays nominal; {parameter.remedy}"
            )
        return out


def find_unobserved_parameters(
    model: Model,
    base: BaseParameters,
    information: Array,
    parameter_scale: Array,
    joint_weights_and_counts: Array,
) -> Observability:
    """Find the parameters that a motion does not determine, and motions that would.

    Args:
        information: A: weighted x'x of the rows, in SI units. Shape (b, b).
        joint_weights_and_counts: Weight w_j of one row of each joint, and their
            number. (2, dof).
    """
    size, (weights, counts) = parameter_scale, joint_weights_and_counts
    scaled = information * np.outer(size, size)
    free, held = list(range(len(size))), {}
    while free:
        doubts = _doubt(scaled[np.ix_(free, free)])
        worst = int(np.argmax(doubts))
        if doubts[worst] <= _LIMIT:
            break
        held[free.pop(worst)] = float(doubts[worst])
    # The simplest additional motion that determines each held parameter, with as many rows as
    # the logs, so that the motion counts and not its length.
    per_row = weights * max(counts.max(), 1.0) / _STATES
    remedies: dict[int, str] = {}
    for words, states in _motions(model):
        if len(remedies) == len(held):
            break
        columns = compute_torque_columns(model, build_sampled_states(model, *states))
        columns = columns[:, :, base.columns] * size * np.sqrt(per_row)[None, :, None]
        flat = columns.reshape(-1, len(size))
        richer = scaled + flat.T @ flat
        for i in held.keys() - remedies.keys():
            ids = [*free, i]
            if _doubt(richer[np.ix_(ids, ids)])[-1] <= _LIMIT:
                remedies[i] = f"it needs {words}"
    nothing = "no motion within the limits of the arm would show it at this noise"
    unseen = (
        UnobservedParameter(i, doubt * size[i], remedies.get(i, nothing))
        for i, doubt in sorted(held.items())
    )
    standing = tuple(int(j) + 1 for j in np.flatnonzero(counts == 0))
    return Observability(np.array(free, dtype=int), tuple(unseen), standing)


def _doubt(scaled: Array) -> Array:
    """Expected sd of each parameter in units of its size, at most 1e9."""
    values, vectors = np.linalg.eigh(scaled)
    values = np.maximum(values, _LARGEST**-2)
    return np.sqrt((vectors**2 / values).sum(axis=1))


def _motions(model: Model):
    """Motions to try, the simplest first: words, and q, qd, qdd of random states."""
    robot, rng = model.robot, np.random.default_rng(0)
    low, high = robot.ends
    speed = np.where(np.isfinite(robot.velocity_limit), robot.velocity_limit, 2 * _FAST)
    hard = robot.acceleration_limit
    hard = np.full(robot.dof, 2 * _HARD) if hard is None else hard
    draw = rng.uniform(-0.5, 0.5, (3, _STATES, robot.dof))
    middle, joints = (low + high) / 2, range(robot.dof)
    q, qd, qdd = middle + 0.8 * (high - low) * draw[0], speed * draw[1], hard * draw[2]
    for some in [*((j,) for j in joints), *combinations(joints, 2), tuple(joints)]:
        keep = np.isin(joints, some)
        named = " and ".join(str(j + 1) for j in some)
        words = f"joint{'s' if len(some) > 1 else ''} {named}"
        words = "all joints at once" if len(some) == robot.dof else words
        yield f"motion of {words}", (np.where(keep, q, middle), qd * keep, qdd * keep)


METHODS = ("ols", "wls", "irls")
_CUT = 1e-10  # smaller singular values count as zero: nominal values stay
_FLOOR = 1e-7  # of torque rms: noise of noiseless logs
_ROUNDS, _REWEIGHTINGS = 20, 50
_K = 1.345
_MAD = 1.4826  # from median absolute value to standard deviation, for Gaussian noise

Blocks = tuple[Array, ...]


@dataclass(frozen=True, slots=True)
class Options:
    """Options of an identification.

    Attributes:
        method: "ols", "wls" or "irls".
        prior: Relative scale of a Gaussian prior about the nominal, None for a free
            fit.
    """

    method: str = "wls"
    prior: float | None = None

    def __post_init__(self) -> None:
        check_name(self.method, METHODS, "method")
        if self.prior is not None and not 0 < self.prior < np.inf:
            raise InputError(
                f"Prior scale {self.prior:g}: expected a positive number such as 0.03, "
                "the share by which nominal values may be off."
            )


@dataclass(frozen=True, eq=False, slots=True)
class FitStart:
    """The start and the free parameters of a fit."""

    value: Array  # theta_0: values without information, (b,)
    size: Array  # scale of a large change of each, (b,)
    free: Array  # indices of free parameters, (k,)
    precision: Array | None = None  # L over all parameters, None for a free fit, (b, b)

    @property
    def prior(self) -> Array:
        """L of the free parameters, in units of size. Shape (k, k)."""
        size = self.size[self.free]
        if self.precision is None:
            return np.zeros((len(size), len(size)))
        return self.precision[np.ix_(self.free, self.free)] * np.outer(size, size)


@dataclass(frozen=True, eq=False, slots=True)
class Estimate:
    """One fit."""

    theta: Array  # base parameters [SI], (b,)
    covariance: Array  # of theta; 0 where held or dropped, (b, b)
    noise: Array  # standard deviation of each joint's residual [N m], (dof,)
    independent_rows: Array  # rows of each joint over their autocorrelation time, (dof,)
    weight: Array  # w_j, (dof,)
    condition: float  # condition number of the weighted, column-normalised rows
    outliers: Array  # share of each joint's rows that weigh less than half, (dof,)
    counts: Array  # rows of each joint, (dof,)
    row_weights: tuple[Array, ...] | None = None  # of irls, else None, (m_j,)

    @property
    def sd(self) -> Array:
        """Standard deviation of theta, 0 where it was not fitted. Shape (b,)."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def relative_sd(self) -> Array:
        """Standard deviation as a share of the value. Shape (b,)."""
        return self.sd / np.maximum(np.abs(self.theta), 1e-300)


def compress_joint_rows(rows: JointRows, weights: tuple[Array, ...] | None = None) -> Blocks:
    """Return R_j of every joint, (at most b + 1, b + 1), of rows or weighted rows."""
    out = []
    for j, (x, y) in enumerate(zip(rows.x, rows.y, strict=True)):
        both = np.column_stack([x, y])
        if weights is not None:
            both = both * np.sqrt(weights[j])[:, None]
        out.append(np.linalg.qr(both, mode="r"))
    return tuple(out)


def solve_least_squares(blocks: Blocks, joint_weights: Array, start: FitStart) -> Array:
    """Return the parameters that minimise the squares weighted by w_j. Shape (b,).

    Undetermined directions stay at the start.
    """
    size = start.size[start.free]
    rows = stack_weighted_blocks(blocks, joint_weights)
    left = rows[:, start.free] * size
    right = rows[:, -1] - rows[:, :-1] @ start.value
    if start.precision is not None:
        left = np.concatenate([left, np.linalg.cholesky(start.prior).T])
        right = np.concatenate([right, np.zeros(len(size))])
    theta = start.value.copy()
    theta[start.free] += size * np.linalg.lstsq(left, right, rcond=_CUT)[0]
    return theta


def stack_weighted_blocks(blocks: Blocks, joint_weights: Array) -> Array:
    """Return the rows of all joints, by the roots of their weights."""
    return np.concatenate([np.sqrt(w) * r for w, r in zip(joint_weights, blocks, strict=True)])


def sum_squared_residuals(blocks: Blocks, theta: Array) -> Array:
    """Return |x_j theta - y_j|^2 of each joint [N^2 m^2]. Shape (dof,)."""
    both = np.append(theta, -1.0)
    return np.array([np.sum((r @ both) ** 2) for r in blocks])


def compute_weighted_gram(blocks: Blocks, joint_weights: Array) -> Array:
    """Return sum_j w_j x_j' x_j. Shape (b, b)."""
    pairs = zip(joint_weights, blocks, strict=True)
    return sum(w * r[:, :-1].T @ r[:, :-1] for w, r in pairs)


def compute_joint_residuals(rows: JointRows, theta: Array) -> tuple[Array, ...]:
    """Return y_j - x_j theta [N m]. Shapes (m_j,)."""
    return tuple(y - x @ theta for x, y in zip(rows.x, rows.y, strict=True))


def compute_autocorrelation_times(rows: JointRows, residual: tuple[Array, ...]) -> Array:
    """Return the autocorrelation times of residuals (m_j,), in rows. (dof,)."""
    out = np.ones(len(residual))
    for j, (values, series) in enumerate(zip(residual, rows.series, strict=True)):
        lines = []
        for log in np.unique(series[:, 0]):
            in_log = series[:, 0] == log
            place = series[in_log, 1] - series[in_log, 1].min()
            lines.append(np.zeros(place.max() + 1 + LAGS))
            lines[-1][place] = values[in_log]
        if lines:
            out[j] = estimate_autocorrelation_time(np.concatenate(lines))
    return out


def estimate_parameters(
    rows: JointRows, blocks: Blocks, start: FitStart, options: Options
) -> Estimate:
    """Fit rows, also given compressed, by the chosen method, with covariance."""
    free = replace(start, precision=None)
    theta = solve_least_squares(blocks, np.ones(len(rows.y)), free)
    for _ in range(_ROUNDS):
        before = theta
        weight, noise, memory = compute_joint_weights(rows, theta, options.method, len(start.free))
        theta = solve_least_squares(blocks, weight, free)
        if np.all(np.abs(theta - before) <= 1e-9 * start.size):
            break
    # Noise comes from the free fit: a tight prior would make its misfit look like noise,
    # and become still tighter.
    theta = solve_least_squares(blocks, weight, start)
    weights, means = None, np.ones((2, len(weight)))
    outliers = np.zeros(len(weight))
    if options.method == "irls":
        theta, noise, weights = fit_reweighted(rows, start, theta, memory)
        # Mean psi' and mean psi^2 of each joint's standardised residuals turn the
        # covariance of least squares into that of the robust fit.
        for j, (r, s) in enumerate(zip(compute_joint_residuals(rows, theta), noise, strict=True)):
            if len(r) == 0:
                continue
            u = r / s
            means[1, j] = np.mean((_weight(u) * u) ** 2)
            means[0, j] = max(np.mean(np.abs(u) <= _K), 0.05)
        weight = 1 / (noise**2 * memory)
        outliers = np.array([np.mean(w < 0.5) if len(w) else 0.0 for w in weights])
    # The sandwich, in units of size.
    size, pick = start.size[start.free], np.ix_(start.free, start.free)
    unit, prior = np.outer(size, size), start.prior
    meat = weight**2 * means[1] * noise**2 * memory
    inner = compute_weighted_gram(blocks, meat)[pick] * unit + prior
    outer = compute_weighted_gram(blocks, weight * means[0])[pick] * unit + prior
    inverse = np.linalg.pinv(outer, rcond=1e-14, hermitian=True)
    covariance = np.zeros((len(start.size), len(start.size)))
    covariance[pick] = inverse @ inner @ inverse * unit
    active = stack_weighted_blocks(blocks, weight)[:, start.free]
    norm = np.linalg.norm(active, axis=0)
    shown = len(norm) > 0 and norm.min() > 0
    return Estimate(
        theta=theta,
        covariance=covariance,
        noise=noise,
        independent_rows=rows.counts / memory,
        weight=weight,
        condition=float(np.linalg.cond(active / norm)) if shown else float("inf"),
        outliers=outliers,
        counts=rows.counts,
        row_weights=weights,
    )


def compute_joint_weights(
    rows: JointRows, theta: Array, method: str, parameters: int = 0
) -> tuple[Array, Array, Array]:
    """Return weight w_j, noise s_j [N m] and autocorrelation time t_j of each joint.

    Args:
        method: "ols" gives all joints one weight.
        parameters: Number of parameters fitted to these rows.
    """
    residual = compute_joint_residuals(rows, theta)
    memory = compute_autocorrelation_times(rows, residual)
    sse = np.array([np.sum(r**2) for r in residual])
    spent = max(1 - parameters / max(rows.counts.sum(), 1), 0.1)
    noise = np.sqrt(sse / np.maximum(rows.counts * spent, 1))
    noise = np.maximum(noise, _least_noise(rows))
    weight = 1 / (noise**2 * memory)
    if method == "ols":
        share = rows.counts / rows.counts.sum()
        weight = np.full(len(noise), 1 / (share @ (noise**2 * memory)))
    return weight, noise, memory


def _least_noise(rows: JointRows) -> float:
    return _FLOOR * max(rows.rms.max(), 1e-9)


def fit_reweighted(
    rows: JointRows, start: FitStart, theta: Array, autocorrelation_times: Array
) -> tuple[Array, Array, tuple[Array, ...]]:
    """Fit until weights and parameters agree.

    Returns:
        Parameters (b,), noise of each joint [N m] (dof,), weights of rows (m_j,) each.
    """
    for _ in range(_REWEIGHTINGS):
        residual = compute_joint_residuals(rows, theta)
        middle = [np.median(np.abs(r)) if len(r) else 0.0 for r in residual]
        noise = np.maximum(_MAD * np.array(middle), _least_noise(rows))
        weights = tuple(_weight(r / s) for r, s in zip(residual, noise, strict=True))
        before = theta
        theta = solve_least_squares(
            compress_joint_rows(rows, weights), 1 / (noise**2 * autocorrelation_times), start
        )
        if np.all(np.abs(theta - before) <= 1e-7 * start.size):
            break
    return theta, noise, weights


def _weight(u: Array) -> Array:
    return np.minimum(1.0, _K / np.maximum(np.abs(u), _K))
