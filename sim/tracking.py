"""How an arm tracks a reference under a controller: what a model is worth in use."""

from dataclasses import dataclass

import numpy as np

from residual.robot.robot import Robot
from sim.plant import tables as at
from sim.plant.arm import build_arm
from sim.plant.controller import Law, controller_by
from sim.plant.stepping import simulate
from sim.records import PlantSpec, Reference
from sim.streams import motion_label

Array = np.ndarray


@dataclass(frozen=True, eq=False, slots=True)
class Driven:
    """What came of one drive along a reference, per joint. Shapes (dof,).

    Attributes:
        rms, peak: Of read minus wanted position [rad].
        chatter: Root mean square of the second difference of torque per step [N m].
        energy: Integral of the size of torque times speed [J].
    """

    rms: Array
    peak: Array
    chatter: Array
    energy: Array


def drive(
    robot: Robot, reference: Reference, plant: PlantSpec, given: Array | Law
) -> Driven:
    """Drive the arm along a reference by torques, or by a law, handed in.

    Torques go with plain feedback joint by joint, the same for every model; a law
    closes the loop itself (computed torque).

    Args:
        given: Torque along the reference [N m], shape (n, dof); or the law.
    """
    controller = controller_by(robot, reference, given)
    label, arm = motion_label(reference, 0.0), build_arm(robot, plant)
    trace = simulate(arm, reference, controller, label, seed=plant.seed)
    dt = reference.t[1] - reference.t[0]
    miss = trace.rows[:, at.READING] - reference.q
    torque, speed = trace.rows[:, at.DRIVE], trace.rows[:, at.QD]
    return Driven(
        rms=np.sqrt(np.mean(miss**2, axis=0)),
        peak=np.abs(miss).max(axis=0),
        chatter=np.sqrt(np.mean(np.diff(torque, 2, axis=0) ** 2, axis=0)),
        energy=np.abs(torque * speed).sum(axis=0) * dt,
    )
