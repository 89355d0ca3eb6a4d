"""The nominal twin: the model as described, driven along the same reference.

Its distance from the arm is the error of the paper: e_tau, e_q and their like. The
paper feeds one reference to arm and model and takes the difference of what they do (its
figure 2); a measured log that has the reference is enough for that.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from residual.errors import InputError
from residual.recording import Array, Recording
from residual.robot.files import DeclaredEffect
from residual.robot.robot import Robot
from sim.engine.records import PlantSpec, Rates, Reference
from sim.plant import tables as at
from sim.plant.arm import build_arm
from sim.plant.catalogue import of_drives
from sim.plant.controller import replay
from sim.plant.stepping import Trace, drive, simulate

_NOMINAL = PlantSpec(scatter=0.0)
_NOTHING = 1e-6  # N m, N m s/rad, kg m^2: the plant needs some inertia of a rotor
LOGGED = "logged"  # the family of a reference that nobody here has planned


def twin_of(robot: Robot, reference: Reference) -> Trace:
    """Simulate the nominal model, friction as declared, in closed loop."""
    return drive(robot, reference, _NOMINAL)


def twin_errors(
    log: Recording, plant: Trace, twin: Trace, every: int
) -> Mapping[str, Array]:
    """Return measured minus simulated: e_q, e_qd, e_qdd and e_tau.

    Positions and torques are those of the log. Speeds are those that the drives read
    on the motors, without the noise of the log; accelerations are their differences.

    Args:
        every: Control steps per sample of the log.
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

    Returns:
        Read minus wanted position [rad]. Shape (n, dof).
    """
    trace = drive(robot, reference, plant, command=torque)
    return trace.rows[:, at.READING] - reference.q


def open_loop(
    robot: Robot, reference: Reference, torque: Array, window: float
) -> Array:
    """Let the nominal model run free under given torques, a window at a time.

    Args:
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
        own = (x[part] for x in (reference.q, reference.qd, reference.qdd))
        t = reference.t[part] - reference.t[first]
        piece = Reference(reference.kind, t, *own, None)
        trace = simulate(arm, piece, replay(torque[part]))
        error[part] = trace.rows[:, at.Q] - piece.q
    return error


def logged_reference(log: Recording) -> Reference:
    """Return the reference of a log at the rate of the controller.

    A cubic spline through the logged positions, since the controller needs their
    derivatives; the rate is the next multiple of that of the log.
    """
    if log.q_ref is None:
        raise InputError(
            f"{log.id} has no reference (q_ref): a twin has nothing to be driven along."
        )
    step = float(np.median(np.diff(log.t)))
    dt = step / max(1, round(Rates().control * step))
    t = np.arange(round(log.duration / dt) + 1) * dt
    spline = CubicSpline(log.t - log.t[0], log.q_ref, axis=0)
    q, qd, qdd = (spline(t, order) for order in range(3))
    return Reference(LOGGED, t, q, qd, qdd, None)


def log_twin_errors(robot: Robot, log: Recording) -> Mapping[str, Array]:
    """Return measured minus simulated: e_q, e_qd, e_qdd and e_tau.

    The twin is the robot as described. What its description says nothing of, dry and
    viscous friction and rotors, it does not have: nobody knows them. Nor do its drives
    have limits: the arm followed, and a body that the description lacks (a balancer)
    may ask more of them than there is. Speeds that are not logged, and accelerations,
    are differences.
    """
    reference = logged_reference(log)
    twin = twin_of(_as_described(robot), reference)
    qd = np.gradient(log.q, log.t, axis=0) if log.qd is None else log.qd
    measured = {"e_q": log.q, "e_qd": qd, "e_tau": log.tau}
    measured["e_qdd"] = np.gradient(qd, log.t, axis=0)
    simulated = {"e_q": twin.rows[:, at.Q], "e_qd": twin.rows[:, at.QD]}
    simulated |= {"e_qdd": twin.qdd, "e_tau": twin.rows[:, at.DRIVE]}
    moments = log.t - log.t[0]
    return {
        name: values - _read(moments, reference.t, simulated[name])
        for name, values in measured.items()
    }


def _as_described(robot: Robot) -> Robot:
    """The same with nothing where the description is silent; left out, the usual."""
    silent = {
        effect.name: DeclaredEffect({effect.amount[0]: np.full(robot.dof, _NOTHING)})
        for effect in of_drives()
        if not getattr(robot.declared.get(effect.name), "values", None)
    }
    unlimited = np.full(robot.dof, np.inf)
    declared = {**robot.declared, **silent}
    return replace(robot, declared=declared, torque_limit=unlimited)


def _read(moments: Array, t: Array, values: Array) -> Array:
    return np.column_stack([np.interp(moments, t, column) for column in values.T])
