"""Watched runs: alarms, and what they mean."""

from collections.abc import Mapping

from flows.report.document import Table
from flows.report.words.phrases import many
from flows.steps.monitor import Watched
from residual.recording import Recording


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
