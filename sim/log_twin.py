"""The nominal twin of a measured log: simulated on the reference that was logged.

The paper feeds one reference to arm and model and takes the difference of what they do
(its figure 2). A log that has the reference is enough for that.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.robot.toml import Declared
from sim.catalogue import of_drives
from sim.plant import tables as at
from sim.records import Rates, Reference
from sim.twin import twin_of

Array = np.ndarray

_NOTHING = 1e-6  # N m, N m s/rad, kg m^2: the plant needs some inertia of a rotor
LOGGED = "logged"  # the family of a reference that nobody here has planned


def logged_reference(log: Recording) -> Reference:
    """Return the reference of a log at the rate of the controller.

    A cubic spline through the logged positions, since the controller needs their
    derivatives; the rate is the next multiple of that of the log.

    Raises:
        InputError: If the log has no reference.
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

    Args:
        log: What it did, with the reference that it was given.

    Returns:
        Errors at the samples of the log. Shape (n, dof) each.

    Raises:
        InputError: If the log has no reference.
        DivergedError: If the twin cannot follow it.
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
        effect.name: Declared({effect.amount[0]: np.full(robot.dof, _NOTHING)})
        for effect in of_drives()
        if not getattr(robot.declared.get(effect.name), "values", None)
    }
    unlimited = np.full(robot.dof, np.inf)
    declared = {**robot.declared, **silent}
    return replace(robot, declared=declared, torque_limit=unlimited)


def _read(moments: Array, t: Array, values: Array) -> Array:
    return np.column_stack([np.interp(moments, t, column) for column in values.T])
