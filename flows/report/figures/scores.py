"""The scores of watched runs over time, as a picture."""

import io
from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flows.report.figures.look import JOINTS
from flows.steps.monitor import Watched
from residual.monitoring.monitor import Alarm
from residual.recording import Recording

MOST = 6  # runs in one picture
_FLOOR = 0.02
_SHORT = 8  # digits of an id that people read
_NAMED = 4  # alarms of a run that are named; more are counted
_APART = 0.03  # of the time: nearer ones have their numbers below one another


def plot(found: Watched, runs: Mapping[str, Recording]) -> bytes:
    """Draw the largest score of each kind over its limit, and the alarms.

    Args:
        runs: The watched runs by id; those with alarms come first.
    """
    ids = sorted(runs, key=lambda id: -len(found.alarms[id]))[:MOST]
    figure = Figure(figsize=(9, 0.6 + 2.4 * len(ids)), layout="constrained")
    panels = figure.subplots(len(ids), 1, squeeze=False)[:, 0]
    for axes, id in zip(panels, ids, strict=True):
        start = runs[id].t[0]
        for scores, colour in zip(found.monitor.scores(runs[id]), cycle(JOINTS)):
            worst = scores.values.max(axis=1).clip(_FLOOR)
            style = {"lw": 0.8, "label": scores.kind, "color": colour}
            axes.semilogy(scores.t - start, worst, **style)
        axes.axhline(1.0, color="black", lw=0.8, ls="--")
        texts = _mark(axes, found.alarms[id], start)
        title = f"run {id[:_SHORT]}"
        axes.set_title(title, loc="left", fontsize="medium")
        if texts:
            axes.set_title(texts, loc="right", fontsize="small")
        axes.set_ylabel("score / limit")
    panels[0].legend(ncols=7, fontsize="small", loc="lower right")
    panels[-1].set_xlabel("time since the run began [s]")
    out = io.BytesIO()
    figure.savefig(out, format="png", dpi=110)
    return out.getvalue()


def _mark(axes: Axes, alarms: Sequence[Alarm], start: float) -> str:
    """Draw a numbered line at each alarm; return what the numbers stand for.

    Names beside the lines would lie over one another, and over the curves.
    """
    left, right = axes.get_xlim()
    level, last = 0, -np.inf
    for number, alarm in enumerate(alarms, 1):
        at = alarm.time - start
        axes.axvline(at, color="black", lw=1.0)
        level = level + 1 if at - last < _APART * (right - left) else 0
        last = at
        axes.annotate(
            f" {number}",
            (at, 0.98 - 0.1 * (level % 8)),
            xycoords=("data", "axes fraction"),
            va="top",
            fontsize="small",
            bbox={"facecolor": "white", "edgecolor": "none", "pad": 0.6},
        )
    names = [
        f"{number}: {alarm.fault}, joint {alarm.joint}"
        for number, alarm in enumerate(alarms[:_NAMED], 1)
    ]
    more = len(alarms) - _NAMED
    return "   ".join([*names, *([f"{more} more"] if more > 0 else [])])
