"""Evaluate exported tables: needs numpy and model.npz, nothing else.

    python evaluate.py model.npz rows.csv > corrections.csv

    correction = build_row_evaluator(dict(np.load("model.npz")))
    correction(x)                        # of one row, for a loop: some microseconds

A row holds the variables in the order of `names`, in rad, rad/s and rad/s^2; tau is the
torque of the model in N m. A value outside the calibrated range takes the nearest
level; `flag_outside_range` reports which.
"""

import sys
from bisect import bisect_right

import numpy as np


def predict(model, X):
    """Return the correction of each row. Shapes (n, d) -> (n, joints)."""
    levels = [
        np.searchsorted(model[f"edges_{axis}"], X[:, variable], side="right")
        for axis, variable in enumerate(model["axis_variable"])
    ]
    out = model["offset"] + X @ model["slope"]
    for table, (a, b) in enumerate(model["table_axes"]):
        values = model[f"values_{table}"]
        out += values[levels[a]] if b < 0 else values[levels[a], levels[b]]
    return out


def build_row_evaluator(model):
    """Return a function of one row, (d,) -> (joints,): all is looked up beforehand."""
    edges = [model[f"edges_{k}"].tolist() for k in range(len(model["axis_variable"]))]
    axes = list(zip(model["axis_variable"].tolist(), edges, strict=True))
    offset, slope = model["offset"], model["slope"]
    linear = slope.any()
    tables = [model[f"values_{k}"] for k in range(len(model["table_axes"]))]
    if not tables:
        return lambda x: offset + np.dot(x, slope)
    # A table of one axis has a second one, the last of all, at level 0.
    first, second = np.ascontiguousarray(model["table_axes"].T)
    across = np.array([t.shape[1] if t.ndim == 3 else 1 for t in tables])
    flat = [t.reshape(-1, len(offset)) for t in tables]
    start = np.cumsum([0, *map(len, flat[:-1])])
    cells = np.concatenate(flat)

    def correction(x):
        values = x.tolist() if isinstance(x, np.ndarray) else x
        levels = [bisect_right(inner, values[variable]) for variable, inner in axes]
        levels = np.array([*levels, 0])
        places = start + across * levels[first] + levels[second]
        out = np.add.reduce(cells[places]) + offset
        return out + np.dot(x, slope) if linear else out

    return correction


def flag_outside_range(model, X):
    """Return which values lie outside the calibrated range. Shape (n, d)."""
    return np.less(X, model["low"]) | np.greater(X, model["high"])


if __name__ == "__main__":
    loaded = dict(np.load(sys.argv[1], allow_pickle=False))
    rows = np.loadtxt(sys.argv[2], delimiter=",", ndmin=2)
    np.savetxt(sys.stdout, predict(loaded, rows), "%.17g", delimiter=",")
