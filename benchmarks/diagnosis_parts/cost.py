"""Time and memory of `modelgap diagnose` on two minutes of six-joint logs."""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.harness.figures import FULL, Figures, all_missing, figure, missing
from benchmarks.harness.shell import run_command
from residual.robot.robot import load_robot
from sim.engine.plant_records import create_random_stream
from sim.plant.typical_sizes import draw_effect
from tests.synthetic.logs import LogPlan, make, write_csv
from tests.synthetic.quasi_static import Plant

_COSTS = {"seconds": 10.0, "peak_gb": 1.0}


def cost_figures(quick: bool) -> Figures:
    """Time `modelgap diagnose` on two minutes of six-joint logs at 250 Hz.

    Five logs of 20 s to fit and one held out, as CSV; peak memory is that of the
    process and of what it starts.
    """
    if quick:
        return all_missing(_COSTS, FULL)
    with tempfile.TemporaryDirectory() as folder:
        *fit, held_out = _write_logs(Path(folder))
        words = ["diagnose", *fit, "--holdout", held_out, "--robot", "irb140"]
        words += ["--json", str(Path(folder) / "verdict.json")]
        done = [run_command(words, folder) for _ in range(3)]
        ok = (Path(folder) / "verdict.json").exists()
    failed = next((each for each in done if each.code != 0 or not ok), None)
    if failed is not None:
        figures = {k: missing(bar, failed.output[-200:]) for k, bar in _COSTS.items()}
        return {name: entry | {"ok": False} for name, entry in figures.items()}
    seconds = [round(each.seconds, 2) for each in done]
    peak = round(max(each.gigabytes for each in done), 3)
    return {
        "seconds": figure(float(np.median(seconds)), _COSTS["seconds"], len(done), all=seconds),
        "peak_gb": figure(peak, _COSTS["peak_gb"], len(done)),
    }


def _write_logs(folder: Path) -> list[str]:
    robot = load_robot("irb140")
    hidden = draw_effect(robot, "stribeck", create_random_stream(1, "draw/stribeck"), 2)
    families = ("fourier", "cyclic", "slow_cyclic", *2 * ("move_stop_move",))
    plan = tuple(LogPlan(f"fit_{i}_{k}", "fit", k) for i, k in enumerate(families, 2))
    plan += (LogPlan("held_out_2_move_stop_move", "held_out", "move_stop_move"),)
    logs = make(Plant(robot, (hidden,), 1), plan, 1)
    for log in logs:
        write_csv(folder / f"{log.id}.csv", log, "%.6f")
    return [str(folder / f"{log.id}.csv") for log in logs]
