"""A log of hours: an arm at work, one motion after the other, made piece by piece."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.csv as pc
import pyarrow.parquet as pq

from benchmarks.synthetic.motions import FAMILIES, make_motion
from residual.robot.robot import load_robot
from sim.draw import draw
from sim.plant.sensors import encoder, torque_noise
from sim.quasi_static import Plant, true_torque
from sim.records import Reference, stream
from sim.sizes import room, sizes
from sim.trajectories.curves import move_time, quintic

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
    for table in pieces(shift):
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


def pieces(shift: Shift) -> Iterator[pa.Table]:
    """Make the log piece by piece: a motion of some family, and the way to the next."""
    plant = _plant(shift)
    span = sizes(plant.robot).torque
    start = _motion(plant, shift, 0)
    done = 0
    number = 0
    while done < shift.seconds * shift.rate:
        following = _motion(plant, shift, number + 1)
        motion = _with_way(plant, shift, start, following.q[0])
        t = (done + np.arange(len(motion.t))) / shift.rate
        name = f"piece_{number}"
        torque = true_torque(plant, motion, name, done / shift.rate)
        noise = torque_noise(
            len(t), span, shift.rate, stream(shift.seed, f"torque/{name}")
        )
        q = encoder(torque.reading, stream(shift.seed, f"encoder/{name}"))
        done += len(t)
        kept = t < shift.seconds
        table = np.column_stack([t, q, torque.tau + noise])[kept]
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
    return make_motion(family, room(plant.robot), length, shift.rate, rng)


def _with_way(plant: Plant, shift: Shift, motion: Reference, end: Array) -> Reference:
    """Append the move to where the next motion begins."""
    space, start = room(plant.robot), motion.q[-1]
    time = 1.5 * move_time(end - start, space.velocity, space.acceleration)
    x = np.arange(1, round(time * shift.rate) + 1)[:, None] / (time * shift.rate)
    way = quintic(start, end, time, np.minimum(x, 1.0))
    q, qd, qdd = (
        np.concatenate([a, b])
        for a, b in zip((motion.q, motion.qd, motion.qdd), way, strict=True)
    )
    return Reference(motion.kind, np.arange(len(q)) / shift.rate, q, qd, qdd, None)
