"""Rows to fit to, and the columns that peers need."""

from time import process_time

import numpy as np

from residual.tables.nominal_pls import NominalPls

RATE = 250.0  # Hz


def motion_rows(rows: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """One long motion of three joints with friction: 9 variables, 3 responses."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 60, rows)
    q = _fourier(t, 0.1, rng)
    qd = np.gradient(q, t, axis=0)
    qdd = np.gradient(qd, t, axis=0)
    return _with_friction(q, qd, qdd, rng)


def repeated_rows(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Four runs of two periods of 10 s at 250 Hz: 20 000 rows, and the run of each.

    As on the plant, X is the reference: both periods have the same states.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(2500) / RATE
    parts = []
    for _ in range(4):
        q = _fourier(t, 0.1, rng)
        qd = np.gradient(q, t, axis=0)
        twice = (np.tile(x, (2, 1)) for x in (q, qd, np.gradient(qd, t, axis=0)))
        parts.append(_with_friction(*twice, rng))
    X, Y = (np.concatenate(side) for side in zip(*parts, strict=True))
    return X, Y, np.repeat(np.arange(4), 5000)


def random_rows(rows: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rows of which no two share all levels: the hardest case for our fit."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1, 1, (rows, 9))
    return X, np.sign(X[:, 3:6]) + rng.normal(size=(rows, 3))


def dense_columns(model: NominalPls, X: np.ndarray) -> np.ndarray:
    """The matrix of eq. 30, as peers need it: a gigabyte at 8 000 rows."""
    codes = model.levels.encode(X).values.astype(int)
    sizes = model.levels.sizes
    columns = np.zeros((len(X), len(model.x_mean)))
    start, rows = 0, np.arange(len(X))
    for i, j in model.pairs:
        columns[rows, start + codes[:, i] * sizes[j] + codes[:, j]] = 1
        start += sizes[i] * sizes[j]
    return columns


def seconds(job: object, times: int = 1) -> float:
    """Least processor time of a call: other processes do not count [s]."""
    spent = []
    for _ in range(times):
        start = process_time()
        job()
        spent.append(process_time() - start)
    return min(spent)


def _fourier(t: np.ndarray, hertz: float, rng: np.random.Generator) -> np.ndarray:
    """Five harmonics per joint, as eq. 4 of the paper. Shape (n, 3)."""
    q = np.zeros((len(t), 3))
    for k in range(1, 6):
        size, phase = rng.normal(size=3), rng.uniform(0, 2 * np.pi, 3)
        q += size * np.sin(2 * np.pi * k * hertz * t[:, None] + phase) / k
    return q


def _with_friction(q, qd, qdd, rng) -> tuple[np.ndarray, np.ndarray]:
    slip = 1 + 0.5 * np.exp(-((qd / 0.05) ** 2))
    Y = 10 * np.tanh(qd / 0.005) * slip + 5 * qd + rng.normal(size=q.shape)
    return np.hstack([q, qd, qdd]), Y
