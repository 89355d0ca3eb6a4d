"""How large torques, friction and effects are on a given robot."""

import numpy as np

from residual.robot.dynamics import gravity_torque, inverse_dynamics
from residual.robot.robot import Robot
from sim.catalogue import of_drives
from sim.effects.base import Effect
from sim.records import Sizes
from sim.streams import stream
from sim.synthetic.room import room

Array = np.ndarray

# A six-axis arm of 100 kg: engineering judgement, not data of a manufacturer.
_ARM_100_KG = dict(
    torque=(57.0, 157.0, 54.0, 11.0, 7.0, 7.0),
    coulomb=(12.0, 14.0, 9.0, 4.0, 3.5, 2.5),
    viscous=(10.0, 11.0, 7.0, 2.5, 2.0, 1.5),
    rotor=(2.0, 2.0, 1.0, 0.3, 0.3, 0.15),
)


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
    for effect in of_drives():
        table[effect.of_drive] = declared(robot, effect, table[effect.of_drive])
    return Sizes(**table, loaded=tuple(int(j) for j in loaded))


def _scaled(rigid: Array) -> dict[str, Array]:
    """Return friction in the proportions of industrial arms; wrists get a floor."""
    torque = 1.5 * np.quantile(rigid, 0.99, axis=0)
    torque = np.maximum(torque, 0.03 * torque.max())
    return dict(
        torque=torque,
        coulomb=0.2 * torque,
        viscous=0.15 * torque,
        rotor=0.02 * torque,
    )


def declared(robot: Robot, effect: Effect, otherwise: Array) -> Array:
    """Return what a robot declares of an effect of its drives, by joint. (dof,)."""
    known = robot.declared.get(effect.name)
    value = None if known is None else known.values.get(effect.amount[0])
    if value is None:
        return otherwise
    return np.broadcast_to(np.asarray(value, dtype=float), (robot.dof,)).copy()


def _random_states(robot: Robot) -> tuple[Array, Array, Array]:
    space = room(robot)
    rng = stream(0, "sizes")
    unit = rng.uniform(-1, 1, (3, 300, robot.dof))
    q = space.centre + space.amplitude * unit[0]
    return q, space.velocity * unit[1], 0.5 * space.acceleration * unit[2]
