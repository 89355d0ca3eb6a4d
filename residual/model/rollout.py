"""Where a model goes by itself: its forward dynamics under the goal of a log.

Unknown is the velocity v' after a step h. With mass matrix M, rotors A, torque f(q, v)
of drives and of all other effects, their damping D = -df/dv, and impulses p of dry
friction F,

    (M + A + h D) (v' - v) = h (f(q, v) - nle(q, v)) + p,    |p_j| <= h F_j,

where p_j holds joint j still if it can and else opposes its motion (Stewart and Trinkle
1996, Int. J. Numer. Methods Eng. 39:2673). Without p this is Pinocchio's ``aba`` with
A + h D for its armature; projected Gauss-Seidel finds p. Damping and dry friction are
those at the end of the step: strong damping is stable, a joint at rest stays there.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import CodeType

import numpy as np
import pinocchio as pin

from residual.drive import limit_goal
from residual.effects.base import EffectTrait, Shape
from residual.model.model import Model
from residual.model.records import PositionErrors
from residual.recording import Array, Recording
from residual.robot.dynamics import compute_flange_jacobian, replace_inertial_parameters
from residual.signals.splitting import slice_recording
from residual.signals.track import interpolate_signals

STEP = 2e-3  # s: ten steps in a radian of the stiffest servo (50 rad/s)
LOST = 2 * np.pi  # rad (m where a joint slides): a model so far from the log is lost
MOST = 60.0  # s: of one log; more says the same and takes longer
_START = 0.05  # s: over which the first velocity of a log is taken
_NUDGE = 1e-4  # rad/s: over which damping is taken
_SWEEPS, _DONE = 50, 1e-12  # of Gauss-Seidel: at most, and change of impulse [N m s]
# What a formula may use (`ExportedLaw`), as Python has it.
_WORDS = {name: getattr(math, name) for name in ("sin", "cos", "tanh", "exp")}
_WORDS |= {"pow": pow, "fabs": abs, "fmin": min, "fmax": max, "__builtins__": {}}
_WORDS |= {"sgn": lambda x: math.copysign(1.0, x) if x else 0.0}


@dataclass(frozen=True, eq=False, slots=True)
class Rollout:
    """A motion that a model made by itself.

    Attributes:
        q: Positions at the samples of the log, NaN where it diverged [rad]. (n, dof).
        diverged: Time on the log's clock at which it did [s]; None if it did not.
        left_out: Effects of the model that it went without, by name: their torque
            depends on more than the state.
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
    """A model as its integration needs it."""

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
            # What changes sign with the direction holds a joint; the rest pushes it.
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
        log: A log of an arm without torque sensors, with its drives; of a long one
            the beginning.
    """
    log = slice_recording(log, 0, int(np.searchsorted(log.t, log.t[0] + MOST)))
    t = np.linspace(log.t[0], log.t[-1], 1 + max(1, round(log.duration / STEP)))
    held = np.searchsorted(log.t, t + _DONE, side="right") - 1
    # Between samples the goal goes on evenly, as in the torque that the model fits.
    followed = limit_goal(log.drive, log.q_ref, log.t)
    goal = interpolate_signals(t, log.t, followed)
    h = float(t[1] - t[0])
    on = np.ones(goal.shape) if log.enabled is None else log.enabled[held]
    gain, limit = (log.drive.values(name, log.dof) for name in ("gain", "limit"))
    arm, session = _build_arm(model), t[0] if model.clock is None else model.clock
    data, rotor = arm.body.createData(), arm.body.armature.copy()
    # The slope at the first sample, of a parabola.
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
    """Sort the effects of a model by what an integration makes of them."""
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
