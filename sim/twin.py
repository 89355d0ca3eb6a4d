"""The nominal twin: the model as described, driven along the same reference.

Its distance from the arm is the error of the paper: e_tau, e_q and their like.
"""

from collections.abc import Mapping

import numpy as np

from residual.recording import Recording
from residual.robot.robot import Robot
from sim.plant import tables as at
from sim.plant.arm import build_arm
from sim.plant.controller import ComputedTorque, FeedForward, Replay
from sim.plant.stepping import Trace, simulate
from sim.records import PlantSpec, Reference
from sim.streams import motion_label

Array = np.ndarray

_NOMINAL = PlantSpec(scatter=0.0)


def twin_of(robot: Robot, reference: Reference) -> Trace:
    """Simulate the nominal model, friction as declared, in closed loop."""
    arm = build_arm(robot, _NOMINAL)
    return simulate(arm, reference, ComputedTorque(robot, reference))


def twin_errors(
    log: Recording, plant: Trace, twin: Trace, every: int
) -> Mapping[str, Array]:
    """Return measured minus simulated: e_q, e_qd, e_qdd and e_tau.

    Positions and torques are those of the log. Speeds are those that the drives read
    on the motors, without the noise of the log; accelerations are their differences.

    Args:
        twin: Trace of the twin on the same reference.
        every: Control steps per sample of the log.

    Returns:
        Errors at the samples of the log. Shape (n, dof) each.
    """
    rate = plant.rows[:, at.READING_RATE]
    dt = plant.t[1] - plant.t[0]
    change = np.diff(rate, axis=0, append=rate[-1:]) / dt
    return {
        "e_q": log.q - twin.rows[::every, at.Q],
        "e_qd": rate[::every] - twin.rows[::every, at.QD],
        "e_qdd": (change - twin.qdd)[::every],
        "e_tau": log.tau - twin.rows[::every, at.DRIVE],
    }


def track(robot: Robot, reference: Reference, plant: PlantSpec, torque: Array) -> Array:
    """Drive the arm by given torques with plain feedback; return how it tracks.

    The better the model that computed the torques, the smaller the error: the
    validation by feed-forward of the paper's section 1.3.

    Args:
        torque: Feed-forward torque along the reference [N m]. Shape (n, dof).

    Returns:
        Read minus wanted position [rad]. Shape (n, dof).
    """
    controller = FeedForward(robot, reference, torque)
    label = motion_label(reference, 0.0)
    trace = simulate(
        build_arm(robot, plant), reference, controller, label, seed=plant.seed
    )
    return trace.rows[:, at.READING] - reference.q


def open_loop(
    robot: Robot, reference: Reference, torque: Array, window: float
) -> Array:
    """Let the nominal model run free under given torques, a window at a time.

    Args:
        reference: The motion that was measured; each window begins in its state.
        torque: Torques measured on it, at the same times [N m]. Shape (n, dof).
        window: Length of a window [s]; without feedback errors grow quickly.

    Returns:
        Simulated minus measured position [rad]. Shape (n, dof).
    """
    arm, error = build_arm(robot, _NOMINAL), np.zeros_like(reference.q)
    length = max(2, round(window / (reference.t[1] - reference.t[0])))
    for first in range(0, len(reference.t), length):
        part = slice(first, first + length)
        if first + 2 > len(reference.t):
            break
        piece = Reference(
            reference.kind,
            reference.t[part] - reference.t[first],
            reference.q[part],
            reference.qd[part],
            reference.qdd[part],
            None,
        )
        trace = simulate(arm, piece, Replay(torque[part]))
        error[part] = trace.rows[:, at.Q] - piece.q
    return error
