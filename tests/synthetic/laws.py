"""The torque of an effect along a given motion: the plant's own rows, sample by sample.

What the plant keeps in its state (temperature, deflection, a shared gear, the phase of
a run) has a closed form here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numba import njit
from scipy.ndimage import uniform_filter1d

from residual.recording import Array
from sim.effects.base import Effect, MovingArm, PlantEffectTrait, Values
from sim.plant.drive_train_step import compute_row_friction, compute_row_torque
from sim.plant.effect_catalogue import ActingEffect
from sim.plant.step_tables import WIDTH

CROSSING = 0.04  # s that a link takes from one side of its play to the other
# What acts in the engine alone: it depends on how the arm answers.
IN_ENGINE = ("x_dead_zone", "x_wall")


@dataclass(frozen=True, eq=False, slots=True)
class SyntheticMotion:
    """The true state of a synthetic arm during one log, for one hidden effect.

    Kinematics and friction have one column per joint of the effect (k of them), in the
    order of its joints.

    Attributes:
        t: Session time: zero when the session began, pauses counted [s]. Shape (n,).
        q: True positions [rad]. Shape (n, k).
        qd: True velocities [rad/s]. Shape (n, k).
        qdd: True accelerations [rad/s^2]. Shape (n, k).
        every_q: True positions of all joints [rad]. Shape (n, dof).
        bristle: State of the dry friction, -1 to 1: the sign of the motion, with
            memory. Shape (n, k).
        load: True torque of the rigid body [N m]. Shape (n, k).
        coulomb: True Coulomb level of the base friction [N m]. Shape (k,).
        displacement: Displacement over which the bristles yield [rad]. Shape (k,).
        rng: Random stream of this effect in this log.
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array
    every_q: Array
    bristle: Array
    load: Array
    coulomb: Array
    displacement: Array
    rng: np.random.Generator


Law = Callable[[SyntheticMotion, Values], Array]  # torque on its joints, (n, k)


def supports_synthetic_arm(effect: Effect) -> bool:
    """Whether a synthetic arm can have an effect: no broken sensor, no answer of it."""
    return PlantEffectTrait.SENSOR not in effect.traits and effect.name not in IN_ENGINE


def compute_effect_torque(effect: ActingEffect, state: SyntheticMotion) -> Array:
    """Return the torque that an additive effect takes on its joints. Shape (n, k)."""
    kind, p, joints, _ = effect
    if kind.name in LAWS:
        return LAWS[kind.name](state, p)
    out = np.zeros(state.q.shape)
    if kind.of_drive == "rotor":
        (inertia,) = p.values()
        out += inertia * state.qdd
    for k in range(len(joints)):
        if kind.friction:
            out[:, k] += _rub(kind.friction(p, float(state.coulomb[k])), state, k)
        if kind.torque and (k == 0 or kind.scope != "pair"):
            row, nothing = _padded(kind.torque(p, joints)), np.zeros(0)
            pairs = zip(state.q[:, k], state.every_q, strict=True)
            out[:, k] += [compute_row_torque(row, x, q, 0.0, nothing) for x, q in pairs]
        if kind.series:
            out[:, k] += kind.series(p, state.t, state.rng)
    return out


def compute_push_torque(effect: ActingEffect, model: pin.Model, q: Array, qd: Array) -> Array:
    """Return what a push from outside takes, on all joints. Shape (n, dof)."""
    data = model.createData()
    states = (MovingArm(model, data, *x) for x in zip(q, qd, strict=True))
    return -np.array([effect.kind.push(effect.values, state) for state in states])


def compute_motor_lead(compliance: float, half_gap: float, load: Array, rate: float) -> Array:
    """Return by how much a motor leads its link [rad]. Shape (n,).

    Args:
        compliance: Of the spring between them [rad/(N m)].
        half_gap: Half of the play between them [rad].
        load: Torque of the joint [N m]. Shape (n,).
        rate: Samples per second [Hz].
    """
    side = np.sign(load)
    for _ in range(3):
        side = uniform_filter1d(side, max(1, round(CROSSING * rate / 2)))
    return compliance * load + half_gap * side


def _padded(row) -> Array:
    kind, *numbers = row
    out = np.zeros(WIDTH)
    out[0], out[3 : 3 + len(numbers)] = kind, numbers
    return out


def _rub(numbers, state: SyntheticMotion, k: int) -> Array:
    row, columns = _padded(numbers), (state.qd, state.q, state.load)
    samples = zip(*(x[:, k] for x in columns), strict=True)
    levels = np.array([compute_row_friction(row, *x, 0.0) for x in samples])
    forward, backward, viscosity = levels.T
    z = state.bristle[:, k]
    dry = forward * np.maximum(z, 0) + backward * np.minimum(z, 0)
    return dry + viscosity * state.qd[:, k]


def warmup(state: SyntheticMotion, p: Values) -> Array:
    """Return level z (0.75 exp(-t/T) + 0.25 exp(-t/(3T))): oil, then the housing."""
    oil = np.exp(-state.t / p["time_constant"])
    fade = 0.75 * oil + 0.25 * oil ** (1 / 3)
    return p["level"] * fade[:, None] * state.bristle


def presliding(state: SyntheticMotion, p: Values) -> Array:
    """Return level z of another contact, whose bristles yield further."""
    ways = np.full(state.q.shape[1], p["displacement"])
    return p["level"] * compute_bristle_states(state.q, ways)


def coupled_friction(state: SyntheticMotion, p: Values) -> Array:
    """Return (f, sign f), f = level z(u) + coefficient u' of u = q_i + sign q_j."""
    way = p["sign"]
    u = state.q[:, 0] + way * state.q[:, 1]
    z = compute_bristle_states(u[:, None], state.displacement[:1])[:, 0]
    f = p["level"] * z + p["coefficient"] * (state.qd[:, 0] + way * state.qd[:, 1])
    return np.column_stack([f, way * f])


def friction_jump(state: SyntheticMotion, p: Values) -> Array:
    """Return level z in the second part of every log, from `share` of it on."""
    late = np.arange(len(state.t)) >= p["share"] * len(state.t)
    return p["level"] * late[:, None] * state.bristle


LAWS: Mapping[str, Law] = {
    "warmup": warmup,
    "presliding": presliding,
    "coupled_friction": coupled_friction,
    "x_friction_jump": friction_jump,
}


def compute_bristle_states(x: Array, displacement: Array) -> Array:
    """Return the state of the bristles of several contacts, between -1 and 1.

    Dry friction with memory, driven by the true displacement.

    dz/dx = (1 - z sign(dx)) / displacement    (Dahl 1968, exponent 1)

    integrated exactly between samples: z goes to sign(dx) over some displacements and
    stays where it is at standstill, so that the torque of a joint at rest can be any
    value within its friction.

    Args:
        x: Relative positions of the two sides [rad]. Shape (n, k).
        displacement: Displacement over which a contact yields [rad]. Shape (k,).

    Returns:
        States, zero at the first sample. Shape (n, k).
    """
    return _dahl(np.ascontiguousarray(x, dtype=float), np.asarray(displacement, dtype=float))


@njit(cache=True)
def _dahl(x, displacement):
    n, k = x.shape
    z = np.zeros((n, k))
    for i in range(1, n):
        for j in range(k):
            step = x[i, j] - x[i - 1, j]
            side = 1.0 if step >= 0 else -1.0
            rest = np.exp(-abs(step) / displacement[j])
            z[i, j] = side + (z[i - 1, j] - side) * rest
    return z
