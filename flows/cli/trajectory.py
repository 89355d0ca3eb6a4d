"""modelgap trajectory: plan a motion, preview it, export it."""


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
        duration: Length in seconds.
        periods: How often the motion is repeated within it.
        seed: Seed of what is drawn: starts of the search, work piece, places.
        rate: Samples per second of the CSV.
        csv: File for a controller: t (s), q1... (rad), qd1... (rad/s), qdd1...
            (rad/s^2).
        plot: PNG of the curves to write.
        gif: GIF of the moving arm to write.
    """
    from rich.console import Console

    from flows.steps.trajectory import Wanted, preview
    from sim.records import TrajectorySpec

    spec = TrajectorySpec(kind, duration, periods, seed)
    preview(Wanted(spec, robot, rate, csv, plot, gif), Console())
