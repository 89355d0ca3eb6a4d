"""Pictures as PNG files: the scores of watched runs, and a planned motion."""

import io
from collections.abc import Mapping, Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from flows.report.figures.look import JOINTS
from flows.report.figures.paper import SOFT, blank, figure_style, rule
from flows.steps.monitor import Watched
from residual.monitoring.monitor import Alarm
from residual.recording import Recording
from residual.robot.robot import Robot
from sim.records import Reference
from sim.trajectories.limits import largest_torque

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


_MOST = 4000  # samples drawn


def motion_png(robot: Robot, reference: Reference) -> bytes:
    """Return curves of a motion as PNG: angles, and shares of the limits."""
    step = max(1, len(reference.t) // _MOST)
    t, q, qd, qdd = (
        values[::step]
        for values in (reference.t, reference.q, reference.qd, reference.qdd)
    )
    torque = largest_torque(robot, q, qd, qdd)
    rows = (
        ("angle [deg]", np.degrees(q), None),
        ("speed", qd, robot.velocity_limit),
        ("acceleration", qdd, robot.acceleration_limit),
        ("torque (nominal)", torque, robot.torque_limit),
    )
    with figure_style():
        figure = blank(9.0, 8.4)
        panels = figure.subplots(len(rows), 1, sharex=True)
        for panel, (name, values, limit) in zip(panels, rows, strict=True):
            _curves(panel, t, values, limit, name)
        panels[0].set_title(f"{reference.kind} motion of {robot.name}", loc="left")
        panels[0].legend(
            ncols=robot.dof, loc="lower right", bbox_to_anchor=(1, 1), fontsize=8
        )
        panels[-1].set_xlabel("time [s]")
        figure.subplots_adjust(0.115, 0.06, 0.98, 0.95, hspace=0.16)
        figure.align_ylabels(panels)
        out = io.BytesIO()
        figure.savefig(out, format="png", dpi=110, metadata={"Software": None})
    return out.getvalue()


def _curves(
    panel: Axes, t: np.ndarray, values: np.ndarray, limit: np.ndarray | None, name: str
) -> None:
    """Draw one line per joint, in shares of its limit where all have one."""
    known = limit is not None and bool((np.isfinite(limit) & (limit > 0)).all())
    units = {"speed": "rad/s", "acceleration": "rad/s²"}
    if known:
        values = 100 * values / limit
        name = f"{name}\n[% of limit]"
        for bound in (100, -100) if values.min() < 0 else (100,):
            panel.axhline(bound, color=SOFT, linewidth=1.0, linestyle=(0, (4, 3)))
    elif "[" not in name:
        name = f"{name} [{units.get(name, 'N m')}]"
    for joint, column in enumerate(values.T):
        colour = JOINTS[joint % len(JOINTS)]
        panel.plot(t, column, color=colour, linewidth=1.3, label=f"J{joint + 1}")
    panel.set_ylabel(name)
    panel.margins(x=0)
    rule(panel)
