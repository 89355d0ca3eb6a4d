"""Check logs before any modeling: their faults, each with the line that fixes it.

A repair refers to joints at the link side, in SI units; a map to columns, units, signs
and scales of a file. Each line is complete: it replaces the one in the map, or is added
to it.
"""

import json
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from flows.inputs import LogSets, load_command_robot
from flows.outputs import describe_repair_file
from flows.requests import Check
from residual import one_blas_thread
from residual.check.check import check_logs, check_robot, confirm_repairs, list_odd_logs
from residual.check.result import INTERLEAVED, MOUNTING, Fault, LogCheck, Repair
from residual.drive import IDEAL, Drive
from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import Robot, replace_gravity
from warehouse.logs.column_map import (
    LOGGED_UNITS,
    TIME_UNITS,
    UNITS,
    ColumnMap,
    SignalMap,
    abbreviate_column_names,
    build_default_signal,
)
from warehouse.logs.log_window import split_log_spec
from warehouse.logs.map_draft import PRESETS, ColumnMapDraft, draft_column_map

_REMEDY = re.compile(r"[.?!] (Check|Cut|Give|Leave|Log|Record) ")


def draft_map(log: str, word: str, format: str | None) -> str:
    """Return the text of a map for a log, drafted from its header and numbers."""
    robot = load_command_robot(word, logs=[log])
    draft = draft_column_map(split_log_spec(log)[0], robot, format)
    return format_drafted_map(draft, log, robot)


def check_robot_file(request: Check) -> tuple[Robot, LogCheck]:
    """Read a robot and check its file alone."""
    robot = load_command_robot(request.robot)
    report = check_robot(robot)
    line = format_gravity_line(robot)
    repair = (line,) if line else ()
    return robot, LogCheck(tuple(replace(f, repair=repair) for f in report.faults))


@one_blas_thread
def check_log_sets(logs: LogSets) -> LogCheck:
    """Check that units, signs, order and timing of logs are consistent.

    Healthy runs are checked separately, so that a fault of one set is not hidden by the
    logs of the other.
    """
    faults: list[Fault] = []
    for group in ((*logs.fit, *logs.held_out), logs.baseline):
        faults += _faults(logs, group) if group else []
    faults = _once(faults)
    # A line replaces the whole signal, so it contains every certain repair of it, or
    # where none is certain those of the likeliest reading, in the order found: factors
    # apply to joints after reordering.
    sure = [fault for fault in faults if fault.certain and fault.repairs]
    read = [r for fault in sure or faults for r in fault.repairs]
    out = []
    for fault in faults:
        signals = {repair.signal for repair in fault.repairs}
        every = [*(r for r in read if r.signal in signals), *fault.repairs]
        ways = [dict.fromkeys(every), *fault.alternatives]
        lines = [format_repair_lines(way, logs.robot, logs.columns) for way in ways]
        if fault.kind == "robot_file" and not any(lines):
            lines = [format_gravity_line(logs.robot)]
        joints, sure = tuple(map(int, fault.joints)), bool(fault.certain)
        known = tuple(dict.fromkeys(line for line in lines if line))
        out.append(replace(fault, joints=joints, certain=sure, log="", repair=known))
    for group in ((*logs.fit, *logs.held_out), logs.baseline):
        out += _faults_of_single_logs(logs, group, LogCheck(tuple(out)))
    return LogCheck(tuple(out))


def refuse_faulty_logs(logs: LogSets, trust_log: bool) -> tuple[LogSets, LogCheck]:
    """Check logs before they are used; return those of the arm as mounted, and the check.

    Raises:
        InputError: With the first certain fault and the line that fixes it; in any
            case if a log cannot be evaluated.
    """
    report = check_log_sets(logs)
    fatal = [doubt.words for _, doubt in logs.doubts if doubt.fatal]
    if fatal and (trust_log or not any(fault.repair for fault in report.certain)):
        raise InputError(fatal[0])
    if report.certain and not trust_log:
        raise InputError(_refusal(report))
    turned = (r.gravity for f in report.certain for r in f.repairs if r.gravity)
    if (gravity := next(turned, None)) is not None:
        logs = replace(logs, robot=replace_gravity(logs.robot, gravity))
    return logs, report


def _refusal(report: LogCheck) -> str:
    # Gravity first, then what a line can fix: the others may follow from it.
    first, *more = sorted(report.certain, key=lambda f: (f.kind != MOUNTING, not f.repair))
    rest = f" {len(more)} more: see modelgap check." if more else ""
    evidence = " ".join(first.evidence.split())
    if first.repair:
        where, line = describe_repair_file(first.repair[0]), first.repair[0]
        mend = f"Fix: add this line ({where}): {' '.join(line.split())} "
    else:
        mend = "" if _REMEDY.search(evidence) else "Record the log again. "
    return (
        f"The logs have a fault ({first.where}): {evidence}{rest}\n"
        f"{mend}To continue anyway: --trust-log (trust_log=True)."
    )


def _faults_of_single_logs(
    logs: LogSets, group: Sequence[Recording], pooled: LogCheck
) -> list[Fault]:
    """Return the certain faults that one log has and the others do not.

    In a sum over all logs the good ones outweigh a bad one, whose fault then looks like
    an effect of the arm. A repair line applies to all logs, so this one is given in the
    evidence.
    """
    if len(group) < 2 or pooled.certain:
        return []
    out = []
    for log in list_odd_logs(logs.robot, group):
        # A single log determines gravity too poorly.
        found = check_logs(logs.robot, [log]).certain
        certain = [fault for fault in found if fault.kind != MOUNTING]
        others = [other for other in group if other is not log]
        repairs = [repair for fault in certain for repair in fault.repairs]
        if repairs and not confirm_repairs(logs.robot, log, others, repairs):
            continue
        for fault in certain:
            lines = format_repair_lines(fault.repairs, logs.robot, logs.columns)
            fix = f" A map for this log alone has {lines}" if lines else ""
            evidence = f"Only in log {log.id}: {fault.evidence.rstrip()} Leave this log out.{fix}"
            joints = tuple(map(int, fault.joints))
            out.append(Fault(fault.kind, joints, True, evidence))
    return out


def _faults(logs: LogSets, group: Sequence[Recording]) -> list[Fault]:
    labels = {recording.id for recording in group}
    doubts = [(label, doubt) for label, doubt in logs.doubts if label in labels]
    # A log of two arms has no other meaningful fault.
    mixed = [(label, doubt) for label, doubt in doubts if doubt.kind == INTERLEAVED]
    if mixed:
        return [Fault(d.kind, d.joints, True, d.words, (), who) for who, d in mixed]
    found = list(check_logs(logs.robot, group).faults)
    # A doubt that makes a log unreadable is always reported, another one only if the
    # check has not found its cause.
    behind = any(fault.certain for fault in found)
    reach = [n for n, fault in enumerate(found) if fault.kind == "out_of_range"]
    for label, doubt in doubts:
        if reach and doubt.kind in ("out_of_range", "angle_unit") and not doubt.fatal:
            found[reach[0]] = replace(found[reach[0]], certain=True)
        elif doubt.fatal or doubt.kind in ("clock", "spike") or not behind:
            sure, words = doubt.certain, doubt.words
            found.append(Fault(doubt.kind, doubt.joints, sure, words, (), label))
    return sorted(found, key=lambda fault: not fault.certain)


def _once(faults: Sequence[Fault]) -> list[Fault]:
    """Return the faults, certain ones first; a fault of several logs once."""
    groups: dict[tuple, list[Fault]] = {}
    for fault in sorted(faults, key=lambda fault: not fault.certain):
        key = (fault.kind, fault.joints, fault.certain)
        groups.setdefault(key, []).append(fault)
    out = []
    for first, *others in groups.values():
        evidence = first.evidence
        if first.log and not evidence.startswith(first.log):
            evidence = f"{first.log}: {evidence}"
        also = [f.log for f in others if f.log != first.log]
        if also and first.log:
            evidence = f"{evidence} The same in {', '.join(dict.fromkeys(also))}."
        out.append(replace(first, evidence=evidence))
    return out


_NO_TIME = '{column = "...", unit = "s"}'
_NO_SIGNAL = '{columns = ["...", "..."], unit = "..."}  # joint 1 first'
_LONGEST = 4000  # letters of a comment
_EARTH = 9.81  # m/s^2
_SAME = 1e-6  # relative: a factor so near to a unit is that unit


def format_repair_lines(repairs: Iterable[Repair], robot: Robot, columns: ColumnMap) -> str | None:
    """Return the TOML lines of some repairs, one per signal; None where no line can do it."""
    by_signal: dict[str, list[Repair]] = {}
    for repair in repairs:
        by_signal.setdefault(repair.signal, []).append(repair)
    lines = [_line(name, each, robot, columns) for name, each in by_signal.items()]
    return None if not lines or None in lines else "\n".join(lines)


def format_gravity_line(robot: Robot) -> str | None:
    """Return the line of robot.toml with gravity in m/s^2; None where it is so."""
    gravity = robot.model.gravity.linear
    size = float(np.linalg.norm(gravity))
    off = _EARTH / size if size else 1.0
    power = round(math.log10(off))
    if power == 0 or not math.isclose(off, 10.0**power, rel_tol=0.02):
        return None
    return _gravity(10.0**power * gravity)


def _gravity(gravity: Iterable[float]) -> str:
    return f"gravity = [{', '.join(f'{g + 0.0:.5g}' for g in gravity)}]"


def _line(name: str, repairs: Sequence[Repair], robot: Robot, columns: ColumnMap) -> str | None:
    if name == "t":
        return format_time_line(math.prod(float(r.scale or 1.0) for r in repairs), columns)
    if name == "robot":
        if any(r.gravcomp is False for r in repairs):
            return "gravcomp = false"
        gravity = next((r.gravity for r in repairs if r.gravity), None)
        return gravity and _gravity(gravity)  # masses and lengths stand in the URDF
    if name == "drive":
        return format_drive_line(repairs[-1].drive)
    signal = columns.signals.get(name) or build_default_signal(name, robot.dof)
    for repair in repairs:
        signal = _mended(name, signal, repair, robot)
        if signal is None:
            return None
    return format_signal_line(name, signal)


def _format_line(name: str, digits: int = 9, **values: object) -> str:
    """Return an inline table of TOML; what is empty is left out."""
    words = [f"{key} = {_toml(value, digits)}" for key, value in values.items() if value]
    return f"{name} = {{{', '.join(words)}}}"


def _toml(value: object, digits: int) -> str:
    """Return a value as TOML has it, numbers without digits that are only rounding."""
    if isinstance(value, str):
        return escape_unprintable(json.dumps(value, ensure_ascii=False))
    if isinstance(value, Sequence):
        return f"[{', '.join(_toml(each, digits) for each in value)}]"
    return "true" if value is True else f"{value:.{digits}g}"


def format_drive_line(drive: Drive) -> str:
    """Return the line of a map for the drive: how torque follows from the goal."""
    parts = {name: getattr(drive, name) for name in (*IDEAL, "enabled")}
    return _format_line("drive", 4, **parts)


def format_time_line(scale: float, columns: ColumnMap) -> str:
    """Return the line of a map that says what time is, that of the map times a scale."""
    whole = scale * TIME_UNITS[columns.time_unit] * columns.time_scale
    unit = next((u for u, f in TIME_UNITS.items() if math.isclose(whole, f, rel_tol=_SAME)), None)
    return _format_line(
        "time",
        column=columns.time,
        nanoseconds=columns.nanoseconds,
        scale=whole if unit is None else None,
        unit=unit if unit != "s" else None,
    )


def _mended(name: str, signal: SignalMap, repair: Repair, robot: Robot) -> SignalMap | None:
    """Return the entries of a signal that repair it at the link side."""
    dof = robot.dof
    sign, scale = _each(repair.sign, repair, dof), _each(repair.scale, repair, dof)
    order = [i - 1 for i in _order(repair, dof)]
    gears = _gears(name, signal, robot)
    factor = np.array(sign) * np.array(scale)
    if gears is None:
        # Coupled motors: only a factor common to all joints passes through.
        if order != list(range(dof)) or np.ptp(factor) > 0:
            return None
        gears = np.ones(dof)
    own = np.array(signal.sign or (1,) * dof) * np.array(signal.scale or (1,) * dof)
    whole = own[order] * factor * gears[order] / gears
    unit, scales = _unit(name, signal.unit, np.abs(whole))
    zero = [signal.zero[i] for i in order] if signal.zero else []
    own_zero = np.zeros(dof) if not any(zero) else np.array(zero)
    if repair.zero is not None:  # as it is logged, in the unit of the columns
        joints = [j - 1 for j in repair.joints]
        per_reading = (whole / gears * UNITS[name][signal.unit])[joints]
        if name == "tau" or signal.side != "link":
            return None
        own_zero[joints] += np.array(repair.zero) / per_reading
    zero = tuple(own_zero.tolist())
    return replace(
        signal,
        columns=tuple(signal.columns[i] for i in order),
        unit=unit,
        sign=tuple(np.sign(whole).tolist()) if (whole < 0).any() else (),
        zero=zero if any(zero) else (),
        scale=scales,
        unwrap=signal.unwrap or repair.unwrap,
    )


def _order(repair: Repair, dof: int) -> Sequence[int]:
    own = list(range(1, dof + 1))
    if repair.order is None or len(repair.order) == dof:
        return own if repair.order is None else repair.order
    for joint, channel in zip(repair.joints, repair.order, strict=True):
        own[joint - 1] = channel
    return own


def _each(given: Sequence | float | None, repair: Repair, dof: int) -> list[float]:
    """Return a factor for every joint: one for all, or that of the repair's joints."""
    joints = repair.joints or tuple(range(1, dof + 1))
    if not isinstance(given, Sequence):
        given = (1.0 if given is None else given,) * len(joints)
    if len(given) == dof:
        return [float(x) for x in given]
    out = [1.0] * dof
    for joint, value in zip(joints, given, strict=True):
        out[joint - 1] = float(value)
    return out


def _gears(name: str, signal: SignalMap, robot: Robot) -> np.ndarray | None:
    """Return the factor from motor to joint, joint by joint; None if coupled."""
    ones = np.ones(robot.dof)
    logged = name == "tau" and signal.unit in LOGGED_UNITS
    per_unit = robot.torque_per_unit if logged else ones
    if signal.side == "link":
        return per_unit
    if robot.motor_from_joint is not None:
        return None
    if logged:
        return per_unit
    return robot.gear_ratio if name == "tau" else 1 / robot.gear_ratio


def _unit(name: str, unit: str, scale: np.ndarray) -> tuple[str, tuple[float, ...]]:
    """Return unit and scale of a signal; another unit where that suffices."""
    if unit in LOGGED_UNITS or np.allclose(scale, 1, _SAME, 0):
        return unit, () if np.allclose(scale, 1, _SAME, 0) else tuple(scale.tolist())
    whole = scale * UNITS[name][unit]
    for other, factor in UNITS[name].items():
        if other not in LOGGED_UNITS and np.allclose(whole, factor, _SAME, 0):
            return other, ()
    return unit, tuple(scale.tolist())


def format_signal_line(name: str, signal: SignalMap) -> str:
    """Return the line of a map for a signal."""
    return _format_line(
        name,
        columns=signal.columns,
        unit=signal.unit if signal.unit != next(iter(UNITS[name])) else None,
        side=signal.side if signal.side != "link" else None,
        sign=signal.sign,
        zero=signal.zero,
        scale=signal.scale,
        unwrap=signal.unwrap,
    )


def format_drafted_map(draft: ColumnMapDraft, log: str, robot: Robot) -> str:
    """Return the text of a drafted map, uncertain entries as comments."""
    columns, format = draft.columns, draft.format
    about = f" Format: {PRESETS[format].about}." if format else ""
    where = escape_unprintable(Path(log).name)
    lines = [
        f"# Drafted by modelgap map from {where} for {robot.name}.{about}",
        "# Nothing was applied. Lines marked with a question mark are guesses: confirm them.",
    ]

    def line(name: str, text: str) -> None:
        doubts = draft.doubts.get(name, ())
        lines.extend(f"# ? {name}: {escape_unprintable(words)}" for words in doubts)
        lines.append(text)

    if columns.csv.decimal != ".":
        line("csv", _format_line("csv", decimal=columns.csv.decimal))
    if format == "ros" and not columns.signals:
        bag = _format_line("bag", topic=columns.bag.topic, joints=columns.bag.joints)
        line("bag", "# This bag needs no map." if bag == "bag = {}" else bag)
        return "\n".join([*lines, ""])
    if "time" not in draft.missing:
        line("time", format_time_line(1.0, columns))
    for name, signal in columns.signals.items():
        line(name, format_signal_line(name, signal))
    if columns.drive is not None:
        line("drive", format_drive_line(columns.drive))
    for name in draft.missing:
        line(name, f"# {name} = {_NO_TIME if name == 'time' else _NO_SIGNAL}")
    for name, signal in draft.optional.items():
        line(name, f"# {format_signal_line(name, signal)}  # not needed")
    rest = escape_unprintable(abbreviate_column_names(draft.unread))[:_LONGEST]
    lines += [f"# not read: {rest}"] if draft.unread else []
    return "\n".join([*lines, ""])


def escape_unprintable(text: str) -> str:
    """Return a text in one line, unprintable characters escaped as in TOML."""
    return "".join(
        c if c.isprintable() else f"\\U{ord(c):08x}" if c > "\uffff" else f"\\u{ord(c):04x}"
        for c in text
    )
