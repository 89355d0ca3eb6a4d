"""Write a small case as files: what an engineer would export, and the sealed truth.

python -m sim.synthetic.demo FOLDER SEED EFFECT
"""

import json
import sys
from pathlib import Path

import numpy as np

from residual.recording import Recording
from residual.robot.robot import load_robot
from sim.draw import draw
from sim.streams import stream
from sim.synthetic.logs import LogPlan, make
from sim.synthetic.plant import Plant

_RATE = 125.0  # Hz: enough for a demonstration, half the size
_PLAN = (
    LogPlan("fit_1", "fit", "slow_cyclic", rate=_RATE),
    LogPlan("fit_2", "fit", "cyclic", rate=_RATE),
    LogPlan("fit_3", "fit", "move_stop_move", rate=_RATE),
    LogPlan("held_out", "held_out", "fourier", rate=_RATE),
)


def write_demo(folder: Path, seed: int, effect: str) -> list[Path]:
    """Write logs of the built-in arm with one hidden effect.

    Three logs to fit and one of another motion family to hold out, as CSV; truth.json
    tells what is hidden and is not for the diagnosis.

    Args:
        folder: Where to write; made if it is not there.
    """
    folder.mkdir(parents=True, exist_ok=True)
    robot = load_robot("irb140")
    hidden = draw(robot, effect, stream(seed, f"draw/{effect}"))
    paths = []
    for recording in make(Plant(robot, (hidden,), seed), _PLAN, seed):
        paths.append(folder / f"{recording.id}.csv")
        _write_csv(paths[-1], recording)
    truth = {
        "name": hidden.name,
        "joints": list(hidden.joints),
        "parameters": {k: round(float(v), 6) for k, v in hidden.parameters.items()},
        "seed": seed,
    }
    paths.append(folder / "truth.json")
    paths[-1].write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8")
    return paths


def _write_csv(path: Path, recording: Recording) -> None:
    """Write t to 1 ms, q to the step of the encoder and tau to 10 mN m."""
    numbers = range(1, recording.dof + 1)
    header = ["t", *(f"q{j}" for j in numbers), *(f"tau{j}" for j in numbers)]
    formats = ["%.3f", *recording.dof * ["%.4f"], *recording.dof * ["%.2f"]]
    np.savetxt(
        path,
        np.column_stack([recording.t, recording.q, recording.tau]),
        fmt=formats,
        delimiter=",",
        header=",".join(header),
        comments="",
    )


if __name__ == "__main__":
    folder, seed, effect = sys.argv[1:]
    for written in write_demo(Path(folder), int(seed), effect):
        print(written)
