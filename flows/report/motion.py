"""A planned motion: what it uses of the limits, how well it excites, its curves."""

import io

import numpy as np
from matplotlib.axes import Axes

from flows.report.document import Strong, Table
from flows.report.figures.look import JOINTS
from flows.report.figures.paper import SOFT, blank, figure_style, rule
from residual.robot.robot import Robot
from sim.records import Reference, TrajectorySpec
from sim.trajectories.excitation import Usage
from sim.trajectories.limits import largest_torque

_NEAR = 0.95  # of a limit, which stands out
_MOST = 4000  # samples drawn


def motion_parts(
    robot: Robot, reference: Reference, spec: TrajectorySpec, rate: float, used: Usage
) -> list[str | Table]:
    """Return what motion it is, what it uses of the limits, how well it excites.

    Args:
        rate: Samples per second [Hz].
    """
    still = (reference.qd == 0).all(axis=1).mean()
    period = f", period {reference.period:g} s" if reference.period else ""
    columns = (used.range, used.speed, used.acceleration, used.torque)
    rows = [
        (str(joint), *map(_share, row))
        for joint, row in enumerate(zip(*columns, strict=True), start=1)
    ]
    heads = ("joint", "range", "speed", "acceleration", "torque")
    return [
        f"{spec.kind} motion of {robot.name}: {spec.duration:g} s at "
        f"{rate:g} Hz{period}, seed {spec.seed}"
        + (f", at rest {100 * still:.0f} % of the time" if still > 0.01 else ""),
        "limits, floor and self-collision (arm as capsules) checked between samples "
        "too",
        Table(heads, rows, "share of limits", left=()),
        _excitation(used),
    ]


def _share(share: float) -> str:
    if np.isnan(share):
        return "no limit"
    text = f"{100 * share:.0f} %"
    return Strong(text) if share > _NEAR else text


def _excitation(used: Usage) -> str:
    found = used.excitation
    if np.isinf(found.condition):
        return (
            f"condition number: infinite; this motion alone does not tell all "
            f"{found.parameters} base parameters"
        )
    return (
        f"condition number {found.condition:.3g} (column-normalised regressor of "
        f"{found.parameters} base parameters), log det {found.log_det:.4g}"
    )


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
