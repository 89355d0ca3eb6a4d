"""The nominal twin of measured logs; apart, since it alone needs the simulation."""

from collections.abc import Sequence
from dataclasses import replace

from residual.calibration.rows import Run
from residual.robot.robot import Robot
from sim.twin import log_twin_errors


def with_twins(robot: Robot, runs: Sequence[Run]) -> tuple[Run, ...]:
    """Return runs with their errors against a twin on their own reference.

    Those that have a twin, and those that have no reference, stay as they are.

    Raises:
        DivergedError: If a twin cannot follow.
    """
    return tuple(
        run
        if run.log.q_ref is None or "e_tau" in run.twin
        else replace(run, twin=log_twin_errors(robot, run.log))
        for run in runs
    )
