"""A two-joint arm, a short log of it, and tables of what a log must have become."""

import csv
import io
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np

from residual.recording import Recording
from residual.robot.robot import Robot, load_robot
from tests.warehouse.conftest import NAMES, URDF
from warehouse.logs.log_reading import LogSummary

Array = np.ndarray


@cache
def arm() -> Robot:
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        (folder / "arm.urdf").write_text(URDF)
        (folder / "robot.toml").write_text(
            "[joints]\ngear_ratio = [50, -80]\ntorque_per_unit = [4.0, 3.5]\n"
        )
        return load_robot(folder)


@cache
def samples(rows: int = 30) -> Array:
    """Three seconds at 10 Hz: columns t, q1, q2, tau1, tau2."""
    rng = np.random.default_rng(5)
    t = np.arange(rows) / 10
    q = np.column_stack([np.sin(2 * t), 0.5 * np.cos(3 * t)])
    return np.round(np.column_stack([t, q, rng.normal(size=(rows, 2))]), 4)


def as_csv(separator: str = ",", decimal: str = ".") -> str:
    lines = [separator.join(NAMES)]
    lines += [
        separator.join(repr(float(x)).replace(".", decimal) for x in row) for row in samples()
    ]
    return "\n".join(lines) + "\n"


def check_rows(log: Recording, told: LogSummary, table: Mapping[str, Sequence[float]]) -> None:
    """Assert that a log has the rows of its file, in their order, all of the good."""
    names = ["t", *(f"{c}{j + 1}" for c in ("q", "tau") for j in range(log.dof))]
    got = np.column_stack([log.t, log.q, log.tau])
    file = np.column_stack([np.array(table[n], dtype=float) for n in names])
    rows = iter(file)
    for row in got:
        assert any(np.array_equal(row, other) for other in rows), f"no such row: {row}"
    if not told.doubts:
        whole = np.isfinite(file).all(axis=1).sum()
        assert len(got) == whole, f"{len(got)} of {whole} rows, and not a word of it"
    assert len(got) == told.rows


def table_of(data: bytes) -> dict[str, list[float]] | None:
    """Return the columns of a text with commas; None where nobody can say."""
    try:
        text = data.decode("utf-8-sig")
        lines = [row for row in csv.reader(io.StringIO(text, newline="")) if row]
    except (UnicodeDecodeError, csv.Error):
        return None
    while lines and not set(NAMES) <= {name.strip() for name in lines[0]}:
        lines.pop(0)
    if not lines:
        return None
    names = [name.strip() for name in lines[0]]
    rows = [row for row in lines[1:] if len(row) == len(names)]
    columns = zip(*rows, strict=True)
    return {n: _numbers(c) for n, c in zip(names, columns, strict=False)}


def _numbers(texts: Iterable[str]) -> list[float]:
    out = []
    for text in texts:
        try:
            out.append(float(text) if "_" not in text else np.nan)
        except ValueError:
            out.append(np.nan)
    return out
