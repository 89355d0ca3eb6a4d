"""The scores of watched runs over time, as a picture."""

import io
from collections.abc import Mapping

from matplotlib.figure import Figure

from flows.steps.monitor import Watched
from residual.recording import Recording

MOST = 6  # runs in one picture
_FLOOR = 0.02


def plot(found: Watched, runs: Mapping[str, Recording]) -> bytes:
    """Draw the largest score of each kind over its limit, and the alarms.

    Args:
        found: What was found.
        runs: The watched runs by id; those with alarms come first.

    Returns:
        A PNG.
    """
    ids = sorted(runs, key=lambda id: -len(found.alarms[id]))[:MOST]
    figure = Figure(figsize=(9, 0.6 + 2.2 * len(ids)), layout="constrained")
    panels = figure.subplots(len(ids), 1, squeeze=False)[:, 0]
    for axes, id in zip(panels, ids, strict=True):
        start = runs[id].t[0]
        for scores in found.monitor.scores(runs[id]):
            worst = scores.values.max(axis=1).clip(_FLOOR)
            axes.semilogy(scores.t - start, worst, lw=0.8, label=scores.kind)
        axes.axhline(1.0, color="black", lw=0.8, ls="--")
        for alarm in found.alarms[id]:
            axes.axvline(alarm.time - start, color="black", lw=1.0)
            text = f"{alarm.fault}, joint {alarm.joint}"
            place = (alarm.time - start, 1.0)
            where = {"xycoords": ("data", "axes fraction"), "va": "top", "ha": "right"}
            axes.annotate(text + " ", place, **where)
        axes.set_title(f"run {id}", loc="left", fontsize="medium")
        axes.set_ylabel("score / limit")
    panels[0].legend(ncols=7, fontsize="small", loc="lower left")
    panels[-1].set_xlabel("time since the run began [s]")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return out.getvalue()
