"""One experiment: an arm with something to hide follows a reference and is logged."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from residual.errors import InputError
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from sim.engine.records import (
    PlantRun,
    PlantSpec,
    Rates,
    Reference,
    motion_label,
    stream,
)
from sim.plant import tables as at
from sim.plant.arm import Arm
from sim.plant.background import logged
from sim.plant.catalogue import acting
from sim.plant.controller import Law
from sim.plant.sensors import WHITE_TORQUE, encoder, hold_frozen, reported, torque_noise
from sim.plant.sizes import sizes
from sim.plant.stepping import Trace, drive
from sim.twin import twin_errors, twin_of


def run_experiment(
    robot: Robot,
    reference: Reference,
    plant: PlantSpec,
    rates: Rates = Rates(),  # noqa: B008  frozen
    start: float = 0.0,
    command: Array | Law | None = None,
) -> PlantRun:
    """Drive the arm of a spec along a reference, and its nominal twin.

    A pure function: the same arguments give the same bits, in any process. Noise
    differs from motion to motion, and with the start; the arm does not.

    Args:
        start: Time since the session began; the log's clock goes on from there, and
            the gears are as warm as after usual work for that long [s].
        command: What drives the arm in place of the nominal model: torque along the
            reference [N m], shape (n, dof), or a law of computed torque.
    """
    _check(reference, rates, robot.dof)
    trace = drive(robot, reference, plant, start, command)
    every = round(rates.control / rates.log)
    log = log_of(trace, reference, plant, rates, start)
    twin = twin_of(robot, _as_far(reference, len(trace.t)))
    truth = {**truth_of(trace, every), **_drawn(trace.arm, len(log.t))}
    return PlantRun(log, truth, twin_errors(log, trace, twin, every))


def log_of(
    trace: Trace, reference: Reference, plant: PlantSpec, rates: Rates, start: float
) -> Recording:
    """Return encoder positions, reported torque and reference at the log's rate.

    Args:
        start: Of the log on the clock of the session [s].
    """
    every = round(rates.control / rates.log)
    label, arm = motion_label(reference, start), trace.arm
    t, q = trace.t[::every], trace.rows[::every, at.READING]
    if plant.noise.encoder > 0:
        rng = stream(plant.seed, f"encoder/{label}")
        q = encoder(q, rng, plant.noise.encoder)
    hidden = acting(plant.effects)
    q = hold_frozen(q, t, hidden)
    tau = reported(trace.rows[:, at.DRIVE], trace.t, hidden)[::every]
    span = sizes(arm.robot).torque * (plant.noise.torque / WHITE_TORQUE)
    rng = stream(plant.seed, f"torque/{label}")
    tau = logged(
        arm.background, tau + torque_noise(len(t), span, rates.log, rng), rates.log
    )
    q_ref = reference.q[: len(trace.t) : every]
    return Recording("", arm.robot.name, start + t, q, tau, q_ref=q_ref)


def truth_of(trace: Trace, every: int) -> Mapping[str, Array]:
    """Return what no robot logs, at every n-th step.

    Torques add up: tau_motor = tau_rigid + tau_rotor + tau_friction + every explicit
    tau_<effect>, where tau_rigid is computed afresh from the motion. tau_drive is what
    the drives believe to give, tau_gear what the gears pass on.
    """
    rows = trace.rows[::every]
    names = {
        "q": at.Q,
        "qd": at.QD,
        "motor_q": at.MOTOR_Q,
        "motor_qd": at.MOTOR_QD,
        "reading": at.READING,
        "tau_drive": at.DRIVE,
        "tau_motor": at.MOTOR,
        "tau_rotor": at.ROTOR,
        "tau_friction": at.FRICTION,
        "tau_gear": at.GEAR,
        "tau_link": at.LINK,
        "temperature": at.TEMPERATURE,
    }
    truth = {name: rows[:, row].copy() for name, row in names.items()}
    truth["qdd"] = trace.qdd[::every].copy()
    truth["tau_rigid"] = trace.rigid(every)
    for i, channel in enumerate(trace.channels):
        truth[f"tau_{channel}"] = rows[:, at.CHANNELS + i].copy()
    return truth


def _drawn(arm: Arm, samples: int) -> Mapping[str, Array]:
    """Return every number of the background, at each sample: it is sealed with those.

    The same at all of them, which takes a few bytes in a column.
    """
    if arm.background is None:
        return {}
    return {
        f"background_{name}": np.tile(value, (samples, 1))
        for name, value in arm.background.drawn.items()
    }


def _as_far(reference: Reference, steps: int) -> Reference:
    """Return what was asked for until the arm was stopped; usually all of it."""
    if steps == len(reference.t):
        return reference
    names = ("t", "q", "qd", "qdd")
    return replace(reference, **{n: getattr(reference, n)[:steps] for n in names})


def _check(reference: Reference, rates: Rates, dof: int) -> None:
    ratio = rates.control / rates.log
    if ratio < 1 or abs(ratio - round(ratio)) > 1e-9:
        raise InputError(
            f"Control at {rates.control:g} Hz and log at {rates.log:g} Hz: expected "
            "control to be a whole multiple of log."
        )
    steps = np.diff(reference.t) * rates.control
    if len(steps) < 1 or np.abs(steps - 1).max() > 1e-6:
        raise InputError(
            f"The reference is not sampled at the control rate of {rates.control:g} Hz."
        )
    for name in ("q", "qd", "qdd"):
        array = getattr(reference, name)
        if array.shape != (len(reference.t), dof) or not np.isfinite(array).all():
            raise InputError(
                f"Reference {name}: expected {len(reference.t)} finite rows of {dof} "
                f"joints, got shape {array.shape}."
            )
