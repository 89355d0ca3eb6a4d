"""Logs as a workshop writes them: ms, degrees, motor torque, a joint backwards.

python -m sim.synthetic.workshop FOLDER SEED EFFECT JOINT KEY=VALUE...

FOLDER/arm is the robot; the effect is one that neither URDF nor robot.toml has.
"""

import sys
from pathlib import Path

import numpy as np

from residual.recording import Recording
from residual.robot.robot import load_robot
from sim.records import Hidden
from sim.synthetic.logs import LogPlan, make
from sim.synthetic.plant import Plant

BACKWARDS = np.array([1.0, -1.0])  # joint 2 of the controller counts the other way
ZERO = np.array([0.0, 90.0])  # deg that the controller shows where the URDF has zero
_PLAN = tuple(
    LogPlan(name, part, family, rate=100.0, duration=12.0)
    for name, part, family in (
        ("monday", "fit", "fourier"),
        ("tuesday", "fit", "cyclic"),
        ("wednesday", "fit", "slow_cyclic"),
        ("thursday", "held_out", "move_stop_move"),
    )
)


def write_workshop(folder: Path, seed: int, hidden: Hidden) -> list[Path]:
    """Write four logs of the arm in that folder, in the controller's own units.

    Args:
        folder: Has the robot in `arm`; gets one CSV per log.
    """
    robot = load_robot(folder / "arm")
    gear = np.abs(robot.gear_ratio)
    paths = []
    for log in make(Plant(robot, (hidden,), seed), _PLAN, seed):
        paths.append(folder / f"{log.id}.csv")
        _write(paths[-1], log, gear)
    return paths


def _write(path: Path, log: Recording, gear: np.ndarray) -> None:
    numbers = range(1, log.dof + 1)
    header = ["Time", *(f"J{j}" for j in numbers), *(f"M{j}" for j in numbers)]
    table = np.column_stack(
        [
            1000 * log.t,
            BACKWARDS * np.rad2deg(log.q) + ZERO,
            BACKWARDS * log.tau / gear,
        ]
    )
    formats = ["%.0f", *log.dof * ["%.3f"], *log.dof * ["%.5f"]]
    head = ";".join(header)
    np.savetxt(path, table, fmt=formats, delimiter=";", header=head, comments="")


if __name__ == "__main__":
    where, number, effect, joint, *given = sys.argv[1:]
    values = {key: float(value) for key, value in (word.split("=") for word in given)}
    on = Hidden(effect, (int(joint),), values)
    for written in write_workshop(Path(where), int(number), on):
        print(written)
