"""Watched runs and nulls: alarms, and what they mean."""

from collections.abc import Mapping
from pathlib import Path

from flows.report.document import Table
from flows.report.words.phrases import many
from flows.steps.monitor import Watched
from flows.steps.null import CalibratedNull
from residual.evidence.rules import RULES
from residual.recording import Recording
from warehouse.mirror import shown


def meaning(found: Watched) -> str:
    """Return what was found in watched runs, in one sentence."""
    alarms = [alarm for each in found.alarms.values() for alarm in each]
    where = f"{found.seconds:.4g} s of {many(len(found.alarms), 'run')}"
    basis = (
        f"limits from {many(len(found.calibration), 'healthy run')} of "
        f"{60 * found.monitor.hours:.3g} min, false alarms at most "
        f"{found.monitor.per_hour:g} an hour"
    )
    if not alarms:
        return f"No alarm in {where}: every sensor is as in the healthy runs ({basis})."
    joints = sorted({(a.sensor, a.joint) for a in alarms})
    which = ", ".join(f"{sensor} of joint {joint}" for sensor, joint in joints)
    return f"{many(len(alarms), 'alarm')} in {where}: {which} ({basis})."


def alarm_table(found: Watched, watched: Mapping[str, Recording]) -> Table:
    """Return the alarms, one a row."""
    rows = [
        (
            id[:8],
            f"{alarm.time - watched[id].t[0]:.3f}",
            str(alarm.joint),
            alarm.sensor,
            alarm.fault,
            f"{alarm.score:.3g}x",
        )
        for id, alarms in found.alarms.items()
        for alarm in alarms
    ]
    heads = ("run", "since start [s]", "joint", "sensor", "fault", "over limit")
    return Table(heads, rows, left=(0, 3, 4))


def null_lines(made: CalibratedNull, draws: int, store: Path) -> list[str]:
    """Return what a null says, a sentence each."""
    null, least = made.null, RULES.threshold
    threshold = null.threshold(least)
    beyond = null.beyond(threshold)
    chance = f"{100 * beyond:.2g} %" if beyond > 1e-4 else "less than 0.01 %"
    lines = [
        null.sentence(least),
        f"an exponential tail, fitted to the largest fifth, has {chance} of such "
        f"recordings reach {threshold:.1f} nats: an extrapolation",
        f"draws: {len(null.net)} in {len(set(null.block))} recordings of encoder noise "
        f"(worth {null.independent:.0f} independent ones), {made.known} known "
        "before",
        f"stored in {shown(store)}: modelgap show {null.id}",
    ]
    if not made.complete:
        lines.append(
            f"interrupted: {len(null.net)} of {draws} draws are kept; the same command "
            "goes on"
        )
    return lines
