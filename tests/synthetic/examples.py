"""Write small cases as files, as an engineer would export them.

python -m tests.synthetic.examples hidden FOLDER SEED EFFECT
    the built-in arm in SI units, with the truth in a file
python -m tests.synthetic.examples workshop FOLDER SEED EFFECT JOINT KEY=VALUE...
    the arm in FOLDER/arm, with an effect that its files do not have, in the units of a
    workshop: ms, degrees, motor torque, one joint reversed
"""

import json
import sys
from pathlib import Path

import numpy as np

from residual.robot.robot import load_robot
from sim.engine.plant_records import SyntheticEffect, create_random_stream
from sim.plant.typical_sizes import draw_effect
from tests.synthetic.logs import LogPlan, make, write_csv
from tests.synthetic.quasi_static import Plant

BACKWARDS = np.array([1.0, -1.0])  # joint 2 of the controller counts the other way
ZERO = np.array([0.0, 90.0])  # deg that the controller shows where the URDF has zero
_HIDDEN = (
    ("fit_1", "fit", "slow_cyclic"),
    ("fit_2", "fit", "cyclic"),
    ("fit_3", "fit", "move_stop_move"),
    ("held_out", "held_out", "fourier"),
)
_WORKSHOP = (
    ("monday", "fit", "fourier"),
    ("tuesday", "fit", "cyclic"),
    ("wednesday", "fit", "slow_cyclic"),
    ("thursday", "held_out", "move_stop_move"),
)


def write_hidden(folder: Path, seed: int, effect: str) -> list[Path]:
    """Write logs of the built-in arm with one hidden effect.

    Three logs to fit and one of another motion family to hold out, as CSV (t to 1 ms, q
    to the step of the encoder and tau to 10 mN m); truth.json tells what is hidden and
    is not for the diagnosis.
    """
    folder.mkdir(parents=True, exist_ok=True)
    robot = load_robot("irb140")
    hidden = draw_effect(robot, effect, create_random_stream(seed, f"draw/{effect}"))
    # 125 Hz: enough for a demonstration, half the size.
    plan = tuple(LogPlan(*log, rate=125.0) for log in _HIDDEN)
    paths = []
    for log in make(Plant(robot, (hidden,), seed), plan, seed):
        paths.append(folder / f"{log.id}.csv")
        write_csv(paths[-1], log, ["%.3f", *6 * ["%.4f"], *6 * ["%.2f"]])
    truth = {
        "name": hidden.name,
        "joints": list(hidden.joints),
        "parameters": {k: round(float(v), 6) for k, v in hidden.parameters.items()},
        "seed": seed,
    }
    paths.append(folder / "truth.json")
    paths[-1].write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8")
    return paths


def write_workshop(folder: Path, seed: int, hidden: SyntheticEffect) -> list[Path]:
    """Write four logs of the arm in that folder, in the controller's own units."""
    robot = load_robot(folder / "arm")
    plan = tuple(LogPlan(*log, duration=12.0, rate=100.0) for log in _WORKSHOP)
    paths = []
    for log in make(Plant(robot, (hidden,), seed), plan, seed):
        paths.append(folder / f"{log.id}.csv")
        torque = BACKWARDS * log.tau / np.abs(robot.gear_ratio)
        table = np.column_stack([1000 * log.t, BACKWARDS * np.rad2deg(log.q) + ZERO, torque])
        formats = ["%.0f", *2 * ["%.3f"], *2 * ["%.5f"]]
        np.savetxt(paths[-1], table, formats, ";", header="Time;J1;J2;M1;M2", comments="")
    return paths


if __name__ == "__main__":
    kind, where, number, effect, *rest = sys.argv[1:]
    if kind == "hidden":
        written = write_hidden(Path(where), int(number), effect)
    else:
        joint, *given = rest
        pairs = (word.split("=") for word in given)
        values = {key: float(value) for key, value in pairs}
        hides = SyntheticEffect(effect, (int(joint),), values)
        written = write_workshop(Path(where), int(number), hides)
    print(*written, sep="\n")
