"""Monitored runs: their alarms, in words, as a table and as a picture."""

from collections.abc import Mapping

from flows.report.document import ReportTable
from flows.report.phrases import count_noun
from flows.report.plots import Panel, png
from flows.steps.monitor import MonitoringResult
from residual.recording import Recording

_MOST = 6  # runs in one picture
_LEAST = 0.02  # smallest score drawn


def meaning(result: MonitoringResult) -> str:
    """Return the alarms of monitored runs in one sentence."""
    alarms = [alarm for each in result.alarms.values() for alarm in each]
    where = f"{result.seconds:.4g} s of {count_noun(len(result.alarms), 'run')}"
    basis = (
        f"limits from {count_noun(len(result.calibration), 'healthy run')} of "
        f"{60 * result.monitor.hours:.3g} min, at most {result.monitor.per_hour:g} "
        "false alarms an hour"
    )
    if not alarms:
        return f"No alarm in {where} ({basis})."
    joints = sorted({(a.sensor, a.joint) for a in alarms})
    sensors = ", ".join(f"{sensor} of joint {joint}" for sensor, joint in joints)
    return f"{count_noun(len(alarms), 'alarm')} in {where}: {sensors} ({basis})."


def alarm_table(
    result: MonitoringResult, watched: Mapping[str, Recording]
) -> ReportTable:
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
        for id, alarms in result.alarms.items()
        for alarm in alarms
    ]
    heads = ("run", "since start [s]", "joint", "sensor", "fault", "over limit")
    return ReportTable(heads, rows, text_columns=(0, 3, 4))


def plot(result: MonitoringResult, runs: Mapping[str, Recording]) -> bytes:
    """Return the score of each joint and the alarms as PNG.

    Args:
        runs: The watched runs by id; those with alarms come first.
    """
    panels = []
    for id in sorted(runs, key=lambda id: -len(result.alarms[id]))[:_MOST]:
        t, scores = result.monitor.scores(runs[id])
        marks = [alarm.time - t[0] for alarm in result.alarms[id]]
        values = scores.clip(_LEAST)
        title = f"run {id[:8]}"
        panel = Panel(t - t[0], values, "score / limit", title, (1.0,), marks, log=True)
        panels.append(panel)
    return png(panels, 2.4, "time since the start of the run [s]")
