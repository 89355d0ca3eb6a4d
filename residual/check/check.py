"""The check of logs: from a robot and recordings to their faults."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from residual.check.column_reading import (
    ColumnReading,
    apply_reading,
    build_given_reading,
    compute_reading_odds,
    find_misread_columns,
    find_wrong_robot,
)
from residual.check.drive_chain import find_drive_faults
from residual.check.kinematics import (
    explains_by_zero_shift,
    find_impossible_sample_rate,
    find_joints_in_degrees,
    find_limit_violations,
    find_time_unit,
    find_uneven_time_steps,
    find_velocity_faults,
)
from residual.check.mounting import REMOVED, compute_body_evidence, find_mounting_fault
from residual.check.physics_columns import (
    CheckMotion,
    compute_nominal_torque,
    filter_check_motion,
)
from residual.check.result import MOUNTING, Fault, LogCheck, Repair, list_true_joints
from residual.check.sample_faults import (
    find_constant_angles,
    find_encoder_wraps,
    find_frozen_signals,
    find_spikes,
    scale_signal,
    smooth_spikes,
)
from residual.check.thresholds import CHECK
from residual.check.torque_shares import (
    build_torque_unit_fault,
    compute_torque_factors,
    find_commanded_torque,
    fit_nominal_shares,
)
from residual.check.torque_slips import TorqueSlips, find_torque_slips
from residual.errors import InputError, join_with_commas
from residual.recording import Recording
from residual.robot.dynamics import (
    PER_LINK,
    compute_last_joint_distance,
    compute_robot_regressor,
    read_inertial_parameters,
)
from residual.robot.limits import (
    drop_placeholder_limits,
    find_limit_flaws,
    find_placeholder_limits,
)
from residual.robot.plausibility import BODY_REMEDY, describe_body_flaws
from residual.robot.robot import Robot
from residual.signals.splitting import pick_spread_pieces

FEWEST_ROWS = 10  # of a joint that tells which weight its drive carries
_VELOCITY, WRONG = "velocity_mismatch", "wrong_robot"
# Kinds that the torque of the bodies in the robot file tells.
_BY_BODIES = frozenset(
    [
        "torque_sign",
        "angle_sign",
        "joint_order",
        "torque_unit",
        "angle_unit",
        "time_unit",
        "gear_ratio",
        "torque_scale",
        "gravity_removed",
        "friction_removed",
        "mounting",
        "wrong_robot",
    ]
)


def check_logs(robot: Robot, recordings: Sequence[Recording]) -> LogCheck:
    """Check that units, signs, order and timing of logs are consistent.

    A fault that others follow from is reported alone: with a wrong unit of time no
    speed is too high, and with a wrong robot file nothing fits.
    """
    if not recordings:
        raise InputError("No log to check: expected at least one recording, got none.")
    with np.errstate(all="ignore"):
        faults = [
            Fault(
                "robot_file",
                (),
                False,
                f"A placeholder: {words}; the other joints' limits are like it. They "
                "are not checked; give the real ones in robot.toml, [joints].",
            )
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
    # Mend units of time and angle that the velocities gave away.
    for repair in (r for fault in speeds for r in fault.repairs):
        if repair.signal in ("t", "q", "q_ref") and isinstance(repair.scale, float):
            logs = [scale_signal(r, repair.signal, repair.scale) for r in logs]
    turned = find_joints_in_degrees(robot, logs)
    if turned or dead:
        # Nothing more is known of an arm without one of its angles.
        return faults + dead + extend_repairs_to_velocities(turned, speeds, logs)
    found = _of_the_arm(robot, logs, speeds)
    if robot.flaws:
        # A body that cannot be explains what another reading of the log explains.
        found = [
            replace(f, certain=f.certain and (f.kind not in _BY_BODIES or f in speeds))
            for f in found
        ]
    return faults + found


def _of_the_arm(
    robot: Robot,
    logs: Sequence[Recording],
    speeds: Sequence[Fault],
) -> list[Fault]:
    """What the file, the motion and its physics say; the first that is certain wins.

    Physics is the same all along a log: of long ones seven minutes are looked at.
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
    columns, reading = find_misread_columns(robot, motion)
    slipped, mounted = find_torque_slips(robot, motion), None
    if slipped and slipped.alone and any(fault.certain for fault in columns):
        slipped = None
    given = build_given_reading(robot.dof)
    alone = motion.moving.any(axis=0).sum() < 2
    if alone and reading.torque_order != given.torque_order:
        # Of joints that are held no torque says whose it is.
        columns, reading = [], given
    # A reading that is not worth a word is none, and another arm's is no reading.
    counts = any(fault.kind != WRONG for fault in columns)
    read = _nats(robot, motion, reading if counts else given)
    second = -np.inf
    if reading.angle_unit == 1.0:
        mounted = find_mounting_fault(robot, motion)
    gone = mounted and mounted.fault.kind == REMOVED and not mounted.fault.certain
    if gone and explains_by_zero_shift(robot, motion, logs, given):
        mounted = None  # another zero says more than a weight that may be gone
    if mounted:
        # The rest is asked of the arm as it is mounted.
        also, then = find_misread_columns(mounted.robot, motion)
        # Of a load the weight is there where the arm's was taken out.
        alike = mounted.nats if mounted.fault.kind != MOUNTING else -np.inf
        second = max(_nats(mounted.robot, motion, then), alike) - CHECK.odds_nats
    rivals = ((read, columns), (second, [mounted.fault] if mounted else []))
    if slipped and all(_beats(slipped, *rival) for rival in rivals):
        columns, robot = list(slipped.faults), slipped.robot
        inclined = find_mounting_fault(robot, slipped.motion)
        if inclined and inclined.fault.kind == MOUNTING and inclined.fault.certain:
            # Rough factors of single torques turn gravity, too.
            columns.append(replace(inclined.fault, certain=False))
    else:
        if mounted and second > read:
            faults, robot = [*faults, mounted.fault], mounted.robot
            if mounted.fault.kind != MOUNTING:
                return [*faults, *speeds]
            columns, reading = also, then
        columns = _of_columns(robot, motion, columns)
    if columns and explains_by_zero_shift(robot, motion, logs, reading):
        return [*faults, *speeds, *find_limit_violations(robot, whole)]
    columns += find_commanded_torque(robot, logs)
    mended = any(fault.certain for fault in (*columns, *speeds))
    faults += extend_repairs_to_velocities(columns, speeds, logs)
    return faults if mended else faults + find_limit_violations(robot, whole)


def _beats(slipped: TorqueSlips, nats: float, faults: Sequence[Fault]) -> bool:
    """Whether slips win against faults; no absolute is said of what a pair explains."""
    sure = {fault.kind for fault in slipped.faults if fault.certain}
    if any(fault.kind == REMOVED and fault.certain for fault in faults) and not sure:
        return False
    absolute = any(fault.kind in (WRONG, REMOVED) for fault in faults)
    surer = any(fault.kind in sure and not fault.certain for fault in faults)
    return not faults or surer or (slipped.pair and absolute) or slipped.nats >= nats


def _of_columns(robot: Robot, motion: CheckMotion, columns: list[Fault]) -> list[Fault]:
    """What single readings of the columns say, else the arm."""
    if any(fault.kind == "gear_ratio" and not fault.repairs for fault in columns):
        shares = fit_nominal_shares(robot, motion)
        factors = compute_torque_factors(shares)
        columns = (
            columns
            if factors is None
            else [build_torque_unit_fault(robot, factors, shares)]
        )
    return columns or find_wrong_robot(robot, motion)


def _nats(robot: Robot, motion: CheckMotion, reading: ColumnReading) -> float:
    """Log evidence of one body under other columns than those given, less the odds."""
    nats = compute_body_evidence(robot, apply_reading(robot, motion, reading))
    # As likely as the log itself, in the unit that it is in.
    rows = motion.spread * motion.moving.sum()
    return (
        nats + float(rows * np.log(reading.torque_unit)) - compute_reading_odds(reading)
    )


def extend_repairs_to_velocities(
    faults: Sequence[Fault], speeds: Sequence[Fault], logs: Sequence[Recording]
) -> list[Fault]:
    """Carry repairs of angles to velocities and references, and join both checks.

    A velocity that runs against an angle is no fault of the velocity where it is the
    angle that counts backwards.
    """
    with_speed = any(r.qd is not None for r in logs)
    of_speed = [(f, r) for f in speeds if f.kind == _VELOCITY for r in f.repairs]
    by_nature = {(r.order is None, r.sign is None): (f, r) for f, r in of_speed}
    explained, out = set(), []
    for fault in faults:
        more = []
        for repair in (r for r in fault.repairs if r.signal == "q" and with_speed):
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
    """Mend references with their angles, where they are logged alike, all channels."""
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


def confirm_repairs(
    robot: Robot, log: Recording, others: Sequence[Recording], repairs: Iterable[Repair]
) -> bool:
    """Whether one log, read as repairs say, is of the same arm as the other logs.

    A short log alone may fit a wrong reading better; with the others it must, too. Both
    evidences are of one body and of the torques in the unit of the file.
    """
    mended, units = log, 0.0
    for repair in sorted(repairs, key=lambda r: r.order is None):
        values = getattr(mended, repair.signal, None)
        if values is None or (repair.sign, repair.scale, repair.order) == (None,) * 3:
            continue
        if repair.signal == "t":
            mended = scale_signal(mended, "t", repair.scale)
            continue
        factor = np.ones(log.dof)
        at = [j - 1 for j in repair.joints] or slice(None)
        factor[at] = np.multiply(repair.sign or 1, repair.scale or 1)
        order = [j - 1 for j in repair.order or range(1, log.dof + 1)]
        mended = replace(mended, **{repair.signal: values[:, order] * factor})
        if repair.signal == "tau":
            units += np.log(np.abs(factor))
    with np.errstate(all="ignore"):
        motions = [
            filter_check_motion(pick_spread_pieces([one, *others]))
            for one in (log, mended)
        ]
        if None in motions:
            return False
        before, after = (compute_body_evidence(robot, motion) for motion in motions)
        own = filter_check_motion([log])
    rows = 0.0 if own is None else own.spread * own.moving.sum(axis=0)
    return after + float(np.sum(rows * units)) > before + CHECK.suspect_nats


def check_robot(robot: Robot) -> LogCheck:
    """Check the file of a robot alone: bodies, gravity and limits."""
    faults = find_robot_file_faults(robot)
    for joint, words in find_limit_flaws(robot):
        faults.append(Fault("robot_file", (joint,), False, words))
    return LogCheck(tuple(faults))


def find_robot_file_faults(robot: Robot) -> list[Fault]:
    """Find masses, lengths, moments and gravity that no arm has."""
    bodies, out = list(robot.model.inertias)[1:], []
    mass, last = sum(b.mass for b in bodies), bodies[-1]
    reach = compute_last_joint_distance(robot.model) + np.linalg.norm(last.lever)
    if not reach:  # a wheel: its radius
        reach = np.sqrt(np.trace(last.inertia) / max(last.mass, 1e-9))
    density = mass / max(reach, 1e-6) ** 3  # kg/m^3 of the cube of the reach
    # A weight at the end of a lever is as dense as a ball of steel about the joint.
    densest = 1e3 if robot.dof > 2 else 3e4
    for there, sizes, unit, scale in (
        (reach > 50.0, "lengths", "millimetres", 1e-3),
        (density > densest and reach > 0.05, "masses", "grams", 1e-3),
        (reach < 0.01 and mass > 1, "lengths", "kilometres", 1e3),
        (density < 1e-2, "masses", "tonnes", 1e3),
    ):
        if there:
            words = (
                f"The arm weighs {mass:.4g} kg and reaches {reach:.4g} m: its {sizes} "
                f"look like {unit}."
            )
            repairs = (Repair("robot", scale=scale),)
            out.append(Fault("robot_file", (), True, words, repairs))
            break
    size = float(np.linalg.norm(robot.model.gravity.linear))
    if size and not CHECK.earth_gravity[0] < size < CHECK.earth_gravity[1]:
        words = f"Gravity is {size:.4g} m/s^2 in the robot file, expected 9.81."
        out.append(Fault("robot_file", (), size > 3 * CHECK.earth_gravity[1], words))
    if robot.flaws and not out:
        joints = tuple(sorted({flaw.joint for flaw in robot.flaws}))
        words = f"{'; '.join(describe_body_flaws(robot.flaws))}. {BODY_REMEDY}"
        out.append(Fault("robot_file", joints, False, words))
    return out


def find_weight_in_torque(
    robot: Robot, motion: CheckMotion
) -> tuple[Robot, list[Fault]]:
    """Return the arm whose drives carry what the logs show, and the fault if other.

    A file may say that a force beside the drives holds a part of the weight; whether a
    log was taken so, only its torque says: beside friction and rotors it lacks a share
    of that part, near one or near none.
    """
    if robot.carried is None:
        return robot, []
    free = replace(robot, carried=None)
    regressor = compute_robot_regressor(free, motion.q, motion.qd, motion.qdd)
    whole = regressor @ read_inertial_parameters(robot.model)
    held = whole - compute_nominal_torque(robot, motion)
    parts = []
    for j in np.flatnonzero(motion.moving.sum(axis=0) > FEWEST_ROWS):
        use, tau = motion.moving[:, j], motion.tau[:, j]
        qd, qdd = motion.qd[use, j], motion.qdd[use, j]
        drive = np.stack([np.ones_like(qd), qd, np.sign(qd), qdd], axis=1)
        load = regressor[use, j, -PER_LINK:]  # a tool that the file does not have
        part = np.column_stack([held[use, j], (whole[:, j] - tau)[use], load])
        part -= drive @ np.linalg.lstsq(drive, part, rcond=None)[0]
        parts.append(part / max(float(np.sqrt(np.mean(tau[use] ** 2))), 1e-9))
    if not parts:
        return robot, []
    rows = np.concatenate(parts)
    load = rows[:, 2:]
    alone = rows[:, :2] - load @ np.linalg.lstsq(load, rows[:, :2], rcond=None)[0]
    power = float(rows[:, 0] @ rows[:, 0])
    # On few joints a load may look like the weight of all links.
    apart = float(alone[:, 0] @ alone[:, 0]) > CHECK.weight_share**2 * power
    looked_at = alone if apart else rows
    share = float(looked_at[:, 0] @ looked_at[:, 1])
    share /= max(float(looked_at[:, 0] @ looked_at[:, 0]), 1e-300)
    if abs(share) > 0.5:
        return robot, []
    words = (
        f"The torque has the weight of {join_with_commas(robot.carried.links)}, which "
        "the file says is held beside the drives (gravcomp): it lacks "
        f"{100 * abs(share):.0f} % of it."
    )
    repairs = (Repair("robot", gravcomp=False),)
    sure = apart and abs(share) < CHECK.weight_share
    return free, [Fault("robot_file", (), sure, words, repairs)]


def find_insufficient_motion(
    recordings: Sequence[Recording], motion: CheckMotion | None
) -> list[Fault]:
    """Find logs that are too short, and joints that do not move on their own."""
    seconds, out = sum(r.duration for r in recordings), []
    if seconds < CHECK.shortest_s:
        words = (
            f"The logs last {seconds:.3g} s together; below {CHECK.shortest_s:g} s the "
            "motion does not tell friction, weight and inertia apart."
        )
        out.append(Fault("too_short", (), False, words))
    forth, back = np.zeros((2, recordings[0].dof))
    for recording in recordings:
        step = max(1, len(recording.t) // 200)
        change = np.diff(recording.q[::step], axis=0)
        forth += np.maximum(change, 0).sum(axis=0)
        back += np.maximum(-change, 0).sum(axis=0)
    path = forth + back
    one_way = np.minimum(forth, back) < CHECK.one_way_share * path
    if joints := list_true_joints(one_way & (path > CHECK.travel_rad)):
        words = (
            f"Joints {join_with_commas(joints)} never reverse: dry friction and a "
            f"constant "
            "torque cannot be told apart there."
        )
        out.append(Fault("no_reversal", joints, False, words))
    if motion is None:
        return out
    qd = motion.qd[motion.moving.any(axis=1)]
    moves = np.ptp(motion.q, axis=0) > CHECK.travel_rad
    if moves.sum() < 2 or len(qd) < 10:
        return out
    unit = np.where(moves, qd / np.maximum(np.linalg.norm(qd, axis=0), 1e-12), 0.0)
    related = np.abs(unit.T @ unit) - np.diag(np.sum(unit**2, axis=0))
    if tied := list_true_joints((related > CHECK.lockstep_correlation).any(axis=0)):
        words = (
            f"The speeds of joints {join_with_commas(tied)} are proportional "
            f"(correlation "
            f"{related.max():.4f}): what belongs to which of them cannot be told."
        )
        out.append(Fault("lockstep", tied, False, words))
    return out
