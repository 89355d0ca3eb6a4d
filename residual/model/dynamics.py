"""Forward dynamics of a model, and its torque for a controller.

G2017 section 1.3 compares a model with the arm in two directions: tau from q, qd and qdd
is in `residual.model.compare`; qdd from q, qd and tau is here, with the required check
that M(q) is positive definite on the workspace.

Feed-forward and computed torque are tau = M(q) a + C(q, qd) qd + g(q) + F(qd*) +
other effects, eq. 31 of G2017, with a = qdd* of the reference, or a_q of the feedback
(eq. 8 and 9). Friction and every effect except the body are evaluated along the
reference, which cannot chatter: dry friction reverses as fast as the controller resolves
motion from standstill, and as the drive can follow.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import CodeType

import numpy as np
import pinocchio as pin
from scipy.ndimage import uniform_filter1d

from residual.drive import limit_goal
from residual.effects.base import EffectTrait, Shape
from residual.errors import InputError
from residual.model.compare import ErrorSums, prepare_held_out
from residual.model.lookup import AnyModel, remove_tables, replace_model
from residual.model.model import Model, Term
from residual.model.records import PositionErrors
from residual.recording import Array, Recording
from residual.robot.dynamics import (
    compute_flange_jacobian,
    compute_inverse_dynamics,
    compute_mass_matrix,
    replace_inertial_parameters,
)
from residual.robot.robot import Robot
from residual.signals.splitting import slice_recording
from residual.signals.track import StandstillFriction, Track, interpolate_signals

POSES = 10_000
CLOSE = 1e-9  # rad/s^2, or of the largest one: convergence of the acceleration
MOST = 60  # largest number of iterations; each reduces the error to a third or less


def compute_acceleration_error(model: AnyModel, recordings: Sequence[Recording]) -> ErrorSums:
    """Return the error of acceleration from torque (forward dynamics), as "moving".

    Measured and computed acceleration pass the identification filter; samples count
    where the joint moves. Of squares [rad^2/s^4].

    Raises:
        InputError: If the model has no acceleration.
    """
    base = remove_tables(model)
    dof = base.robot.dof
    miss, power = np.zeros(dof), np.zeros(dof)
    for witness in prepare_held_out(recordings, base):
        log, track = witness.recording, witness.track
        measured = interpolate_signals(track.t, log.t, log.tau)
        computed = compute_acceleration(model, track, measured)
        both = track.filter(np.stack([track.qdd, computed], axis=2))
        both = both * track.moving[:, :, None]
        miss += ((both[:, :, 0] - both[:, :, 1]) ** 2).sum(axis=0)
        power += (both[:, :, 0] ** 2).sum(axis=0)
    return ErrorSums({"moving": miss}, {"moving": power})


def compute_acceleration(model: AnyModel, track: Track, tau: Array) -> Array:
    """Return the acceleration of the model under a torque [N m], [rad/s^2]. (n, dof).

    Effects with memory, distortions of a report, and tables are evaluated along the
    measured motion; the acceleration solves for the other terms with torque tau.

    Raises:
        InputError: If M(q) is not positive definite, or there is no such acceleration.
    """
    base = remove_tables(model)
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

    Other dependences on acceleration (load friction, a gain) are small against M, so each
    iteration leaves a small error.

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
    """Return M(q) of a model at standstill, effects included [kg m^2].

    Its symmetric part, without effects with memory or distortions of a report.

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


def find_least_mass_eigenvalue(model: Model) -> float:
    """Return the least eigenvalue of M(q) [kg m^2], rotors included, over random poses.

    If M is positive definite for every tried pose, it probably is for all; for
    consistent links this is guaranteed.
    """
    robot, rng = model.robot, np.random.default_rng(0)
    q = rng.uniform(*robot.ends, (POSES, robot.dof))
    return float(np.linalg.eigvalsh(compute_model_mass_matrix(model, q))[:, 0].min())


_TURN = StandstillFriction("smooth", 1.0)

Law = Callable[[int, Array, Array, Array], Array]


# Samples in which a moving joint covers one step of its encoder; about the response time of
# a loop at that rate. 20 instead of 50 give a quarter to two thirds more tracking error;
# 100, a twentieth less.
SAMPLES = 50.0


@dataclass(frozen=True, slots=True)
class FrictionReversal:
    """The smoothing of dry friction where the reference reverses; measured defaults."""

    encoder_step: float = 1e-4  # of every joint [rad]
    # Time from zero to the torque limit of a joint [s], which defines the torque rate; 0
    # for no limit. A tenth of a second does not affect tracking; the largest step at a
    # reversal is a fifth of that without it.
    rise: float = 0.1

    def width(self, rate: float) -> float:
        """Return the speed over which friction reverses [rad/s].

        Args:
            rate: Of the controller [Hz].
        """
        return self.encoder_step * rate / SAMPLES

    def compute_torque_rate(self, robot: Robot) -> Array:
        """Return the torque rate at a reversal [N m/s]. Shape (dof,)."""
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
    base = remove_tables(prepared)
    # A log has a session clock, a planned motion has none.
    since = t - t[0] if base.clock is None else t
    state = base.state(rate, since, motion)
    most = reversal.compute_torque_rate(base.robot) / rate
    # Friction reverses at the torque rate at most. A reversal is known beforehand, so the
    # ramp is centred on it.
    ways = np.ones(state.q.shape), -np.ones(state.q.shape)
    ends = [base.torque_of_state(base.replace_sign(state, way)) for way in ways]
    swing = np.abs(ends[0] - ends[1]).max(axis=0)
    state = base.replace_sign(state, _ramp(state.sign, swing / most))
    torque = base.torque_of_state(state)
    if prepared is base:
        return torque
    # Tables step from level to level, at reversals and elsewhere.
    step = prepared.torque_of_state(state) - torque
    return torque + _ramp(step, np.ptp(step, axis=0) / most)


def _ramp(steps: Array, samples: Array) -> Array:
    """Return steps as centred ramps of a number of samples. Shape (n, dof)."""
    out = steps.copy()
    for j in np.flatnonzero(samples > 1):
        # An odd number, so that it is centred.
        size = 2 * int(np.ceil((samples[j] - 1) / 2)) + 1
        out[:, j] = uniform_filter1d(out[:, j], size, mode="nearest")
    return out


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
    base = remove_tables(prepared)
    rotor = base.drive()[1]
    body = replace_inertial_parameters(base.robot.model, base.loaded())
    data, along = body.createData(), compute_feed_forward(model, t, motion, reversal)
    q, qd, qdd = motion
    beside = along - compute_inverse_dynamics(body, q, qd, qdd) - rotor * qdd

    def law(k: int, angle: Array, speed: Array, demand: Array) -> Array:
        return pin.rnea(body, data, angle, speed, demand) + rotor * demand + beside[k]

    return law


def _used(model: AnyModel, width: float) -> AnyModel:
    """The model for a controller: friction reverses over a width, without log delays.

    Args:
        width: Speed over which friction reverses [rad/s].
    """
    base = remove_tables(model)
    dof = base.robot.dof
    late_report = EffectTrait.REPORT | EffectTrait.MEMORY
    late = [t for t in base.terms if late_report in t.effect.traits]
    base = replace(
        base,
        terms=tuple(t for t in base.terms if t not in late),
        standstill=(_TURN,) * dof,
        speed_floor=np.full(dof, width),
    )
    return replace_model(model, base)


# Free simulation of a model: its forward dynamics under the goal of a log.
#
# Unknown is the velocity v' after a step h. With mass matrix M, rotors A, torque f(q, v)
# of drives and of all other effects, their damping D = -df/dv, and impulses p of dry
# friction F,
#
#     (M + A + h D) (v' - v) = h (f(q, v) - nle(q, v)) + p,    |p_j| <= h F_j,
#
# where p_j holds joint j still if it can and else opposes its motion (Stewart and Trinkle
# 1996, Int. J. Numer. Methods Eng. 39:2673). Without p this is Pinocchio's ``aba`` with
# A + h D for its armature; projected Gauss-Seidel finds p. Damping and dry friction are
# those at the end of the step: strong damping is stable, a joint at rest stays there.


STEP = 2e-3  # s: ten steps in a radian of the stiffest servo (50 rad/s)
LOST = 2 * np.pi  # rad (m where a joint slides): a model so far from the log is lost
LONGEST = 60.0  # s: of one log; more adds no information
_START = 0.05  # s: interval for the initial velocity of a log
_NUDGE = 1e-4  # rad/s: speed step for the damping
_SWEEPS, _DONE = 50, 1e-12  # of Gauss-Seidel: at most, and change of impulse [N m s]
# Names that a formula may use (`ExportedLaw`), in Python.
_WORDS = {name: getattr(math, name) for name in ("sin", "cos", "tanh", "exp")}
_WORDS |= {"pow": pow, "fabs": abs, "fmin": min, "fmax": max, "__builtins__": {}}
_WORDS |= {"sgn": lambda x: math.copysign(1.0, x) if x else 0.0}


@dataclass(frozen=True, eq=False, slots=True)
class Rollout:
    """The motion of a model in free simulation.

    Attributes:
        q: Positions at the samples of the log, NaN where it diverged [rad]. (n, dof).
        diverged: Time of divergence on the log's clock [s]; None if it did not.
        left_out: Omitted effects, by name: their torque depends on more than the state.
    """

    q: Array
    diverged: float | None
    left_out: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Formula:
    """Torque of an effect on one joint as an expression of the state."""

    row: int  # joint that it acts on, from 0
    joints: tuple[int, ...]  # joints that it looks at
    code: CodeType
    theta: tuple[float, ...]
    shape: Shape
    powered: bool  # whether it is there while the drive is on alone

    def torque(self, state: Mapping[str, Sequence[float]], sign: float) -> float:
        """Return the torque if its joint moves in a direction [N m]."""
        if len(self.joints) == 1:
            names = {name: x[self.row] for name, x in state.items()}
        else:
            names = {name: [x[j] for j in self.joints] for name, x in state.items()}
        names |= {"a": self.theta, "s": self.shape, "sign": sign}
        on = state["enabled"][self.row] if self.powered else 1.0
        return on * float(eval(self.code, _WORDS, names))  # of the effects' own files


@dataclass(frozen=True, eq=False, slots=True)
class _Arm:
    """A model prepared for integration."""

    body: pin.Model
    gain: Array  # reported over real torque, (dof,)
    force: Array  # on the flange, in the base frame [N], (3,)
    formulas: tuple[_Formula, ...]
    left_out: tuple[str, ...]

    def resist(self, data: pin.Data, q: Array, qd: Array, enabled: Array, t: float) -> Array:
        """Return torque, damping and dry friction of the effects. Shape (3, dof)."""
        dof, out = len(q), np.zeros((3, len(q)))
        if self.force.any():
            out[0] -= compute_flange_jacobian(self.body, q[None])[0, :3].T @ self.force
        state = {"q": q.tolist(), "qd": qd.tolist(), "enabled": enabled.tolist()}
        state |= {"qdd": [0.0] * dof, "t": [t] * dof}
        state["rigid"] = pin.nle(self.body, data, q, qd).tolist()
        faster = state | {"qd": [x + _NUDGE for x in state["qd"]]}
        for formula in self.formulas:
            j, names, sides = formula.row, formula.code.co_names, (0.0, 0.0)
            torque = formula.torque(state, 0.0)
            if "sign" in names:
                sides = [formula.torque(state, way) - torque for way in (1.0, -1.0)]
            if "qd" in names:
                out[1, j] += (formula.torque(faster, 0.0) - torque) / _NUDGE
            # Torque that changes sign with direction can hold a joint; the rest drives it.
            out[2, j] += (sides[0] - sides[1]) / 2
            out[0, j] += torque + (sum(sides) / 2 if qd[j] else 0.0)
        return out


def compute_position_errors(
    models: Mapping[str, Model], logs: Sequence[Recording]
) -> PositionErrors | None:
    """Integrate each model once per log; None where no log has drives and goals."""
    logs = [log for log in logs if log.drive is not None and log.q_ref is not None]
    if not logs:
        return None
    rms, overall, diverged, left_out = {}, {}, {}, {}
    for name, model in models.items():
        runs = [simulate_position(model, log) for log in logs]
        diverged[name] = tuple(
            f"{log.id} at {run.diverged:.2f} s"
            for log, run in zip(logs, runs, strict=True)
            if run.diverged is not None
        )
        left_out |= dict.fromkeys(x for run in runs for x in run.left_out)
        rms[name] = overall[name] = None
        if not diverged[name]:
            pairs = zip(runs, logs, strict=True)
            miss = np.vstack([run.q - log.q[: len(run.q)] for run, log in pairs])
            square = (miss**2).mean(axis=0)
            rms[name] = tuple(np.sqrt(square).tolist())
            alike = len(set(model.robot.prismatic)) == 1
            overall[name] = float(np.sqrt(square.mean())) if alike else None
    return PositionErrors(rms, overall, diverged, tuple(left_out))


def simulate_position(model: Model, log: Recording) -> Rollout:
    """Integrate a model from the first sample of a log on, under its logged goal.

    Args:
        log: A log of an arm without torque sensors, with its drives; only the beginning
            of a long one is used.
    """
    log = slice_recording(log, 0, int(np.searchsorted(log.t, log.t[0] + LONGEST)))
    t = np.linspace(log.t[0], log.t[-1], 1 + max(1, round(log.duration / STEP)))
    held = np.searchsorted(log.t, t + _DONE, side="right") - 1
    # Between samples the goal is interpolated, as in the fitted torque.
    followed = limit_goal(log.drive, log.q_ref, log.t)
    goal = interpolate_signals(t, log.t, followed)
    h = float(t[1] - t[0])
    on = np.ones(goal.shape) if log.enabled is None else log.enabled[held]
    gain, limit = (log.drive.values(name, log.dof) for name in ("gain", "limit"))
    arm, session = _build_arm(model), t[0] if model.clock is None else model.clock
    data, rotor = arm.body.createData(), arm.body.armature.copy()
    # The slope of a parabola at the first sample.
    early = max(4, int(np.searchsorted(log.t, log.t[0] + _START, side="right")))
    q, v = log.q[0].copy(), np.polyfit(log.t[:early] - log.t[0], log.q[:early], 2)[1]
    path, impulse = np.full(goal.shape, np.nan), np.zeros(log.dof)
    upper, diverged = np.triu(np.ones((log.dof, log.dof), bool)), None
    for k in range(len(t)):
        path[k] = q
        torque, damping, friction = arm.resist(data, q, v, on[k], t[k] - session)
        tau = on[k] * np.clip(gain * (goal[k] - q), -limit, limit) / arm.gain - torque
        arm.body.armature = rotor + h * np.maximum(damping, 0.0)
        v = v + h * pin.aba(arm.body, data, q, v, tau)
        if friction.any():
            inverse = pin.computeMinverse(arm.body, data, q)
            inverse = np.where(upper, inverse, inverse.T)
            v = v + inverse @ _stop(inverse, v, h * np.maximum(friction, 0), impulse)
        q = q + h * v
        if not np.abs(q - log.q[held[k]]).max() < LOST:
            diverged = float(t[k])
            break
    return Rollout(interpolate_signals(log.t, t, path), diverged, arm.left_out)


def _stop(inverse: Array, free: Array, most: Array, impulse: Array) -> Array:
    """Find the impulses of dry friction, in place [N m s]. Shape (dof,).

    Args:
        inverse: Of the mass matrix. Shape (dof, dof).
        free: Velocities without them [rad/s]. Shape (dof,).
        most: Largest impulses [N m s]. Shape (dof,).
    """
    for _ in range(_SWEEPS):
        change = 0.0
        for j in range(len(free)):
            left = free[j] + inverse[j] @ impulse
            new = impulse[j] - left / inverse[j, j]
            new = min(max(new, -most[j]), most[j])
            change, impulse[j] = max(change, abs(new - impulse[j])), new
        if change < _DONE or len(free) == 1:
            break
    return impulse


def _build_arm(model: Model) -> _Arm:
    """Sort the effects of a model by their role in the integration."""
    dof, inertial = model.robot.dof, model.inertial.copy()
    rotor, gain = np.zeros(dof), np.ones(dof)
    gravity, force = np.zeros(3), np.zeros(3)
    formulas, left_out = [], []
    for term in (*model.terms, *model.tables):
        effect, law, joints = term.effect, term.effect.portable, list(term.joints)
        if law.formula == ("a[0] * tau",):
            gain[joints] += term.theta[0]
        elif EffectTrait.REPORT in effect.traits or law.memory or law.shift:
            left_out.append(effect.name)
        elif law.bodies:
            inertial += law.bodies(term.theta, term.joints, model.robot)
        elif law.gravity:
            gravity += law.gravity(term.theta, model.robot)
        elif law.force:
            force += law.force(term.theta)
        elif law.joint == ("armature",):
            rotor[joints] += term.theta[0]
        elif law.formula:
            rows = law.formula * (len(joints) if len(law.formula) == 1 else 1)
            for j, row in zip(joints, rows, strict=True):
                code = compile(row, effect.name, "eval")
                theta = tuple(map(float, term.theta))
                powered = EffectTrait.POWERED in effect.traits
                form = j, term.joints, code, theta, term.shape, powered
                formulas.append(_Formula(*form))
        else:
            left_out.append(effect.name)
    body = replace_inertial_parameters(model.robot.model, inertial)
    body.gravity.linear = body.gravity.linear + gravity
    body.armature = rotor
    return _Arm(body, gain, force, tuple(formulas), tuple(dict.fromkeys(left_out)))
