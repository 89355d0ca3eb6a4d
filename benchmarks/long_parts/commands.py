"""What commands cost on a log of an hour, and whether it says what it says whole."""

import json
from pathlib import Path
from unittest.mock import patch

import numpy as np

from benchmarks.figures import Figures, figure, missing, partial
from benchmarks.long_parts.shift import Shift, write_shift
from benchmarks.measured_parts.shell import run_shell
from benchmarks.store_parts.made import folder
from residual.close import close_the_loop
from residual.diagnosis.result import Diagnosis
from residual.robot.robot import load_robot
from residual.signals import pieces
from warehouse.logs import read_log

HOUR, WHOLE = 3600.0, 900.0  # s
SECONDS, GIGABYTES, TENTH = 90.0, 2.0, 0.1
_ARM = ("--robot", "irb140")


def cost_figures(seconds: float) -> Figures:
    """Time every command that takes logs on one long log.

    Args:
        seconds: Length of the log [s].
    """
    figures: Figures = {}
    with folder() as place:
        parquet, csv = map(str, write_shift(Shift(seconds), place, ("parquet", "csv")))
        store = ("--store", str(place / "store"))
        words = {
            "diagnose_parquet": ("diagnose", parquet, *_ARM),
            "diagnose_csv": ("diagnose", csv, *_ARM),
            "identify": ("identify", parquet, *_ARM),
            "calibrate": ("calibrate", parquet, *_ARM),
            "check": ("check", parquet, *_ARM),
            "import": ("import", parquet, *_ARM, *store),
        }
        for name, command in words.items():
            figures |= _cost(name, command, place)
        figures |= _cost("monitor", _monitor(place, seconds, store), place)
    if seconds >= HOUR:
        return figures
    why = f"{seconds:g} s instead of an hour"
    return {name: partial(entry, why) for name, entry in figures.items()}


def _cost(name: str, words: tuple[str, ...], place: Path) -> Figures:
    done = run_shell(list(words), str(place))
    bars = {"seconds": SECONDS if name == "diagnose_parquet" else None}
    if done.code:
        why = f"the command failed: {done.said.strip()[-200:]}"
        return {f"{name}_gb": missing(GIGABYTES, why) | {"ok": False}}
    seconds = round(done.seconds, 1)
    return {
        f"{name}_seconds": figure(
            seconds, bars["seconds"], 1, cpu_s=round(done.cpu, 1)
        ),
        f"{name}_gb": figure(round(done.gigabytes, 2), GIGABYTES, 1),
    }


def _monitor(place: Path, seconds: float, store: tuple[str, ...]) -> tuple[str, ...]:
    """Put good runs and the long one into a store; return what watches that one."""
    good = [
        write_shift(Shift(60.0, seed=seed), place, ("parquet",))[0]
        for seed in (1, 2, 3)
    ]
    long = place / f"shift_{seconds:g}s_16.parquet"
    for path in (*good, long):
        run_shell(["import", str(path), *_ARM, *store], str(place))
    asked = ["sql", "SELECT run_id, duration_s FROM runs", "--format", "json", *store]
    rows = json.loads(run_shell(asked, str(place)).said)
    ids = [row["run_id"] for row in sorted(rows, key=lambda row: row["duration_s"])]
    return ("monitor", "irb140", ids[-1], "--calibrate", *ids[:-1], *store)


def same_figures(seconds: float) -> Figures:
    """Diagnose one log in pieces and whole, and compare.

    Args:
        seconds: Length of the log [s].
    """
    with folder() as place:
        (path,) = write_shift(Shift(seconds), place, ("parquet",))
        robot = load_robot("irb140")
        log, _ = read_log(str(path), robot)
        cut = close_the_loop(robot, [log])
        with (
            patch.object(pieces, "LONG", np.inf),
            patch.object(pieces, "SKETCH", np.inf),
        ):
            whole = close_the_loop(robot, [log])
    other, off = _apart(cut, whole)
    figures = {
        "other_names": figure(other, 0, len(whole.effects)),
        "parameters_apart": figure(round(off, 3), TENTH, len(whole.effects)),
    }
    if seconds >= WHOLE:
        return figures
    why = f"{seconds:g} s instead of {WHOLE:g}"
    return {name: partial(entry, why) for name, entry in figures.items()}


def _apart(cut: Diagnosis, whole: Diagnosis) -> tuple[int, float]:
    """Names that only one of them has; the largest gap in standard deviations."""
    found = [{(e.name, e.joints): e for e in d.effects} for d in (cut, whole)]
    both = set(found[0]) & set(found[1])
    gaps = [
        abs(found[0][key].parameters[name].value - value.value) / value.std
        for key in both
        for name, value in found[1][key].parameters.items()
        if value.std
    ]
    return len(set(found[0]) ^ set(found[1])), max(gaps, default=np.nan)
