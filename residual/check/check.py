"""From a robot and its recordings to the faults that they have."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.check.file_limits import doubted_limits, excursions
from residual.check.kinematics import (
    degrees,
    no_clock,
    out_of_range,
    time_unit,
    uneven,
    velocity_faults,
    zero_explains,
)
from residual.check.motion import Motion, thin_rows
from residual.check.mounting import REMOVED, mounting, nats_of
from residual.check.physics import misread, other_time, wrong_robot
from residual.check.reading import Reading, as_given, odds_of, read_by
from residual.check.reported import (
    common_factor,
    joints_exchanged,
    shares_of,
    torque_factors,
    unit_fault,
)
from residual.check.result import MOUNTING, Fault, LogCheck, Repair, joints_of
from residual.check.rules import CHECK
from residual.check.samples import (
    constant,
    spikes,
    standing,
    with_scale,
    without_spikes,
    wraps,
)
from residual.check.slips import Slips, slips
from residual.check.torque_source import commanded, filtered
from residual.errors import InputError, listed
from residual.recording import Recording
from residual.robot.dynamics import joints_length
from residual.robot.limits import with_real_limits
from residual.robot.robot import Robot
from residual.signals.splitting import sketch_of

_VELOCITY, WRONG = "velocity_mismatch", "wrong_robot"


def check_logs(robot: Robot, recordings: Sequence[Recording]) -> LogCheck:
    """Check whether logs are what they say they are.

    A fault that others follow from is reported alone: with a wrong unit of time no
    speed is too high, and with a wrong robot file nothing fits.
    """
    if not recordings:
        raise InputError("No log to check: expected at least one recording, got none.")
    with np.errstate(all="ignore"):
        faults = doubted_limits(robot, recordings)
        robot = with_real_limits(robot, recordings)
        faults += _faults(robot, recordings)
    return LogCheck(tuple(sorted(faults, key=lambda fault: not fault.certain)))


def _faults(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    single = [(r, spikes(r)) for r in recordings]
    faults = [fault for _, found in single for fault in found]
    logs = [without_spikes(r) if found else r for r, found in single]
    clock = time_unit(robot, logs)
    if clock is not None:
        faults.append(clock)
        logs = [with_scale(r, "t", clock.repairs[0].scale) for r in logs]
    if unusable := no_clock(logs):
        return faults + unusable
    wrapped = [fault for log in logs for fault in wraps(log, robot)]
    if wrapped:
        return faults + wrapped
    dead = [fault for log in logs for fault in constant(robot, log)]
    for log in logs:
        faults += uneven(log) + standing(log)
    speeds = _with_references(velocity_faults(logs), logs)
    # Mend units of time and angle that the velocities gave away.
    for repair in (r for fault in speeds for r in fault.repairs):
        if repair.signal in ("t", "q", "q_ref") and isinstance(repair.scale, float):
            logs = [with_scale(r, repair.signal, repair.scale) for r in logs]
    turned = degrees(robot, logs)
    if turned or dead:
        # Nothing more is known of an arm without one of its angles.
        return faults + dead + carried(turned, speeds, logs)
    return faults + _of_the_arm(robot, logs, speeds)


def _of_the_arm(
    robot: Robot,
    logs: Sequence[Recording],
    speeds: Sequence[Fault],
) -> list[Fault]:
    """What the file, the motion and its physics say; the first that is certain wins.

    Physics is the same all along a log: of long ones seven minutes are looked at.
    """
    body = (_units(robot), _gravity(robot), _inertias(robot))
    faults, whole = [fault for fault in body if fault], logs
    logs = sketch_of(logs)
    motion = thin_rows(logs)
    faults += enough(logs, motion)
    if motion is None or any(fault.certain for fault in faults):
        return [*faults, *speeds]
    columns, reading = misread(robot, motion)
    slipped, mounted = slips(robot, motion), None
    given = as_given(robot.dof)
    # A reading that is not worth a word is none, and another arm's is no reading.
    counts = any(fault.kind != WRONG for fault in columns)
    read = _nats(robot, motion, reading if counts else given)
    second = -np.inf
    if reading.angle_unit == 1.0:
        mounted = mounting(robot, motion)
    gone = mounted and mounted.fault.kind == REMOVED and not mounted.fault.certain
    if gone and (
        other_time(robot, motion) or zero_explains(robot, motion, logs, given)
    ):
        mounted = None  # another time or zero says more than a weight that may be gone
    if mounted:
        # The rest is asked of the arm as it is mounted.
        also, then = misread(mounted.robot, motion)
        # Of a load the weight is there where the arm's was taken out.
        alike = mounted.nats if mounted.fault.kind != MOUNTING else -np.inf
        second = max(_nats(mounted.robot, motion, then), alike) - CHECK.odds
    rivals = ((read, columns), (second, [mounted.fault] if mounted else []))
    if slipped and all(_beats(slipped, *rival) for rival in rivals):
        columns, robot = list(slipped.faults), slipped.robot
        inclined = mounting(robot, slipped.motion)
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
    if columns and zero_explains(robot, motion, logs, reading):
        return [*faults, *filtered(logs), *speeds, *out_of_range(robot, whole)]
    computed = commanded(robot, logs)
    fits = not columns
    columns += computed or filtered(logs)
    if fits:
        columns += common_factor(robot, motion)
    mended = any(fault.certain for fault in (*columns, *speeds))
    faults += carried(columns, speeds, logs)
    if mended:
        return faults
    return faults + excursions(robot, whole) + out_of_range(robot, whole)


def _beats(slipped: Slips, nats: float, faults: Sequence[Fault]) -> bool:
    """Whether slips win against faults; no absolute is said of what a pair explains."""
    sure = {fault.kind for fault in slipped.faults if fault.certain}
    if any(fault.kind == REMOVED and fault.certain for fault in faults) and not sure:
        return False
    absolute = any(fault.kind in (WRONG, REMOVED) for fault in faults)
    surer = any(fault.kind in sure and not fault.certain for fault in faults)
    return not faults or surer or (slipped.pair and absolute) or slipped.nats >= nats


def _of_columns(robot: Robot, motion: Motion, columns: list[Fault]) -> list[Fault]:
    """What single readings of the columns say, else the clock, else the arm."""
    if not any(fault.certain for fault in columns):
        columns = joints_exchanged(robot, motion) or columns
    if any(fault.kind == "gear_ratio" and not fault.repairs for fault in columns):
        shares = shares_of(robot, motion)
        factors = torque_factors(shares)
        columns = columns if factors is None else [unit_fault(robot, factors, shares)]
    return columns or other_time(robot, motion) or wrong_robot(robot, motion)


def _nats(robot: Robot, motion: Motion, reading: Reading) -> float:
    """Log evidence of one body under other columns than those given, less the odds."""
    nats = nats_of(robot, read_by(robot, motion, reading))
    # As likely as the log itself, in the unit that it is in.
    rows = motion.spread * motion.moving.sum()
    return nats + float(rows * np.log(reading.torque_unit)) - odds_of(reading)


def carried(
    faults: Sequence[Fault], speeds: Sequence[Fault], logs: Sequence[Recording]
) -> list[Fault]:
    """Carry repairs of angles to velocities and references, and join both checks.

    A velocity that runs against an angle is no fault of the velocity where it is the
    angle that counts backwards.
    """
    with_speed = any(r.qd is not None for r in logs)
    off = [(f, r) for f in speeds for r in f.repairs]
    turned = {j for f, r in off if f.kind == _VELOCITY and r.sign for j in r.joints}
    order = next((r.order for _, r in off if r.order is not None), None)
    explained: set[Fault] = set()
    out = []
    for fault in faults:
        more = []
        for repair in (r for r in fault.repairs if r.signal == "q" and with_speed):
            own, settled = _for_velocity(repair, turned, order)
            more += own
            # Of the nature of a velocity's fault, the angle's repair settles it.
            nature = repair.order is None, repair.sign is None
            if settled:
                explained |= {
                    f
                    for f, r in off
                    if f.kind == _VELOCITY
                    and (r.order is None, r.sign is None) == nature
                }
        out.append(replace(fault, repairs=(*fault.repairs, *more)))
    left = [fault for fault in speeds if fault not in explained]
    return _with_references(out, logs) + left


def _for_velocity(
    repair: Repair, turned: set[int], order: tuple[int, ...] | None
) -> tuple[list[Repair], bool]:
    """Repairs of the velocity, and whether they replace those that were found."""
    if repair.order is not None:
        found = order or tuple(range(1, len(repair.order) + 1))
        wanted = tuple(found[i - 1] for i in repair.order)
        same = wanted == tuple(sorted(wanted))
        return [] if same else [Repair("qd", order=wanted)], order is not None
    if repair.sign is not None:
        joints = tuple(j for j in repair.joints if j not in turned)
        more = [Repair("qd", joints, sign=(-1,) * len(joints))] if joints else []
        return more, turned <= set(repair.joints)
    return [replace(repair, signal="qd")], False


def _with_references(faults: Sequence[Fault], logs: Sequence[Recording]) -> list[Fault]:
    """Mend references with their angles, where they are logged alike, all channels."""
    both = [r for r in logs if r.q_ref is not None]
    if not both:
        return list(faults)
    away = np.max([np.median(np.abs(r.q - r.q_ref), axis=0) for r in both], axis=0)
    travel = np.max([np.ptp(r.q, axis=0) for r in both])
    if np.any(away > CHECK.reference_same * travel):
        return list(faults)
    out = []
    for fault in faults:
        own = [replace(r, signal="q_ref") for r in fault.repairs if r.signal == "q"]
        out.append(replace(fault, repairs=(*fault.repairs, *own)))
    return out


def _units(robot: Robot) -> Fault | None:
    bodies = list(robot.model.inertias)[1:]
    mass, reach = sum(b.mass for b in bodies), joints_length(robot.model)
    density = mass / max(reach, 1e-6) ** 3
    what = f"The arm weighs {mass:.4g} kg and reaches {reach:.4g} m"
    units = (
        (reach > CHECK.longest, "lengths", "millimetres", 1e-3),
        (density > CHECK.densest and reach > 0.05, "masses", "grams", 1e-3),
        (reach < 0.01 and mass > 1, "lengths", "kilometres", 1e3),
        (density < CHECK.thinnest, "masses", "tonnes", 1e3),
    )
    for there, sizes, unit, scale in units:
        if there:
            words = f"{what}: its {sizes} look like {unit}."
            repairs = (Repair("robot", scale=scale),)
            return Fault("robot_file", (), True, words, repairs)
    return None


def _gravity(robot: Robot) -> Fault | None:
    size = float(np.linalg.norm(robot.model.gravity.linear))
    if size == 0 or CHECK.earth[0] < size < CHECK.earth[1]:
        return None
    certain = size > CHECK.largest_gravity
    words = f"Gravity is {size:.4g} m/s^2 in the robot file, expected 9.81."
    return Fault("robot_file", (), certain, words)


def _inertias(robot: Robot) -> Fault | None:
    """Bodies whose moments no mass can have; with none at all they are left alone."""
    reach, impossible, doubtful, words = joints_length(robot.model), [], [], []
    for joint, body in enumerate(list(robot.model.inertias)[1:], start=1):
        moments = np.linalg.eigvalsh(body.inertia)
        largest = float(np.abs(moments).max())
        radius = np.sqrt(largest / max(body.mass, 1e-9))
        if body.mass < 0 or moments[0] < -CHECK.negative * largest:
            impossible.append(joint)
            words.append(f"link {joint} has a moment of {moments[0]:.3g} kg m^2")
        elif body.mass > 1e-3 and largest == 0:
            doubtful.append(joint)
            words.append(f"link {joint} has {body.mass:.3g} kg and no moment")
        elif body.mass > 1e-3 and radius > CHECK.widest * max(reach, 0.1):
            impossible.append(joint)
            words.append(f"the mass of link {joint} is spread over {radius:.3g} m")
        elif moments[2] - moments[0] - moments[1] > CHECK.triangle * largest:
            doubtful.append(joint)
            words.append(f"link {joint} has moments {listed(moments, '.3g')} kg m^2")
    if not words:
        return None
    joints = tuple(sorted(impossible + doubtful))
    evidence = f"No body is like that: {'; '.join(words)}."
    return Fault("robot_file", joints, bool(impossible), evidence)


def enough(recordings: Sequence[Recording], motion: Motion | None) -> list[Fault]:
    """Find logs that are too short, and joints that do not move on their own."""
    seconds = sum(r.duration for r in recordings)
    out = []
    if seconds < CHECK.shortest:
        words = (
            f"The logs last {seconds:.3g} s together; below {CHECK.shortest:g} s the "
            "motion does not tell friction, weight and inertia apart."
        )
        out.append(Fault("too_short", (), False, words))
    out += _one_way(recordings)
    if motion is not None:
        out += _lockstep(motion)
    return out


def _one_way(recordings: Sequence[Recording]) -> list[Fault]:
    """Joints that go one way only, apart from what their noise does."""
    forth, back = np.zeros((2, recordings[0].dof))
    for recording in recordings:
        step = max(1, len(recording.t) // 200)
        change = np.diff(recording.q[::step], axis=0)
        forth += np.maximum(change, 0).sum(axis=0)
        back += np.maximum(-change, 0).sum(axis=0)
    path = forth + back
    one_way = (np.minimum(forth, back) < CHECK.one_way * path) & (path > CHECK.travel)
    joints = joints_of(one_way)
    if not joints:
        return []
    words = (
        f"Joints {listed(joints)} never reverse: dry friction and a constant torque "
        "cannot be told apart there."
    )
    return [Fault("no_reversal", joints, False, words)]


def _lockstep(motion: Motion) -> list[Fault]:
    qd = motion.qd[motion.moving.any(axis=1)]
    moves = np.flatnonzero(np.ptp(motion.q, axis=0) > CHECK.travel)
    if len(moves) < 2 or len(qd) < 10:
        return []
    unit = qd[:, moves] / np.maximum(np.linalg.norm(qd[:, moves], axis=0), 1e-12)
    related = np.abs(unit.T @ unit) - np.eye(len(moves))
    tied = (related > CHECK.together).any(axis=0)
    if not tied.any():
        return []
    joints = tuple(int(j) + 1 for j in moves[tied])
    words = (
        f"The speeds of joints {listed(joints)} are proportional (correlation "
        f"{related.max():.4f}): what belongs to which of them cannot be told."
    )
    return [Fault("lockstep", joints, False, words)]
