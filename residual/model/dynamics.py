"""Forward dynamics of a model, and the torque that a controller asks for by one.

The second of the two directions in which G2017 section 1.3 holds a model against the
arm: tau from q, qd and qdd is `compare`; qdd from q, qd and tau is here, with a check
that M(q) is positive definite on the workspace, without which there is none.

Feed-forward and computed torque are tau = M(q) a + C(q, qd) qd + g(q) + F(qd*) +
whatever else the model has, eq. 31 of G2017, with a = qdd* of the reference, or a_q of
the feedback (eq. 8 and 9). Friction and every effect beside the body are taken along
the reference, which cannot chatter: dry friction turns as fast as the controller can
tell a joint from a standing one, and as the drive may follow.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from scipy.ndimage import uniform_filter1d

from residual.effects.base import EffectTrait, State
from residual.errors import InputError
from residual.model.lookup import AnyModel, CorrectedModel
from residual.model.model import Model, Term
from residual.recording import Array, Recording
from residual.robot.dynamics import (
    compute_inverse_dynamics,
    compute_mass_matrix,
    replace_inertial_parameters,
)
from residual.robot.robot import Robot
from residual.signals.splitting import exceed_split_length, split_long_logs
from residual.signals.track import StandstillFriction, Track, build_tracks, interpolate_signals

POSES = 10_000
CLOSE = 1e-9  # rad/s^2, or of the largest one: when the acceleration is found
MOST = 60  # rounds until then; each leaves a third or less, where there is an answer


@dataclass(frozen=True, eq=False, slots=True)
class AccelerationError:
    """Error of the acceleration that a model makes of measured torque."""

    # 100 ||qdd - qdd_hat|| / ||qdd|| on moving samples [%], NaN where a joint never
    # moves, (dof,).
    per_joint: Array
    overall: float  # the same over all joints, Frobenius norm [%]


def compute_acceleration_error(
    model: AnyModel, recordings: Sequence[Recording]
) -> AccelerationError:
    """Return the error of acceleration from torque (forward dynamics).

    Measured and computed acceleration pass the identification filter; samples count
    where the joint moves.

    Raises:
        InputError: If the model has no acceleration.
    """
    base: Model = getattr(model, "model", model)
    dof = base.robot.dof
    miss, power = np.zeros(dof), np.zeros(dof)
    full = not exceed_split_length(recordings)
    pieces = split_long_logs(recordings, base.filters.torque)
    tracks, _ = build_tracks(pieces, base.filters, base.speed_floor, full_rate=full)
    for recording, track in zip(pieces, tracks, strict=True):
        measured = interpolate_signals(track.t, recording.t, recording.tau)
        computed = compute_acceleration(model, track, measured)
        both = track.filter(np.stack([track.qdd, computed], axis=2))
        both = both * track.moving[:, :, None]
        miss += ((both[:, :, 0] - both[:, :, 1]) ** 2).sum(axis=0)
        power += (both[:, :, 0] ** 2).sum(axis=0)
    some = power > 0
    share = 100 * np.sqrt(miss / np.where(some, power, np.nan))
    total = float(power.sum())
    overall = float(100 * np.sqrt(miss.sum() / total)) if total else float("nan")
    return AccelerationError(share, overall)


def compute_acceleration(model: AnyModel, track: Track, tau: Array) -> Array:
    """Return the acceleration that a torque [N m] gives the model [rad/s^2]. (n, dof).

    What remembers, distorts a report, or is a table, is taken along the measured
    motion; of everything else the acceleration is found by which its torque is tau.

    Raises:
        InputError: If M(q) is not positive definite, or there is no such acceleration.
    """
    base: Model = getattr(model, "model", model)
    now = replace(base, terms=tuple(t for t in base.terms if _of_now(t)))
    beside = model.torque_on(track) - now.torque_on(track)
    own_mass = _bodies(now, track.q)
    least = float(np.linalg.eigvalsh(own_mass)[:, 0].min())
    if least <= 0:
        raise InputError(
            f"M(q) of the model has an eigenvalue of {least:.3g} kg m^2, expected more "
            "than 0: it has no acceleration. Use consistent parameters (--consistent)."
        )
    return _solved(
        lambda qdd: now.torque_on(replace(track, qdd=qdd)), own_mass, tau - beside, track.qdd
    )


def _of_now(term) -> bool:
    return not term.effect.traits & (EffectTrait.MEMORY | EffectTrait.REPORT)


def _solved(torque: Callable[[Array], Array], mass: Array, target: Array, start: Array) -> Array:
    """Return accelerations that give a target torque, by Newton steps with M(q).

    What else depends on acceleration (a load that rubs, a gain) is small beside M, so
    that each round leaves a small share.

    Args:
        torque: From acceleration to torque [N m]. Shapes (n, dof).
        mass: M of bodies and rotors [kg m^2]. Shape (n, dof, dof).
    """
    qdd = start.copy()
    for _ in range(MOST):
        step = np.linalg.solve(mass, (target - torque(qdd))[:, :, None])[:, :, 0]
        qdd = qdd + step
        if not np.isfinite(step).all():
            break
        if np.abs(step).max(initial=0) <= CLOSE * max(1.0, np.abs(qdd).max(initial=0)):
            return qdd
    raise InputError(
        "No acceleration gives the model this torque: an effect of it turns torque "
        "with acceleration more than its bodies do. Look at its parameters."
    )


def _bodies(model: Model, q: Array) -> Array:
    """M(q) of bodies, loads and rotors [kg m^2]. Shape (n, dof, dof)."""
    body = replace_inertial_parameters(model.robot.model, model.loaded())
    out = compute_mass_matrix(body, q)
    np.einsum("nii->ni", out)[:] += model.drive()[1]
    return out


def compute_model_mass_matrix(model: Model, q: Array) -> Array:
    """Return M(q) of a model at standstill, with what effects add to it [kg m^2].

    Its symmetric part; what remembers or distorts a report has none.

    Args:
        q: Positions [rad]. Shape (n, dof).

    Returns:
        Shape (n, dof, dof).
    """
    out = _bodies(model, q)
    terms = [t for t in model.terms if _of_now(t) and not t.effect.carries]
    few = q[:: max(1, len(q) // 3)]
    heavy = tuple(t for t in terms if _added(model, (t,), few).any())
    if heavy:
        more = _added(model, heavy, q)
        out += (more + more.transpose(0, 2, 1)) / 2
    return out


def _added(model: Model, terms: Sequence[Term], q: Array) -> Array:
    """Torque of some terms at unit accelerations, at standstill. (n, dof, dof)."""
    still, out = np.zeros_like(q), np.zeros((*q.shape, q.shape[1]))
    t = np.zeros(len(q))

    def torque(qdd: Array) -> Array:
        state = model.state(1.0, t, (q, still, qdd))
        return np.sum([term.torque(state) for term in terms], axis=0)

    offset = torque(still)
    for j in range(q.shape[1]):
        pushed = still.copy()
        pushed[:, j] = 1.0
        out[:, :, j] = torque(pushed) - offset
    return out


def find_least_mass_eigenvalue(model: Model, poses: int = POSES) -> float:
    """Return the least eigenvalue of M(q) [kg m^2], rotors included, over random poses.

    M is positive definite for every pose where it is for every one that was tried
    only in all likelihood; for consistent links it is proved.
    """
    robot, rng = model.robot, np.random.default_rng(0)
    q = rng.uniform(*robot.ends, (poses, robot.dof))
    return float(np.linalg.eigvalsh(compute_model_mass_matrix(model, q))[:, 0].min())


_TURN = StandstillFriction("smooth", 1.0)

Law = Callable[[int, Array, Array, Array], Array]


# Samples in which a joint that is not standing has gone a step of its encoder; about
# the time in which a loop of that rate answers. 20 instead of 50 leave a quarter to two
# thirds more of the tracking error; 100, a twentieth less.
SAMPLES = 50.0


@dataclass(frozen=True, slots=True)
class FrictionReversal:
    """How dry friction turns where the reference reverses; measured defaults."""

    encoder_step: float = 1e-4  # of every joint [rad]
    # Time in which a drive may go from nothing to the torque limit of its joint [s],
    # which states the torque rate; 0 for none. A tenth of a second costs no tracking;
    # the largest step at a reversal is a fifth of that without it.
    rise: float = 0.1

    def width(self, rate: float) -> float:
        """Return the speed over which friction turns [rad/s].

        Args:
            rate: Of the controller [Hz].
        """
        return self.encoder_step * rate / SAMPLES

    def compute_torque_rate(self, robot: Robot) -> Array:
        """Return by how much torque may change at a reversal [N m/s]. Shape (dof,)."""
        if not self.rise:
            return np.full(robot.dof, np.inf)
        return robot.torque_limit / self.rise


AS_MEASURED = FrictionReversal()


def compute_feed_forward(
    model: AnyModel, t: Array, motion: Sequence[Array], reversal: FrictionReversal = AS_MEASURED
) -> Array:
    """Return the torque of a model for a reference [N m]. Shape (n, dof).

    Args:
        t: Times, evenly spaced [s]. Shape (n,).
        motion: q, qd and qdd of the reference. Shapes (n, dof).
        reversal: How friction turns at reversals.
    """
    rate = (len(t) - 1) / np.ptp(t)
    prepared = _used(model, reversal.width(rate))
    base: Model = getattr(prepared, "model", prepared)
    # Of a log the session's clock is known, of a motion to come it is not.
    since = t - t[0] if base.clock is None else t
    state = base.state(rate, since, motion)
    most = reversal.compute_torque_rate(base.robot) / rate
    # Friction turns at the torque rate at most. A reversal is known beforehand, so the
    # ramp lies around it, half before.
    ends = [base.torque_of_state(_turned(base, state, d)) for d in (1.0, -1.0)]
    swing = np.abs(ends[0] - ends[1]).max(axis=0)
    state = _turned(base, state, _ramp(state.sign, swing / most))
    torque = base.torque_of_state(state)
    if prepared is base:
        return torque
    # Tables step from level to level, at reversals and elsewhere.
    step = prepared.torque_of_state(state) - torque
    return torque + _ramp(step, np.ptp(step, axis=0) / most)


def _ramp(steps: Array, samples: Array) -> Array:
    """Steps as ramps of so many samples, half of each before it. Shape (n, dof)."""
    out = steps.copy()
    for j in np.flatnonzero(samples > 1):
        # An odd number, so that it lies in the middle.
        size = 2 * int(np.ceil((samples[j] - 1) / 2)) + 1
        out[:, j] = uniform_filter1d(out[:, j], size, mode="nearest")
    return out


def _turned(base: Model, state: State, sign: Array | float) -> State:
    """The same motion with another direction of friction."""
    state = replace(state, sign=np.broadcast_to(sign, state.q.shape))
    return replace(state, tau_model=base.torque_seen(state, as_reported=False))


def build_computed_torque_law(
    model: AnyModel, t: Array, motion: Sequence[Array], reversal: FrictionReversal = AS_MEASURED
) -> Law:
    """Return the law of computed torque, with the mass matrix of that model.

    Args:
        t: Times of the reference, evenly spaced [s]. Shape (n,).
        motion: q, qd and qdd of the reference. Shapes (n, dof).
        reversal: How friction turns at reversals.

    Returns:
        From step, position, speed and wanted acceleration to torque [N m]. (dof,).
    """
    prepared = _used(model, 1.0)
    base: Model = getattr(prepared, "model", prepared)
    rotor = base.drive()[1]
    body = replace_inertial_parameters(base.robot.model, base.loaded())
    data, along = body.createData(), compute_feed_forward(model, t, motion, reversal)
    q, qd, qdd = motion
    beside = along - compute_inverse_dynamics(body, q, qd, qdd) - rotor * qdd

    def law(k: int, angle: Array, speed: Array, demand: Array) -> Array:
        return pin.rnea(body, data, angle, speed, demand) + rotor * demand + beside[k]

    return law


def _used(model: AnyModel, width: float) -> AnyModel:
    """The model as a controller has it: friction turns over a width, logs are not late.

    Args:
        width: Speed over which friction turns [rad/s].
    """
    base = getattr(model, "model", model)
    dof = base.robot.dof
    late_report = EffectTrait.REPORT | EffectTrait.MEMORY
    late = [t for t in base.terms if late_report in t.effect.traits]
    base = replace(
        base,
        terms=tuple(t for t in base.terms if t not in late),
        standstill=(_TURN,) * dof,
        speed_floor=np.full(dof, width),
    )
    return replace(model, model=base) if isinstance(model, CorrectedModel) else base
