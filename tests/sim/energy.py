"""Where the work of the motors goes: the books of a trace must balance."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from sim.engine import friction_laws
from sim.plant import step_tables as at
from sim.plant.closed_loop import SimulationTrace


@dataclass(frozen=True, slots=True)
class Balance:
    """Books of one run."""

    error: float  # largest miss of stored energy minus work in minus losses [J]
    throughput: float  # integral of the absolute power of the motors [J]


def balance(trace: SimulationTrace, every: int = 50) -> Balance:
    """Compare the energy stored in the arm with the work done on it.

    Each power is taken with the mean speed of its step. Onsets in a run would change
    what is stored.
    """
    rows, dt = trace.rows, float(trace.t[1] - trace.t[0])
    arm = trace.phases[0].constants
    speeds = rows[:, at.QD], rows[:, at.MOTOR_QD]
    link, motor = ((speed[1:] + speed[:-1]) / 2 for speed in speeds)
    now = rows[:-1]
    power = now[:, at.MOTOR] * motor
    lost = now[:, at.FRICTION] * motor
    at_motor = {row[2] for row in arm.torque if row[0] in friction_laws.AT_MOTOR}
    for i in range(len(trace.channels)):
        speed = motor if i in at_motor else link
        lost = lost + now[:, at.CHANNELS + i] * speed
    twist = np.abs(now[:, at.MOTOR_Q] - now[:, at.Q])
    engaged = (twist >= arm.joints[at.GAP]) & (arm.joints[at.ELASTIC] > 0)
    lost = lost + arm.joints[at.DAMPING] * engaged * (motor - link) ** 2
    work = np.concatenate([[0.0], np.cumsum((power - lost).sum(axis=1)) * dt])
    looks = range(0, len(rows), every)
    stored = np.array([_stored(trace, k) for k in looks])
    miss = stored - stored[0] - work[::every]
    return Balance(float(np.abs(miss).max()), float(np.abs(power).sum() * dt))


def _stored(trace: SimulationTrace, k: int) -> float:
    phase, now = trace.phases[0], trace.rows[k]
    model, arm = phase.model, phase.constants
    data, dof = model.createData(), model.nv
    energy = pin.computeKineticEnergy(model, data, now[at.Q], now[at.QD])
    energy += pin.computePotentialEnergy(model, data, now[at.Q])
    energy += 0.5 * (arm.joints[at.INERTIA] * now[at.MOTOR_QD] ** 2).sum()
    stretch = np.maximum(np.abs(now[at.MOTOR_Q] - now[at.Q]) - arm.joints[at.GAP], 0.0)
    energy += 0.5 * (arm.joints[at.STIFFNESS] * stretch**2).sum()
    for _, _, sign, first, second, inertia in arm.contacts[dof:]:
        speed = now[at.MOTOR_QD, int(first)] + sign * now[at.MOTOR_QD, int(second)]
        energy += 0.5 * inertia * speed**2
    return float(energy)
