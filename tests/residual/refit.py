"""Held-out errors by one whole fit per fold: what faster ways are compared with."""

import numpy as np

from residual.tables.choose import fit_effect_tables
from residual.tables.crossval import HeldOut, fold_power


def held_out(predict, X, Y, folds, torque) -> HeldOut:
    """Errors of every choice of `predict(X train, Y train, X held)`: (c, m, j)."""
    miss = []
    for fold in range(folds.count):
        out = folds.of_row == fold
        gap = Y[out] - predict(X[~out], Y[~out], X[out])
        miss.append((gap**2).sum(axis=1))
    return HeldOut(folds.scheme, np.stack(miss, axis=1), fold_power(torque, folds))


def nested_errors(X, Y, folds, run, torque, form) -> HeldOut:
    """Errors of no correction and of the default form, chosen on training rows only."""
    miss = []
    for fold in range(folds.count):
        out = folds.of_row == fold
        chosen = fit_effect_tables(X[~out], Y[~out], run[~out], torque[~out], form)
        gap = Y[out] - chosen.lookup.predict(X[out][:, : len(chosen.lookup.names)])
        miss.append([(Y[out] ** 2).sum(axis=0), (gap**2).sum(axis=0)])
    miss = np.array(miss).transpose(1, 0, 2)
    return HeldOut(folds.scheme, miss, fold_power(torque, folds))
