"""One experiment: the log of an arm with hidden effects, and its nominal twin.

The twin is the model as described, driven along the same reference. Its distance from
the arm is the error of the paper: e_tau, e_q and so on. The paper feeds one reference to
arm and model and takes the difference of their motions and torques (its figure 2); a
measured log with the reference suffices for that.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from residual.errors import InputError
from residual.recording import Array, Recording
from residual.robot.files import DeclaredEffect
from residual.robot.robot import Robot
from sim.engine.plant_records import (
    PlantRun,
    PlantSpec,
    ReferenceMotion,
    SampleRates,
    create_random_stream,
    format_motion_label,
)
from sim.plant import step_tables as at
from sim.plant.closed_loop import (
    Law,
    SimulationTrace,
    build_and_simulate,
    build_open_loop_controller,
    build_servo_law,
    follow_goal,
    simulate_closed_loop,
)
from sim.plant.effect_catalogue import list_drive_effects
from sim.plant.plant_arm import build_plant_arm, simulate_torque_logging
from sim.plant.sensors import (
    WHITE_TORQUE,
    draw_torque_noise,
    repeat_frozen_readings,
    simulate_encoder,
    simulate_torque_report,
)
from sim.plant.typical_sizes import estimate_typical_sizes

_NOMINAL = PlantSpec(scatter=0.0)
_NOTHING = 1e-6  # N m, N m s/rad, kg m^2: the plant needs some inertia of a rotor
LOGGED = "logged"  # the family of a reference planned elsewhere


def simulate_nominal_twin(
    robot: Robot, reference: ReferenceMotion, command: Law | None = None
) -> SimulationTrace:
    """Simulate the nominal model, friction as declared, in closed loop."""
    return build_and_simulate(robot, reference, _NOMINAL, command=command)


def compute_twin_errors(
    log: Recording, plant: SimulationTrace, twin: SimulationTrace, stride: int
) -> Mapping[str, Array]:
    """Return measured minus simulated: e_q, e_qd, e_qdd and e_tau.

    Positions and torques are those of the log. Speeds are those that the drives read
    on the motors, without the noise of the log; accelerations are their differences.

    Args:
        stride: Control steps per sample of the log.
    """
    rate = plant.rows[:, at.READING_RATE]
    dt = plant.t[1] - plant.t[0]
    change = np.diff(rate, axis=0, append=rate[-1:]) / dt
    return {
        "e_q": log.q - twin.rows[::stride, at.Q],
        "e_qd": rate[::stride] - twin.rows[::stride, at.QD],
        "e_qdd": (change - twin.qdd)[::stride],
        "e_tau": log.tau - twin.rows[::stride, at.DRIVE],
    }


def measure_tracking_errors(
    robot: Robot, reference: ReferenceMotion, plant: PlantSpec, torque: Array
) -> Array:
    """Drive the arm by given torques with plain feedback; return how it tracks.

    The better the model that computed the torques, the smaller the error: the
    validation by feed-forward of the paper's section 1.3.

    Returns:
        Measured minus reference position [rad]. Shape (n, dof).
    """
    trace = build_and_simulate(robot, reference, plant, command=torque)
    return trace.rows[:, at.READING] - reference.q


def simulate_open_loop_windows(
    robot: Robot, reference: ReferenceMotion, torque: Array, window: float
) -> Array:
    """Simulate the nominal model under given torques, a window at a time.

    Args:
        torque: Torques measured on it, at the same times [N m]. Shape (n, dof).
        window: Length of a window [s]; without feedback errors grow quickly.

    Returns:
        Simulated minus measured position [rad]. Shape (n, dof).
    """
    arm, error = build_plant_arm(robot, _NOMINAL), np.zeros_like(reference.q)
    length = max(2, round(window / (reference.t[1] - reference.t[0])))
    for first in range(0, len(reference.t), length):
        part = slice(first, first + length)
        if first + 2 > len(reference.t):
            break
        own = (x[part] for x in (reference.q, reference.qd, reference.qdd))
        t = reference.t[part] - reference.t[first]
        piece = ReferenceMotion(reference.kind, t, *own, None)
        trace = simulate_closed_loop(arm, piece, build_open_loop_controller(torque[part]))
        error[part] = trace.rows[:, at.Q] - piece.q
    return error


def build_logged_reference(log: Recording) -> ReferenceMotion:
    """Return the reference of a log at the rate of the controller.

    A cubic spline through the logged positions, since the controller needs their
    derivatives; the rate is the next multiple of that of the log.
    """
    if log.q_ref is None:
        raise InputError(f"{log.id} has no reference (q_ref): a twin needs one to follow.")
    step = float(np.median(np.diff(log.t)))
    dt = step / max(1, round(SampleRates().control * step))
    t = np.arange(round(log.duration / dt) + 1) * dt
    spline = CubicSpline(log.t - log.t[0], log.q_ref, axis=0)
    q, qd, qdd = (spline(t, order) for order in range(3))
    return ReferenceMotion(LOGGED, t, q, qd, qdd, None)


def compute_log_twin_errors(robot: Robot, log: Recording) -> Mapping[str, Array]:
    """Return measured minus simulated: e_q, e_qd, e_qdd and e_tau.

    The twin is the robot as described. It has no dry or viscous friction and no rotors
    that the description lacks, since they are unknown. Its drives have no limits: the
    arm followed, and without an undescribed body (a balancer) the twin may need more
    torque than the limits. Speeds that are not logged, and accelerations, are
    differences.
    """
    reference = build_logged_reference(log)
    twin = simulate_nominal_twin(_as_described(robot), reference)
    qd = np.gradient(log.q, log.t, axis=0) if log.qd is None else log.qd
    measured = {"e_q": log.q, "e_qd": qd, "e_tau": log.tau}
    measured["e_qdd"] = np.gradient(qd, log.t, axis=0)
    simulated = {"e_q": twin.rows[:, at.Q], "e_qd": twin.rows[:, at.QD]}
    simulated |= {"e_qdd": twin.qdd, "e_tau": twin.rows[:, at.DRIVE]}
    moments, errors = log.t - log.t[0], {}
    for name, values in measured.items():
        columns = (np.interp(moments, reference.t, x) for x in simulated[name].T)
        errors[name] = values - np.column_stack(list(columns))
    return errors


def _as_described(robot: Robot) -> Robot:
    """Return zeros for undeclared values, which would default to typical ones."""
    silent = {
        effect.name: DeclaredEffect({effect.amount[0]: np.full(robot.dof, _NOTHING)})
        for effect in list_drive_effects()
        if not getattr(robot.declared.get(effect.name), "values", None)
    }
    unlimited = np.full(robot.dof, np.inf)
    declared = {**robot.declared, **silent}
    return replace(robot, declared=declared, torque_limit=unlimited)


def run_experiment(
    robot: Robot,
    reference: ReferenceMotion,
    plant: PlantSpec,
    rates: SampleRates = SampleRates(),  # noqa: B008  frozen
    start: float = 0.0,
    command: Array | Law | None = None,
) -> PlantRun:
    """Drive the arm of a spec along a reference, and its nominal twin.

    A pure function: the same arguments give the same bits, in any process. Noise
    differs from motion to motion, and with the start; the arm does not.

    Args:
        start: Time since the session began; the log's clock goes on from there, and
            the gears are as warm as after usual work for that long [s].
        command: Control of the arm in place of the nominal model: torque along the
            reference [N m], shape (n, dof), or a law of computed torque. An arm with
            servos (``plant.drive``) is sent the reference as its goal instead; its log
            has no torque, but zeros.
    """
    _check(reference, rates, robot.dof)
    every, path, servo = round(rates.control / rates.log), reference, None
    if plant.drive is not None:
        path = follow_goal(plant.drive, reference, every)
        command = servo = build_servo_law(plant.drive, path)
    trace = build_and_simulate(robot, path, plant, start, command)
    log = record_plant_log(trace, reference, plant, rates, start)
    # The twin follows the reference until the arm was stopped; usually all of it.
    names, steps = ("t", "q", "qd", "qdd"), len(trace.t)
    followed = {name: getattr(path, name)[:steps] for name in names}
    twin = simulate_nominal_twin(robot, replace(path, **followed), servo)
    truth = dict(extract_hidden_channels(trace, every))
    # Sealed with the truth at each sample, which takes a few bytes in a column.
    background = trace.arm.background
    for name, value in background.drawn.items() if background is not None else ():
        truth[f"background_{name}"] = np.tile(value, (len(log.t), 1))
    errors = dict(compute_twin_errors(log, trace, twin, every))
    if servo is not None:  # no torque is logged
        del errors["e_tau"]
    return PlantRun(log, truth, errors)


def record_plant_log(
    trace: SimulationTrace,
    reference: ReferenceMotion,
    plant: PlantSpec,
    rates: SampleRates,
    start: float,
) -> Recording:
    """Return encoder positions, reported torque and reference at the log's rate.

    Args:
        start: Of the log on the clock of the session [s].
    """
    every = round(rates.control / rates.log)
    label, arm = format_motion_label(reference, start), trace.arm
    t, q = trace.t[::every], trace.rows[::every, at.READING]
    if plant.noise.encoder > 0:
        rng = create_random_stream(plant.seed, f"encoder/{label}")
        q = simulate_encoder(q, rng, plant.noise.encoder)
    q = repeat_frozen_readings(q, t, arm.effects)
    tau = simulate_torque_report(trace.rows[:, at.DRIVE], trace.t, arm.effects)[::every]
    span = estimate_typical_sizes(arm.robot).torque * (plant.noise.torque / WHITE_TORQUE)
    rng = create_random_stream(plant.seed, f"torque/{label}")
    tau = simulate_torque_logging(
        arm.background, tau + draw_torque_noise(len(t), span, rates.log, rng), rates.log
    )
    if plant.drive is not None:
        tau = np.zeros_like(tau)
    q_ref = reference.q[: len(trace.t) : every]
    return Recording("", arm.robot.name, start + t, q, tau, q_ref=q_ref)


def extract_hidden_channels(trace: SimulationTrace, stride: int) -> Mapping[str, Array]:
    """Return the hidden channels, at every n-th step.

    Torques add up: tau_motor = tau_rigid + tau_rotor + tau_friction + every explicit
    tau_<effect>, where tau_rigid is computed afresh from the motion. tau_drive is the
    torque that the drives report, tau_gear the one that the gears transmit.
    """
    rows = trace.rows[::stride]
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
    truth["qdd"] = trace.qdd[::stride].copy()
    truth["tau_rigid"] = trace.rigid(stride)
    for i, channel in enumerate(trace.channels):
        truth[f"tau_{channel}"] = rows[:, at.CHANNELS + i].copy()
    return truth


def _check(reference: ReferenceMotion, rates: SampleRates, dof: int) -> None:
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
