"""Watched runs: alarms, what they mean, and the scores as a picture."""

import io
from collections.abc import Mapping

from matplotlib.figure import Figure

from flows.report.document import Table
from flows.report.figures.look import JOINTS
from flows.report.words.phrases import many
from flows.steps.monitor import MonitoringResult
from residual.recording import Recording

_MOST = 6  # runs in one picture
_LEAST = 0.02  # score that is drawn


def meaning(found: MonitoringResult) -> str:
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


def alarm_table(found: MonitoringResult, watched: Mapping[str, Recording]) -> Table:
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


def plot(found: MonitoringResult, runs: Mapping[str, Recording]) -> bytes:
    """Draw the score of each joint and the alarms, as a PNG.

    Args:
        runs: The watched runs by id; those with alarms come first.
    """
    ids = sorted(runs, key=lambda id: -len(found.alarms[id]))[:_MOST]
    figure = Figure(figsize=(9, 0.6 + 2.4 * len(ids)), layout="constrained")
    panels = figure.subplots(len(ids), 1, squeeze=False)[:, 0]
    for axes, id in zip(panels, ids, strict=True):
        t, scores = found.monitor.scores(runs[id])
        for j, score in enumerate(scores.T):
            style = {"lw": 0.8, "label": f"J{j + 1}", "color": JOINTS[j % len(JOINTS)]}
            axes.semilogy(t - t[0], score.clip(_LEAST), **style)
        axes.axhline(1.0, color="black", lw=0.8, ls="--")
        for alarm in found.alarms[id]:
            axes.axvline(alarm.time - t[0], color="black", lw=1.0)
        axes.set(ylabel="score / limit", title=f"run {id[:8]}")
    panels[0].legend(ncols=7, fontsize="small", loc="lower right")
    panels[-1].set_xlabel("time since the run began [s]")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return out.getvalue()
