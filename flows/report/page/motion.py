"""The curves of one planned motion."""

import io

import numpy as np
from matplotlib.axes import Axes

from flows.report.page.plots import SOFT, blank, figure_style, rule
from residual.robot.robot import Robot
from sim.records import Reference
from sim.trajectories.limits import largest_torque

# Okabe and Ito's palette, dark ones first.
_JOINTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#222222", "#e69f00", "#56b4e9")
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
        colour = _JOINTS[joint % len(_JOINTS)]
        panel.plot(t, column, color=colour, linewidth=1.3, label=f"J{joint + 1}")
    panel.set_ylabel(name)
    panel.margins(x=0)
    rule(panel)
