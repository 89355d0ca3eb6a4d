"""How large torques, friction and effects are on a given robot."""

from dataclasses import dataclass

import numpy as np

from residual.robot.dynamics import gravity_torque, inverse_dynamics
from residual.robot.robot import Robot
from sim.synthetic.room import room
from sim.synthetic.seeds import stream

Array = np.ndarray

# A six-axis arm of 100 kg: engineering judgement, not data of a manufacturer.
_ARM_100_KG = {
    "torque": (57.0, 157.0, 54.0, 11.0, 7.0, 7.0),
    "coulomb": (12.0, 14.0, 9.0, 4.0, 3.5, 2.5),
    "viscous": (10.0, 11.0, 7.0, 2.5, 2.0, 1.5),
    "rotor": (2.0, 2.0, 1.0, 0.3, 0.3, 0.15),
}
_PARAMETER_OF = {"coulomb": "level", "viscous": "coefficient", "rotor": "inertia"}
_DECLARED_AS = {"coulomb": "coulomb", "viscous": "viscous", "rotor": "rotor_inertia"}


@dataclass(frozen=True, eq=False, slots=True)
class Sizes:
    """Usual sizes on one robot, per joint.

    Attributes:
        torque: Range of the torque in normal motion [N m]. Shape (dof,).
        coulomb: Coulomb friction [N m]. Shape (dof,).
        viscous: Viscous friction [N m s/rad]. Shape (dof,).
        rotor: Inertia of the rotor at the link side [kg m^2]. Shape (dof,).
        loaded: Joints, from 1, that carry a good part of the weight.
    """

    torque: Array
    coulomb: Array
    viscous: Array
    rotor: Array
    loaded: tuple[int, ...]


def sizes(robot: Robot) -> Sizes:
    """Return the usual sizes on that robot.

    The built-in arm has a table; any other robot gets friction in proportion to the
    torques of its rigid body. Values that the robot declares win over both.
    """
    states = _random_states(robot)
    weight = np.abs(gravity_torque(robot.model, states[0], robot.model.gravity.linear))
    weight = weight.mean(axis=0)
    loaded = np.flatnonzero(weight >= 0.05 * max(weight.max(), 1e-12)) + 1
    if robot.name == "irb140":
        table = {key: np.array(value) for key, value in _ARM_100_KG.items()}
    else:
        table = _scaled(np.abs(inverse_dynamics(robot.model, *states)))
    for key, name in _DECLARED_AS.items():
        table[key] = _declared(robot, name, _PARAMETER_OF[key], table[key])
    return Sizes(**table, loaded=tuple(int(j) for j in loaded))


def _scaled(rigid: Array) -> dict[str, Array]:
    """Return friction in the proportions of industrial arms; wrists get a floor."""
    torque = 1.5 * np.quantile(rigid, 0.99, axis=0)
    torque = np.maximum(torque, 0.03 * torque.max())
    return {
        "torque": torque,
        "coulomb": 0.2 * torque,
        "viscous": 0.15 * torque,
        "rotor": 0.02 * torque,
    }


def _declared(robot: Robot, name: str, parameter: str, otherwise: Array) -> Array:
    effect = robot.declared.get(name)
    value = None if effect is None else effect.values.get(parameter)
    if value is None:
        return otherwise
    return np.broadcast_to(np.asarray(value, dtype=float), (robot.dof,)).copy()


def _random_states(robot: Robot) -> tuple[Array, Array, Array]:
    space = room(robot)
    rng = stream(0, "sizes")
    unit = rng.uniform(-1, 1, (3, 300, robot.dof))
    q = space.centre + space.amplitude * unit[0]
    return q, space.velocity * unit[1], 0.5 * space.acceleration * unit[2]
