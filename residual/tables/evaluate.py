"""Evaluate exported tables: needs numpy and model.npz, nothing else.

    python evaluate.py model.npz rows.csv > corrections.csv

A row holds the variables in the order of `names`, in rad, rad/s and rad/s^2; tau is the
torque of the model in N m. A value outside the calibrated range takes the nearest
level; `outside` tells which.
"""

import sys

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


def outside(model, X):
    """Return which values lie outside the calibrated range. Shape (n, d)."""
    return np.less(X, model["low"]) | np.greater(X, model["high"])


if __name__ == "__main__":
    loaded = dict(np.load(sys.argv[1], allow_pickle=False))
    rows = np.loadtxt(sys.argv[2], delimiter=",", ndmin=2)
    np.savetxt(sys.stdout, predict(loaded, rows), "%.17g", delimiter=",")
