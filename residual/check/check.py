"""The check of logs: from a robot and recordings to their faults."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from residual.check.drive_chain import find_commanded_torque, find_drive_faults
from residual.check.evidence import (
    ROUGH,
    CheckMotion,
    Torques,
    compute_residual,
    filter_check_motion,
    fit_arm,
    sum_arm,
)
from residual.check.gravcomp import find_weight_in_torque
from residual.check.kinematics import (
    find_impossible_sample_rate,
    find_joints_in_degrees,
    find_limit_violations,
    find_time_unit,
    find_uneven_time_steps,
    find_velocity_faults,
    find_wrong_gravity,
    find_wrong_units,
)
from residual.check.readings import find_misreadings
from residual.check.result import UNITS, Fault, LogCheck, Repair, list_true_joints
from residual.check.sample_faults import (
    find_constant_angles,
    find_encoder_wraps,
    find_frozen_signals,
    find_spikes,
    scale_signal,
    smooth_spikes,
)
from residual.check.slips import repair_motion, repair_torques
from residual.check.thresholds import CHECK
from residual.errors import InputError, join_with_commas
from residual.recording import Recording
from residual.robot.limits import drop_placeholder_limits, find_limit_flaws, find_placeholder_limits
from residual.robot.plausibility import BODY_REMEDY, describe_body_flaws
from residual.robot.robot import Robot
from residual.signals.splitting import pick_spread_pieces

_VELOCITY = "velocity_mismatch"
_LIMITS = (
    "; the other joints' limits are like it. They are not checked; give the real ones in "
    "robot.toml, [joints]."
)


def check_logs(robot: Robot, recordings: Sequence[Recording]) -> LogCheck:
    """Check that units, signs, order and timing of logs are consistent.

    A fault that causes others is reported alone: a wrong unit of time also makes speeds
    too high, and a wrong robot file fits nothing.
    """
    if not recordings:
        raise InputError("No log to check: expected at least one recording, got none.")
    with np.errstate(all="ignore"):
        faults = [
            Fault("robot_file", (), False, f"A placeholder: {words}{_LIMITS}")
            for words in find_placeholder_limits(robot, recordings).values()
        ]
        robot = drop_placeholder_limits(robot, recordings)
        faults += _faults(robot, recordings)
        if any(r.drive is not None for r in recordings):
            # A torque without a column has no unit or sign: all of it is the drive's.
            faults = [f for f in faults if all(r.signal != "tau" for r in f.repairs)]
    return LogCheck(tuple(sorted(faults, key=lambda fault: not fault.certain)))


def _faults(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    single = [(r, find_spikes(r)) for r in recordings]
    faults = [fault for _, found in single for fault in found]
    logs = [smooth_spikes(r) if found else r for r, found in single]
    clock = find_time_unit(robot, logs)
    if clock is not None:
        faults.append(clock)
        logs = [scale_signal(r, "t", clock.repairs[0].scale) for r in logs]
    if unusable := find_impossible_sample_rate(logs):
        return faults + unusable
    wrapped = [fault for log in logs for fault in find_encoder_wraps(log, robot)]
    if wrapped:
        return faults + wrapped
    dead = [fault for log in logs for fault in find_constant_angles(robot, log)]
    for log in logs:
        faults += find_uneven_time_steps(log) + find_frozen_signals(log)
    speeds = _with_references(find_velocity_faults(logs), logs)
    # Repair units of time and angle that the velocities reveal.
    for repair in (r for fault in speeds for r in fault.repairs):
        if repair.signal in ("t", "q", "q_ref") and isinstance(repair.scale, float):
            logs = [scale_signal(r, repair.signal, repair.scale) for r in logs]
    turned = find_joints_in_degrees(robot, logs)
    if turned or dead:
        # Without one of its angles, nothing else of the arm can be checked.
        return faults + dead + extend_repairs_to_velocities(turned, speeds, logs)
    return faults + _of_the_arm(robot, logs, speeds)


def _of_the_arm(robot: Robot, logs: Sequence[Recording], speeds: Sequence[Fault]) -> list[Fault]:
    """Faults by the file, the motion and its physics; the first certain one wins.

    Physics does not change along a log: long ones are cut to seven minutes.
    """
    driven, logs = find_drive_faults(robot, logs)
    faults, whole = find_robot_file_faults(robot) + driven, logs
    logs = pick_spread_pieces(logs)
    motion = filter_check_motion(logs)
    faults += find_insufficient_motion(logs, motion)
    if motion is None or any(fault.certain for fault in faults if fault not in driven):
        return [*faults, *speeds]
    robot, held = find_weight_in_torque(robot, motion)
    faults += held
    agree = not speeds and all(r.qd is not None for r in logs)
    columns = find_misreadings(robot, motion, agree)
    as_it_stands, _ = repair_motion(
        robot, motion, [r for f in columns for r in f.repairs if r.gravity]
    )
    columns += find_commanded_torque(as_it_stands, logs)
    # In a wrong unit everything exceeds its limit.
    mended = any(f.certain or f.kind in UNITS for f in (*columns, *speeds))
    faults += extend_repairs_to_velocities(columns, speeds, logs)
    return faults if mended else faults + find_limit_violations(robot, whole)


def extend_repairs_to_velocities(
    faults: Sequence[Fault], speeds: Sequence[Fault], logs: Sequence[Recording]
) -> list[Fault]:
    """Extend repairs of angles to velocities and references, and join both checks.

    A velocity with the opposite sign of its angle is no fault if the angle itself has
    the wrong sign.
    """
    with_speed = any(r.qd is not None for r in logs)
    of_speed = [(f, r) for f in speeds if f.kind == _VELOCITY for r in f.repairs]
    by_nature = {(r.order is None, r.sign is None): (f, r) for f, r in of_speed}
    explained, out = set(), []
    for fault in faults:
        more = []
        angles = [r for r in fault.repairs if r.signal == "q" and r.zero is None]
        for repair in angles if with_speed else ():
            nature = repair.order is None, repair.sign is None
            velocity, own = by_nature.get(nature, (None, Repair("qd")))
            if repair.order is not None:
                before = own.order or tuple(range(1, len(repair.order) + 1))
                order = tuple(before[i - 1] for i in repair.order)
                more += [Repair("qd", order=order)] * (order != tuple(sorted(order)))
                explained.add(velocity)
            elif repair.sign is not None:
                joints = tuple(j for j in repair.joints if j not in own.joints)
                sign = (-1,) * len(joints)
                more += [Repair("qd", joints, sign=sign)] * bool(joints)
                if set(own.joints) <= set(repair.joints):
                    explained.add(velocity)
            else:
                more.append(replace(repair, signal="qd"))
        out.append(replace(fault, repairs=(*fault.repairs, *more)))
    return _with_references(out, logs) + [f for f in speeds if f not in explained]


def _with_references(faults: Sequence[Fault], logs: Sequence[Recording]) -> list[Fault]:
    """Repair references with their angles, if all channels are logged alike."""
    both = [r for r in logs if r.q_ref is not None]
    if not both:
        return list(faults)
    away = np.max([np.median(np.abs(r.q - r.q_ref), axis=0) for r in both], axis=0)
    travel = np.max([np.ptp(r.q, axis=0) for r in both])
    if np.any(away > 0.1 * travel):
        return list(faults)
    out = []
    for fault in faults:
        own = [replace(r, signal="q_ref") for r in fault.repairs if r.signal == "q"]
        out.append(replace(fault, repairs=(*fault.repairs, *own)))
    return out


def list_odd_logs(robot: Robot, recordings: Sequence[Recording]) -> list[Recording]:
    """Return the logs that fit a common arm worse than the others do."""
    with np.errstate(all="ignore"):
        motion = filter_check_motion(recordings)
        if motion is None:
            return list(recordings)
        sums, dof = sum_arm(robot, motion), robot.dof
        as_given = Torques(np.arange(dof), np.ones(dof))
        fit = fit_arm(sums, as_given, sums.deviations(ROUGH))
        rest = compute_residual(robot, motion, fit.at)
        squares, counts = np.nan_to_num(rest**2), np.isfinite(rest)
        rms = []  # NaN where a joint stands still in the whole log
        for k in range(len(recordings)):
            own = motion.log == k
            mean = squares[own].sum(axis=0) / counts[own].sum(axis=0)
            rms.append(np.sqrt(mean))
    out = []
    for k, log in enumerate(recordings):
        others = np.nan_to_num(np.delete(rms, k, axis=0), nan=np.inf).min(axis=0)
        usual = np.maximum(2 * others, CHECK.rough_rest * fit.size)
        if np.any(rms[k] > usual) or np.isnan(rms[k]).all():
            out.append(log)
    return out


def confirm_repairs(
    robot: Robot, log: Recording, others: Sequence[Recording], repairs: Iterable[Repair]
) -> bool:
    """Whether one log, after repairs, is of the same arm as the other logs.

    A short log alone may fit a wrong reading better, so it must also do so with the
    others. Both evidences use one body and the torques in the unit of the file.
    """
    repairs = [r for r in repairs if r.signal in ("q", "t", "tau")]
    with np.errstate(all="ignore"):
        motion = filter_check_motion(pick_spread_pieces([log, *others]))
        own = filter_check_motion([log])
        if motion is None or own is None:
            return False
        _, mended = repair_motion(robot, own, repairs)
        torques = repair_torques(repairs, robot.dof)
        mended = replace(mended, tau=own.tau[:, torques.order] * torques.factor)
        rest = filter_check_motion(pick_spread_pieces(others))
        given = Torques(np.arange(robot.dof), np.ones(robot.dof))
        before, after = (
            fit_arm(sums, given, sums.deviations(ROUGH)).nats
            for each in (own, mended)
            for sums in (sum_arm(robot, each.join(rest)),)
        )
    rows = own.spread * own.moving.sum(axis=0)
    units = float(rows @ np.log(np.abs(torques.factor)))
    return after + units > before + CHECK.suspect_nats


def check_robot(robot: Robot) -> LogCheck:
    """Check the file of a robot alone: bodies, gravity and limits."""
    faults = find_robot_file_faults(robot)
    for joint, words in find_limit_flaws(robot):
        faults.append(Fault("robot_file", (joint,), False, words))
    return LogCheck(tuple(faults))


def find_robot_file_faults(robot: Robot) -> list[Fault]:
    """Find impossible masses, lengths, moments and gravity."""
    out = find_wrong_units(robot) + find_wrong_gravity(robot)
    if robot.flaws and not out:
        joints = tuple(sorted({flaw.joint for flaw in robot.flaws}))
        words = f"{'; '.join(describe_body_flaws(robot.flaws))}. {BODY_REMEDY}"
        out.append(Fault("robot_file", joints, False, words))
    return out


def find_insufficient_motion(
    recordings: Sequence[Recording], motion: CheckMotion | None
) -> list[Fault]:
    """Find logs that are too short, and joints that do not move independently."""
    seconds, out = sum(r.duration for r in recordings), []
    if seconds < CHECK.shortest_s:
        words = f"The logs last {seconds:.3g} s together; below {CHECK.shortest_s:g} s the "
        words += "motion does not tell friction, weight and inertia apart."
        out.append(Fault("too_short", (), False, words))
    forth, back = np.zeros((2, recordings[0].dof))
    for log in recordings:
        change = np.diff(log.q[:: max(1, len(log.t) // 200)], axis=0)
        forth += np.maximum(change, 0).sum(axis=0)
        back += np.maximum(-change, 0).sum(axis=0)
    path = forth + back
    one_way = np.minimum(forth, back) < CHECK.one_way_share * path
    if joints := list_true_joints(one_way & (path > CHECK.moving_rad)):
        words = f"Joints {join_with_commas(joints)} never reverse: dry friction and a constant "
        words += "torque cannot be told apart there."
        out.append(Fault("no_reversal", joints, False, words))
    if motion is None:
        return out
    qd = motion.qd[motion.moving.any(axis=1)]
    moves = np.ptp(motion.q, axis=0) > CHECK.moving_rad
    if moves.sum() < 2 or len(qd) < 10:
        return out
    unit = np.where(moves, qd / np.maximum(np.linalg.norm(qd, axis=0), 1e-12), 0.0)
    related = np.abs(unit.T @ unit) - np.diag(np.sum(unit**2, axis=0))
    if tied := list_true_joints((related > CHECK.lockstep_correlation).any(axis=0)):
        words = f"The speeds of joints {join_with_commas(tied)} are proportional (correlation "
        words += f"{related.max():.4f}): what belongs to which of them cannot be told."
        out.append(Fault("lockstep", tied, False, words))
    return out
