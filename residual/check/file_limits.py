"""Limits of the robot file: those that are placeholders, and real ones far exceeded."""

from collections.abc import Sequence

import numpy as np

from residual.check.result import Fault
from residual.check.rules import CHECK
from residual.check.samples import running_median
from residual.quantity import along
from residual.recording import Array, Recording
from residual.robot.limits import placeholders
from residual.robot.robot import Robot


def doubted_limits(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Doubt the file where no joint keeps to a limit; it is then not checked."""
    return [
        Fault(
            "robot_file",
            (),
            False,
            f"A placeholder: {words}; the other joints' limits are like it. They are "
            "not checked; give the real ones in robot.toml, [joints].",
        )
        for words in placeholders(robot, recordings).values()
    ]


def excursions(robot: Robot, recordings: Sequence[Recording]) -> list[Fault]:
    """Find several samples in a row at five times a real limit: no arm makes them."""
    out = []
    for log in recordings:
        step = np.diff(log.t)
        speed = np.diff(log.q, axis=0) / step[:, None] if log.qd is None else log.qd
        for name, values, limit, unit in (
            ("speed", speed, robot.velocity_limit, "rad/s"),
            ("tau", log.tau, robot.torque_limit, "N m"),
        ):
            # A wrap is one step, a spike one sample: neither outlives the median.
            size = running_median(np.abs(values))
            # Of what is large all along the unit is wrong, and other checks say so.
            usual = np.quantile(size, CHECK.clock_share, axis=0)
            far = (size > CHECK.excursion * limit) & (usual < CHECK.range_limit * limit)
            for j in np.flatnonzero(far.any(axis=0)):
                most = float(size[:, j].max())
                unit_of = along(unit) if robot.prismatic[j] else unit
                what = (
                    f"joint {j + 1} moves at" if name == "speed" else f"tau{j + 1} is"
                )
                words = (
                    f"{what} {most:.3g} {unit_of} for {_longest(far[:, j])} samples in "
                    f"a row, its limit is {limit[j]:.3g} {unit_of}."
                )
                joints = (int(j) + 1,)
                out.append(Fault("out_of_range", joints, True, words, (), log.id))
    return out


def _longest(mask: Array) -> int:
    """Length of the longest run of a mask."""
    edges = np.flatnonzero(np.diff(np.r_[False, mask, False].astype(int)))
    return int((edges[1::2] - edges[::2]).max(initial=0))
