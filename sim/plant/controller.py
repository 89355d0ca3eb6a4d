"""Computed torque control: the maker's model, and feedback on the readings.

tau = M(q) a_q + C(q, qd) qd + G(q) + F(qd)                  (paper eq. 8)
a_q = qdd* - Kp (q - q*) - Kd (qd - qd*)                       (paper eq. 9)

The paper prints the inverse of M in eq. 8; it must be M.
"""

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.records import Drives, Reference
from sim.plant.sizes import sizes
from sim.plant.tables import compiled

# Critically damped at 30 rad/s: poles of eq. 10.
KP, KD = 900.0, 60.0  # 1/s^2, 1/s
_SOFT = 0.05  # rad/s: over which the controller turns its dry friction

# From step, read position and read speed to the torque commanded [N m]. Shapes (dof,).
Controller = Callable[[int, Array, Array], Array]
# From step, position, speed and the acceleration that reference and feedback want
# (eq. 9) to torque [N m]. Shapes (dof,).
Law = Callable[[int, Array, Array, Array], Array]


def maker_of(robot: Robot) -> Drives:
    """Return what the robot declares, or what arms like it have: a maker knows."""
    size = sizes(robot)
    return Drives(size.coulomb, size.viscous, size.rotor)


def controller_of(
    robot: Robot, reference: Reference, command: Array | Law | None = None
) -> Controller:
    """Return what drives an arm along a reference.

    Args:
        command: Of some model: torque along the reference [N m], shape (n, dof), which
            goes with plain feedback; or a law, which closes the loop. None for the
            controller of the paper, with the nominal model.
    """
    if command is None:
        return computed_torque(robot, reference)
    if not callable(command):
        return feed_forward(robot, reference, command)
    goal = _goal(reference)

    def torque(k: int, reading: Array, rate: Array) -> Array:
        q, qd, qdd = goal[k]
        return command(k, reading, rate, qdd + KP * (q - reading) + KD * (qd - rate))

    return torque


def computed_torque(robot: Robot, reference: Reference) -> Controller:
    """Return the controller of the paper, with the nominal model of the robot."""
    model, data = robot.model, robot.model.createData()
    maker, goal = np.array(maker_of(robot)), _goal(reference)

    def torque(k: int, reading: Array, rate: Array) -> Array:
        demand, rest = _demand(goal[k], reading, rate, maker)
        return pin.rnea(model, data, reading, rate, demand) + rest

    return torque


def feed_forward(robot: Robot, reference: Reference, command: Array) -> Controller:
    """Return given torques with the same feedback, joint by joint: no model in it."""
    mass = np.diag(pin.crba(robot.model, robot.model.createData(), reference.q[0]))
    inertia, goal = mass + maker_of(robot).rotor, _goal(reference)

    def torque(k: int, reading: Array, rate: Array) -> Array:
        q, qd, _ = goal[k]
        return command[k] + inertia * (KP * (q - reading) + KD * (qd - rate))

    return torque


def replay(command: Array) -> Controller:
    """Return given torques and nothing else: no feedback."""
    return lambda k, reading, rate: command[k]


def _goal(reference: Reference) -> Array:
    """Return q, qd and qdd of the reference in one array. Shape (n, 3, dof)."""
    return np.stack([reference.q, reference.qd, reference.qdd], axis=1)


@compiled
def _demand(goal, reading, rate, maker):
    """Return a_q, and the torque of rotors and friction. Shapes (dof,)."""
    coulomb, viscous, rotor = maker
    demand, rest = np.empty_like(reading), np.empty_like(reading)
    for j in range(len(reading)):
        miss = goal[0, j] - reading[j]
        demand[j] = goal[2, j] + KP * miss + KD * (goal[1, j] - rate[j])
        rest[j] = rotor[j] * demand[j] + viscous[j] * rate[j]
        # By the wanted direction: the read one would chatter at standstill.
        rest[j] += coulomb[j] * np.tanh(goal[1, j] / _SOFT)
    return demand, rest
