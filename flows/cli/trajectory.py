"""modelgap trajectory: plan a motion, preview it, export it."""

from pathlib import Path

from rich.console import Console

from flows.cli.options import (
    FASTEST,
    LONGEST,
    MOST_PERIODS,
    SEEDS,
    check_between,
    named_files,
)
from flows.inputs.robots import load
from flows.outputs import check_writable, write_all
from flows.report.console import show
from flows.report.motion import motion_parts, motion_png
from flows.steps.trajectory import as_csv
from sim.engine.render import animate
from sim.records import TrajectorySpec
from sim.trajectories import make_reference
from sim.trajectories.excitation import usage


def trajectory(
    kind: str,
    *,
    robot: str = "irb140",
    duration: float = 20.0,
    periods: int = 2,
    seed: int = 0,
    rate: float = 250.0,
    csv: str | None = None,
    plot: str | None = None,
    gif: str | None = None,
) -> None:
    """Plan a motion within the limits of a robot.

    Prints how much of each limit it uses and how well it excites the parameters of
    the model. Range, speed, acceleration, torque of the nominal model, the floor and
    the arm itself are respected between the samples too.

    ```
    modelgap trajectory fourier --gif arm.gif
    modelgap trajectory welding --robot arm.urdf --duration 30 --csv program.csv
    ```

    Args:
        kind: fourier (optimised excitation), cyclic (spray painting), welding (seams
            with air moves) or move_stop_move (pick and place with dwells).
        robot: Built-in name (irb140), URDF file, or folder with one *.urdf and an
            optional robot.toml.
        duration: Length in seconds, up to 600.
        periods: How often the motion is repeated within it.
        seed: Seed of what is drawn: starts of the search, work piece, places.
        rate: Samples per second of the CSV.
        csv: File for a controller: t (s), q1... (rad), qd1... (rad/s), qdd1...
            (rad/s^2).
        plot: PNG of the curves to write.
        gif: GIF of the moving arm to write.
    """
    files = named_files({"--csv": csv, "--plot": plot, "--gif": gif})
    check_writable(files, [Path(robot)])
    check_between("--duration", duration, 0.1, LONGEST)
    check_between("--periods", periods, 1, MOST_PERIODS)
    check_between("--rate", rate, 1, FASTEST)
    check_between("--seed", seed, 0, SEEDS)
    spec, arm = TrajectorySpec(kind, duration, periods, seed), load(robot)
    motion = make_reference(arm, spec, rate)
    make = {
        "--csv": lambda: as_csv(motion),
        "--plot": lambda: motion_png(arm, motion),
        "--gif": lambda: animate(arm, motion),
    }
    # Before anything is printed, which may go into a pipe that closes.
    write_all({path: make[option]() for option, path in files.items()})
    parts = motion_parts(arm, motion, spec, rate, usage(arm, motion))
    show(Console(), *parts, *(f"wrote {path}" for path in files.values()))
