"""A motion planned, shown, and written for a real controller."""

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table

from flows.inputs.robots import load
from flows.outputs import check_writable, write_all
from flows.say import say
from residual.robot.robot import Robot
from sim.records import Reference, TrajectorySpec
from sim.trajectories import make_reference
from sim.trajectories.usage import Usage, usage

_NEAR = 0.95  # of a limit, shown in bold


@dataclass(frozen=True, slots=True)
class Wanted:
    """A motion and the files to make of it.

    Attributes:
        spec: The motion.
        robot: Built-in name, URDF file or folder.
        rate: Samples per second [Hz].
        csv: File for the samples, or None.
        plot: PNG file for curves, or None.
        gif: GIF file of the arm, or None.
    """

    spec: TrajectorySpec
    robot: str
    rate: float
    csv: str | None = None
    plot: str | None = None
    gif: str | None = None

    @property
    def files(self) -> dict[str, Path]:
        """Files to write, by option."""
        named = {"--csv": self.csv, "--plot": self.plot, "--gif": self.gif}
        return {k: Path(v) for k, v in named.items() if v is not None}


def preview(wanted: Wanted, console: Console) -> Reference:
    """Plan a motion, print what it uses of the limits, and write the files.

    Args:
        wanted: The motion and the files.
        console: Where people read.

    Returns:
        The motion.

    Raises:
        InputError: If the motion is not possible or a file not writable.
        OSError: If a file cannot be written.
    """
    check_writable(wanted.files, [Path(wanted.robot)])
    robot = load(wanted.robot)
    reference = make_reference(robot, wanted.spec, wanted.rate)
    contents: dict[Path, str | bytes] = {}
    if wanted.csv:
        contents[Path(wanted.csv)] = as_csv(reference)
    if wanted.plot:
        from flows.report.page.motion import motion_png

        contents[Path(wanted.plot)] = motion_png(robot, reference)
    if wanted.gif:
        # Late: the engine is a slow import.
        from sim.engine.render import animate

        contents[Path(wanted.gif)] = animate(robot, reference)
    # Before anything is printed, which may go into a pipe that closes.
    write_all(contents)
    say(console, *_summary(robot, reference, wanted))
    used = usage(robot, reference)
    console.print(_table(used))
    say(console, _excited(used))
    for path in contents:
        say(console, f"wrote {path}")
    return reference


def as_csv(reference: Reference) -> str:
    """Return t [s], q1.. [rad], qd1.. [rad/s] and qdd1.. [rad/s^2] as CSV text."""
    joints = range(1, reference.q.shape[1] + 1)
    names = [f"{name}{joint}" for name in ("q", "qd", "qdd") for joint in joints]
    parts = [reference.t[:, None], reference.q, reference.qd, reference.qdd]
    text = io.StringIO()
    np.savetxt(
        text,
        np.hstack(parts).round(9) + 0.0,  # + 0 makes of -0 a 0
        fmt="%.9f",
        delimiter=",",
        header=",".join(["t", *names]),
        comments="",
    )
    return text.getvalue()


def _summary(robot: Robot, reference: Reference, wanted: Wanted) -> list[str]:
    spec, still = wanted.spec, (reference.qd == 0).all(axis=1).mean()
    period = f", period {reference.period:g} s" if reference.period else ""
    return [
        f"{spec.kind} motion of {robot.name}: {spec.duration:g} s at "
        f"{wanted.rate:g} Hz{period}, seed {spec.seed}"
        + (f", at rest {100 * still:.0f} % of the time" if still > 0.01 else ""),
        "limits, floor and self-collision (arm as capsules) checked between samples "
        "too",
    ]


def _table(used: Usage) -> Table:
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


def _excited(used: Usage) -> str:
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
