"""The synthetic arm: a motion in, its true torque out, part by part."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.robot.dynamics import inverse_dynamics
from residual.robot.robot import Robot
from sim.synthetic.body import scatter, with_payload
from sim.synthetic.bristle import deflection
from sim.synthetic.disguise import changed_body, motor, pushed, reading, reported
from sim.synthetic.effects import LAWS
from sim.synthetic.motion import Motion
from sim.synthetic.seeds import stream
from sim.synthetic.sizes import sizes
from sim.synthetic.state import Hidden, State

Array = np.ndarray

_RIGID_SCATTER = 0.02
# Friction that the robot declares is off by little; that of a bare URDF is anything.
_DECLARED_SCATTER, _UNKNOWN_SCATTER = 0.02, 0.1
_DISPLACEMENT = (1e-4, 3e-4)  # rad


@dataclass(frozen=True, eq=False, slots=True)
class Plant:
    """A synthetic arm.

    Attributes:
        robot: Its nominal description, which is not quite true of it.
        hidden: The effects that its description lacks.
        seed: Seed of what makes this arm differ from its description.
    """

    robot: Robot
    hidden: tuple[Hidden, ...]
    seed: int


@dataclass(frozen=True, eq=False, slots=True)
class Friction:
    """True base friction and rotors, per joint, always there.

    Attributes:
        coulomb: Level [N m]. Shape (dof,).
        viscous: Coefficient [N m s/rad]. Shape (dof,).
        rotor: Inertia at the link side [kg m^2]. Shape (dof,).
        displacement: Displacement over which the bristles yield [rad]. Shape (dof,).
    """

    coulomb: Array
    viscous: Array
    rotor: Array
    displacement: Array


@dataclass(frozen=True, eq=False, slots=True)
class Torque:
    """The torque of one motion and its parts [N m], shapes (n, dof).

    Attributes:
        rigid: Rigid body with payload.
        base: Coulomb and viscous friction and rotors.
        hidden: Additive hidden effects, one array each, in the order of the plant's.
        tau: What is reported: the sum, times a hidden torque gain, late or cut.
        reading: What the encoders read, noise apart [rad]. Shape (n, dof).
    """

    rigid: Array
    base: Array
    hidden: tuple[Array, ...]
    tau: Array
    reading: Array


def true_model(plant: Plant) -> pin.Model:
    """Return the rigid body of this arm without hidden effects."""
    return scatter(plant.robot.model, _RIGID_SCATTER, stream(plant.seed, "scatter"))


def true_friction(plant: Plant) -> Friction:
    """Return base friction and rotors of this arm without hidden effects."""
    usual, rng = sizes(plant.robot), stream(plant.seed, "friction")
    relative = _DECLARED_SCATTER if plant.robot.declared else _UNKNOWN_SCATTER
    factor = np.exp(relative * rng.normal(size=(3, plant.robot.dof)))
    return Friction(
        coulomb=factor[0] * usual.coulomb,
        viscous=factor[1] * usual.viscous,
        rotor=factor[2] * usual.rotor,
        displacement=rng.uniform(*_DISPLACEMENT, plant.robot.dof),
    )


def true_torque(
    plant: Plant, motion: Motion, log: str, start: float = 0.0, active: bool = True
) -> Torque:
    """Return the torque that the motion takes.

    tau = gain * (RNEA(q, qd, qdd) + Fc z + Fv qd + Jr qdd + sum of hidden effects)

    Args:
        plant: The arm.
        motion: The true motion.
        log: Name of the log, which names the random streams of its effects.
        start: Session time of the first sample [s].
        active: Whether the hidden effects are there; not so when it was commissioned.

    Returns:
        The parts and the sum.
    """
    hidden = plant.hidden if active else ()
    model = true_model(plant)
    for effect in hidden:
        if effect.name == "payload":
            model = with_payload(model, effect)
        model = changed_body(model, effect)
    rigid = inverse_dynamics(model, motion.q, motion.qd, motion.qdd)
    rigid += pushed(model, hidden, motion.q)
    friction = true_friction(plant)
    drives, qd, qdd = _drives(hidden, motion, rigid)
    z = deflection(drives, friction.displacement)
    base = friction.coulomb * z + friction.viscous * qd + friction.rotor * qdd
    parts = []
    for i, effect in enumerate(hidden):
        rng = stream(plant.seed, f"effect/{i}/{effect.name}/{log}")
        parts.append(_part(effect, motion, start, (rigid, z, friction), rng))
    tau = (rigid + base + sum(parts)) * _gain(hidden, plant.robot.dof)
    tau = reported(hidden, motion.t, tau)
    return Torque(rigid, base, tuple(parts), tau, reading(hidden, drives))


def _drives(
    hidden: tuple[Hidden, ...], motion: Motion, load: Array
) -> tuple[Array, Array, Array]:
    """Return position, speed and acceleration of the motors, which may lead."""
    rate = 1 / (motion.t[1] - motion.t[0])
    lead = motor(hidden, motion.q, load, rate) - motion.q
    first = np.gradient(lead, 1 / rate, axis=0)
    second = np.gradient(first, 1 / rate, axis=0)
    return motion.q + lead, motion.qd + first, motion.qdd + second


def _part(
    effect: Hidden,
    motion: Motion,
    start: float,
    arm: tuple[Array, Array, Friction],
    rng: np.random.Generator,
) -> Array:
    """Return the torque of one additive effect on all joints. Shape (n, dof)."""
    rigid, z, friction = arm
    torque = np.zeros_like(rigid)
    if effect.name not in LAWS:
        return torque
    rows = [j - 1 for j in effect.joints]
    state = State(
        t=start + motion.t,
        q=motion.q[:, rows],
        qd=motion.qd[:, rows],
        qdd=motion.qdd[:, rows],
        bristle=z[:, rows],
        load=rigid[:, rows],
        coulomb=friction.coulomb[rows],
        displacement=friction.displacement[rows],
        rng=rng,
    )
    torque[:, rows] = LAWS[effect.name](state, effect.parameters)
    return torque


def _gain(hidden: tuple[Hidden, ...], dof: int) -> Array:
    gain = np.ones(dof)
    for effect in hidden:
        if effect.name == "torque_gain":
            gain[[j - 1 for j in effect.joints]] += effect.parameters["gain"]
    return gain
