"""A planned motion in the terminal: what it uses of the limits, how well it excites."""

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.table import Table

from residual.robot.robot import Robot
from sim.records import Reference, TrajectorySpec
from sim.trajectories.excitation import Usage

_NEAR = 0.95  # of a limit, shown in bold


def about_motion(
    robot: Robot, reference: Reference, wanted: TrajectorySpec, rate: float
) -> list[str]:
    """Return what motion it is, a sentence each.

    Args:
        rate: Samples per second [Hz].
    """
    spec, still = wanted, (reference.qd == 0).all(axis=1).mean()
    period = f", period {reference.period:g} s" if reference.period else ""
    return [
        f"{spec.kind} motion of {robot.name}: {spec.duration:g} s at "
        f"{rate:g} Hz{period}, seed {spec.seed}"
        + (f", at rest {100 * still:.0f} % of the time" if still > 0.01 else ""),
        "limits, floor and self-collision (arm as capsules) checked between samples "
        "too",
    ]


def usage_table(used: Usage) -> Table:
    """Return the share of each limit that a motion uses, a joint a row."""
    table = Table(
        box=SIMPLE_HEAD, pad_edge=False, title="share of limits", title_justify="left"
    )
    for name in ("joint", "range", "speed", "acceleration", "torque"):
        table.add_column(name, justify="right")
    columns = (used.range, used.speed, used.acceleration, used.torque)
    for joint, row in enumerate(zip(*columns, strict=True), start=1):
        table.add_row(str(joint), *(_percent(share) for share in row))
    return table


def _percent(share: float) -> str:
    if np.isnan(share):
        return "no limit"
    text = f"{100 * share:.0f} %"
    return f"[bold]{text}[/bold]" if share > _NEAR else text


def excitation(used: Usage) -> str:
    """Return in a sentence how well a motion excites the parameters."""
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
