"""What commands cost on a log of an hour, and whether it says what it says whole.

The log is that of an arm at work, one motion after the other, made piece by piece.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from benchmarks.harness.figures import Figures, all_partial, figure, missing
from benchmarks.harness.logs import sensed
from benchmarks.harness.shell import run_shell
from benchmarks.store_parts.made import folder
from benchmarks.synthetic.motions import FAMILIES, make_motion
from residual.diagnosis.result import Diagnosis
from residual.method.diagnose import diagnose
from residual.robot.robot import load_robot
from residual.signals import logs as pieces
from sim.draw import draw
from sim.engine.records import Reference, stream
from sim.plant.sizes import usual_limits
from sim.quasi_static import Plant, true_torque
from sim.trajectories.curves import move_time, quintic
from warehouse.logs import read_log

Array = np.ndarray
PIECE = 60.0  # s
DIGITS = 9  # of a number in the CSV, more than any sensor has


@dataclass(frozen=True, slots=True)
class Shift:
    """What to write.

    Attributes:
        seconds: Length [s].
        rate: Samples per second [Hz].
        seed: Seed of everything.
        effect: What the arm hides; None for nothing.
    """

    seconds: float
    rate: float = 1000.0
    seed: int = 16
    effect: str | None = "payload"


def write_shift(shift: Shift, folder: Path, forms: tuple[str, ...]) -> list[Path]:
    """Write one log in each form and return its paths.

    Args:
        forms: "parquet", "csv" or both.
    """
    writers, paths = [], []
    for form in forms:
        path = folder / f"shift_{shift.seconds:g}s_{shift.seed}.{form}"
        paths.append(path)
        writers.append(_writer(form, path))
    for table in tables_of(shift):
        for writer in writers:
            writer.write_table(table)
    for writer in writers:
        writer.close()
    return paths


def _writer(form: str, path: Path) -> pq.ParquetWriter | pc.CSVWriter:
    if form == "csv":
        return pc.CSVWriter(path, _SCHEMA)
    return pq.ParquetWriter(path, _SCHEMA)


_NAMES = ["t", *(f"{c}{j}" for c in ("q", "tau") for j in range(1, 7))]
_SCHEMA = pa.schema([(name, pa.float64()) for name in _NAMES])


def tables_of(shift: Shift) -> Iterator[pa.Table]:
    """Make the log piece by piece: a motion of some family, and the way to the next."""
    plant = _plant(shift)
    start = _motion(plant, shift, 0)
    done = 0
    number = 0
    while done < shift.seconds * shift.rate:
        following = _motion(plant, shift, number + 1)
        motion = _with_way(plant, shift, start, following.q[0])
        t = (done + np.arange(len(motion.t))) / shift.rate
        name = f"piece_{number}"
        torque = true_torque(plant, motion, name, done / shift.rate)
        q, tau = sensed(plant.robot, torque, name, shift.seed, shift.rate)
        done += len(t)
        kept = t < shift.seconds
        table = np.column_stack([t, q, tau])[kept]
        yield pa.table(dict(zip(_NAMES, table.round(DIGITS).T, strict=True)), _SCHEMA)
        start, number = following, number + 1


def _plant(shift: Shift) -> Plant:
    robot = load_robot("irb140")
    hidden = ()
    if shift.effect is not None:
        rng = stream(shift.seed, f"draw/{shift.effect}")
        hidden = (draw(robot, shift.effect, rng, None),)
    return Plant(robot, hidden, shift.seed)


def _motion(plant: Plant, shift: Shift, number: int) -> Reference:
    family = FAMILIES[number % len(FAMILIES)]
    rng = stream(shift.seed, f"motion/{number}")
    # Two periods of a Fourier motion fit into its length: it is kept brisk.
    length = 20.0 if family == "fourier" else PIECE
    return make_motion(family, usual_limits(plant.robot), length, shift.rate, rng)


def _with_way(plant: Plant, shift: Shift, motion: Reference, end: Array) -> Reference:
    """Append the move to where the next motion begins."""
    space, start = usual_limits(plant.robot), motion.q[-1]
    time = 1.5 * move_time(end - start, space.velocity, space.acceleration)
    x = np.arange(1, round(time * shift.rate) + 1)[:, None] / (time * shift.rate)
    way = quintic(start, end, time, np.minimum(x, 1.0))
    q, qd, qdd = (
        np.concatenate([a, b])
        for a, b in zip((motion.q, motion.qd, motion.qdd), way, strict=True)
    )
    return Reference(motion.kind, np.arange(len(q)) / shift.rate, q, qd, qdd, None)


HOUR, WHOLE, QUICK = 3600.0, 900.0, 120.0  # s
SECONDS, GIGABYTES, TENTH = 90.0, 2.0, 0.1
_ARM = ("--robot", "irb140")


def cost_figures(quick: bool) -> Figures:
    """Time every command that takes logs on one long log."""
    seconds = QUICK if quick else HOUR
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
    why = f"{seconds:g} s instead of an hour" if quick else ""
    return all_partial(figures, why)


def _cost(name: str, words: tuple[str, ...], place: Path) -> Figures:
    done = run_shell(list(words), str(place))
    bars = {"seconds": SECONDS if name == "diagnose_parquet" else None}
    if done.code:
        return {f"{name}_gb": missing(GIGABYTES, done.failure) | {"ok": False}}
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


def same_figures(quick: bool) -> Figures:
    """Diagnose one log in pieces and whole, and compare."""
    seconds = QUICK if quick else WHOLE
    with folder() as place:
        (path,) = write_shift(Shift(seconds), place, ("parquet",))
        robot = load_robot("irb140")
        log, _ = read_log(str(path), robot)
        cut = diagnose(robot, [log])
        with (
            patch.object(pieces, "LONG", np.inf),
            patch.object(pieces, "SKETCH", np.inf),
        ):
            whole = diagnose(robot, [log])
    other, off = _apart(cut, whole)
    figures = {
        "other_names": figure(other, 0, len(whole.effects)),
        "parameters_apart": figure(round(off, 3), TENTH, len(whole.effects)),
    }
    return all_partial(figures, f"{seconds:g} s instead of {WHOLE:g}" if quick else "")


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
