"""Check logs before any modeling: their faults, each with the line that fixes it."""

import re
from collections.abc import Sequence
from dataclasses import replace

from flows.inputs.read import LogSets, load_command_robot
from flows.inputs.repair import (
    describe_repair_file,
    format_drafted_map,
    format_gravity_line,
    format_repair_lines,
)
from flows.requests import Check
from residual import one_blas_thread
from residual.check.check import check_logs, check_robot, confirm_repairs, list_odd_logs
from residual.check.result import INTERLEAVED, MOUNTING, Fault, LogCheck
from residual.errors import InputError
from residual.recording import Recording
from residual.robot.robot import Robot, replace_gravity
from warehouse.logs.log_window import split_log_spec
from warehouse.logs.map_draft import draft_column_map

_REMEDY = re.compile(r"[.?!] (Check|Cut|Give|Leave|Log|Record) ")


def draft_map(log: str, word: str, format: str | None) -> str:
    """Return the text of a map for a log, drafted from its header and numbers.

    Args:
        word: The robot.
        format: Format of the log; None where it is to be recognized.
    """
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
    # One thread: the products are small, two threads only wait for each other.
    for group in ((*logs.fit, *logs.held_out), logs.baseline):
        faults += _faults(logs, group) if group else []
    faults = _once(faults)
    # A line stands for the whole signal, so it has all that is certain about it, or all
    # that the likeliest reading has where nothing is, in the order in which it was
    # found: factors are those of joints that are in their places.
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


def refuse_faulty_logs(logs: LogSets, trust_log: bool) -> LogCheck:
    """Check logs before they are used, and refuse those with a certain fault.

    Raises:
        InputError: With the first certain fault and the line that fixes it; in any
            case where nothing can be computed from a log.
    """
    report = check_log_sets(logs)
    fatal = [doubt.words for _, doubt in logs.doubts if doubt.fatal]
    if fatal and (trust_log or not any(fault.repair for fault in report.certain)):
        raise InputError(fatal[0])
    if report.certain and not trust_log:
        raise InputError(_refusal(report))
    return report


def correct_mounting(logs: LogSets, report: LogCheck) -> LogSets:
    """Return logs of the arm as it is mounted, where that is certain."""
    turned = (r.gravity for f in report.certain for r in f.repairs if r.gravity)
    gravity = next(turned, None)
    if gravity is None:
        return logs
    return replace(logs, robot=replace_gravity(logs.robot, gravity))


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
    an effect of the arm. A repair line is of all logs, so here it stands in the
    evidence.
    """
    if len(group) < 2 or pooled.certain:
        return []
    out = []
    for log in list_odd_logs(logs.robot, group):
        # Of one log alone gravity is no more than a guess.
        found = check_logs(logs.robot, [log]).certain
        certain = [fault for fault in found if fault.kind != MOUNTING]
        others = [other for other in group if other is not log]
        repairs = [repair for fault in certain for repair in fault.repairs]
        if repairs and not confirm_repairs(logs.robot, log, others, repairs):
            continue
        for fault in certain:
            lines = format_repair_lines(fault.repairs, logs.robot, logs.columns)
            fix = f" A map for this log alone has {lines}" if lines else ""
            evidence = (
                f"Log {log.id}, not the others: {fault.evidence.rstrip()} Leave this log out.{fix}"
            )
            joints = tuple(map(int, fault.joints))
            out.append(Fault(fault.kind, joints, True, evidence))
    return out


def _faults(logs: LogSets, group: Sequence[Recording]) -> list[Fault]:
    labels = {recording.id for recording in group}
    doubts = [(label, doubt) for label, doubt in logs.doubts if label in labels]
    # Of two arms in one log nothing else is to be said.
    mixed = [(label, doubt) for label, doubt in doubts if doubt.kind == INTERLEAVED]
    if mixed:
        return [Fault(d.kind, d.joints, True, d.words, (), who) for who, d in mixed]
    found = list(check_logs(logs.robot, group).faults)
    # What makes a log unreadable is said in any case, another doubt only if the check
    # has not found what is behind it.
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
    """Return the faults, certain ones first; what several logs have, once."""
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
