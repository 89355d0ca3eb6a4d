"""Computed torque control: the maker's model, and feedback on the readings.

tau = M(q) a_q + C(q, qd) qd + G(q) + F(qd)                  (paper eq. 8)
a_q = qdd* - Kp (q - q*) - Kd (qd - qd*)                       (paper eq. 9)

The paper prints the inverse of M in eq. 8; it must be M.
"""

from collections.abc import Callable
from typing import Protocol

import numpy as np
import pinocchio as pin

from residual.recording import Array
from residual.robot.robot import Robot
from sim.plant.tables import compiled
from sim.records import Drives, Reference
from sim.sizes import sizes

# Critically damped at 30 rad/s: poles of eq. 10.
KP, KD = 900.0, 60.0  # 1/s^2, 1/s
_SOFT = 0.05  # rad/s: over which the controller turns its dry friction


class Controller(Protocol):
    """Turns readings into torque commands."""

    def torque(self, k: int, reading: Array, rate: Array) -> Array:
        """Return the commands of step k [N m]. Shape (dof,)."""
        ...


def maker_of(robot: Robot) -> Drives:
    """Return what the robot declares, or what arms like it have: a maker knows."""
    usual = sizes(robot)
    return Drives(usual.coulomb, usual.viscous, usual.rotor)


class ComputedTorque:
    """The controller of the paper, with the nominal model of the robot."""

    def __init__(self, robot: Robot, reference: Reference) -> None:
        self._model, self._data = robot.model, robot.model.createData()
        self._maker = np.array(maker_of(robot))
        self._wanted = wanted(reference)

    def torque(self, k: int, reading: Array, rate: Array) -> Array:
        """Return the commands of step k [N m]. Shape (dof,)."""
        demand, rest = _demand(self._wanted[k], reading, rate, self._maker)
        return pin.rnea(self._model, self._data, reading, rate, demand) + rest


class FeedForward:
    """Given torques, with the same feedback but joint by joint: no model in the loop.

    Args:
        robot: The robot.
        reference: The motion.
        given: Torque for it, from any model [N m]. Shape (n, dof).
    """

    def __init__(self, robot: Robot, reference: Reference, given: Array) -> None:
        data = robot.model.createData()
        mass = np.diag(pin.crba(robot.model, data, reference.q[0]))
        self._inertia = mass + maker_of(robot).rotor
        self._given, self._wanted = given, wanted(reference)

    def torque(self, k: int, reading: Array, rate: Array) -> Array:
        """Return the commands of step k [N m]. Shape (dof,)."""
        q, qd, _ = self._wanted[k]
        push = KP * (q - reading) + KD * (qd - rate)
        return self._given[k] + self._inertia * push


# From step, position, speed and the acceleration that reference and feedback want
# (eq. 9) to torque [N m]. Shapes (dof,).
Law = Callable[[int, Array, Array, Array], Array]


class ByLaw:
    """Computed torque by a law that is handed in, from whatever model.

    Args:
        reference: The motion.
        law: The law.
    """

    def __init__(self, reference: Reference, law: Law) -> None:
        self._wanted, self._law = wanted(reference), law

    def torque(self, k: int, reading: Array, rate: Array) -> Array:
        """Return the commands of step k [N m]. Shape (dof,)."""
        q, qd, qdd = self._wanted[k]
        demand = qdd + KP * (q - reading) + KD * (qd - rate)
        return self._law(k, reading, rate, demand)


def controller_by(
    robot: Robot, reference: Reference, given: Array | Law
) -> ByLaw | FeedForward:
    """Return a controller by what some model gives.

    Args:
        given: Torque along the reference [N m], shape (n, dof), which goes with plain
            feedback; or a law, which closes the loop.
    """
    if callable(given):
        return ByLaw(reference, given)
    return FeedForward(robot, reference, given)


class Replay:
    """Given torques and nothing else: no feedback."""

    def __init__(self, given: Array) -> None:
        self._given = given

    def torque(self, k: int, reading: Array, rate: Array) -> Array:
        """Return the torques given for step k [N m]. Shape (dof,)."""
        return self._given[k]


def wanted(reference: Reference) -> Array:
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
