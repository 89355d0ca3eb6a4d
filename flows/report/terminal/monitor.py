"""Watched runs in the terminal: alarms, and what they mean."""

from collections.abc import Mapping

from rich.box import SIMPLE_HEAD
from rich.table import Table

from flows.steps.monitor import Watched
from residual.recording import Recording


def meaning(found: Watched) -> str:
    """Return what was found, in one sentence."""
    alarms = [alarm for each in found.alarms.values() for alarm in each]
    count, runs = len(alarms), len(found.alarms)
    where = f"{found.seconds:.4g} s of {_many(runs, 'run')}"
    basis = (
        f"limits from {_many(len(found.calibration), 'healthy run')} of "
        f"{60 * found.monitor.hours:.3g} min, false alarms at most "
        f"{found.monitor.per_hour:g} an hour"
    )
    if count == 0:
        return f"No alarm in {where}: every sensor is as in the healthy runs ({basis})."
    joints = sorted({(a.sensor, a.joint) for a in alarms})
    which = ", ".join(f"{sensor} of joint {joint}" for sensor, joint in joints)
    return f"{_many(count, 'alarm')} in {where}: {which} ({basis})."


def _many(count: int, word: str) -> str:
    return f"{count} {word}" if count == 1 else f"{count} {word}s"


def alarm_table(found: Watched, watched: Mapping[str, Recording]) -> Table:
    """Return the alarms, one a row.

    Args:
        watched: The watched runs by id.
    """
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    for title in ("run", "since start \\[s]", "joint", "sensor", "fault", "over limit"):
        numbers = title not in ("run", "sensor", "fault")
        table.add_column(title, justify="right" if numbers else "left")
    for id, alarms in found.alarms.items():
        for alarm in alarms:
            since = alarm.time - watched[id].t[0]
            words = (f"{since:.3f}", str(alarm.joint), alarm.sensor, alarm.fault)
            table.add_row(id[:8], *words, f"{alarm.score:.3g}x")
    return table
