"""Group lookup: rows per second of the exported tables, against a sparse product."""

from itertools import combinations
from time import perf_counter

import numpy as np
from scipy.sparse import csr_matrix

from benchmarks.figures import Figures, figure
from benchmarks.plsr_parts.rows import motion_rows, seconds
from residual.tables.kernels import evaluate_levels, evaluate_row, evaluate_rows
from residual.tables.nominal_pls import (
    NominalForm,
    NominalPls,
    fit_nominal_pls,
    nominal_lookup,
)

_TIMES, _ROWS, _MICROSECONDS = 3.0, 3e6, 5.0
_COUNT = 200_000
_LEVELS = 22


def lookup_figures(rounds: int) -> Figures:
    """Evaluate three joints at new states, against a sparse product.

    Both start from the same codes, and the peer's matrix is made before the clock
    starts: only its product counts. Rows per second are from raw values.
    """
    X, Y = motion_rows(20_000)
    model = fit_nominal_pls(X, Y, NominalForm(_LEVELS))
    new = motion_rows(_COUNT, seed=1)[0]
    packed, levels = nominal_lookup(model).packed, model.levels.encode(new).values
    out = np.empty((len(new), Y.shape[1]))
    evaluate_rows(new[:9], packed, out[:9])
    evaluate_levels(levels[:9], packed, out[:9])
    columns, B = _sparse(levels), model.coefficients()
    rounds_of = [_round(columns, B, levels, new, packed) for _ in range(rounds)]
    ratios, built, rates = (np.array(x) for x in zip(*rounds_of, strict=True))
    scattered = _scattered(model, X, packed)
    evaluate_levels(levels, packed, out)
    gap = float(np.abs(out - (columns @ B + model.offset())).max())
    single = _single(new, packed)
    return {
        "lookup_times_faster_than_csr": _at_least(
            ratios,
            _TIMES,
            with_its_matrix_built=float(np.median(built)),
            random_states=scattered["ratio"],
        ),
        "lookup_rows_per_second": _at_least(
            rates, _ROWS, random_states=scattered["rate"]
        ),
        "lookup_single_row_us": figure(single, _MICROSECONDS, 20_000, what="median"),
        "lookup_against_model": figure(gap, 1e-12 * float(np.abs(out).max()), _COUNT),
    }


def _round(columns, B, levels, new, packed) -> tuple[float, float, float]:
    """Times faster than the product, than matrix and product; rows per second."""
    out = np.empty((len(new), B.shape[1]))
    theirs = seconds(lambda: columns @ B, 3)
    whole = seconds(lambda: _sparse(levels) @ B)
    ours = seconds(lambda: evaluate_levels(levels, packed, out), 3)
    rate = len(new) / seconds(lambda: evaluate_rows(new, packed, out), 3)
    return theirs / ours, whole / ours, rate


def _at_least(values: np.ndarray, bar: float, **extra: object) -> dict:
    middle, ends = float(np.median(values)), [float(values.min()), float(values.max())]
    ok = middle >= bar
    return figure(middle, bar, len(values), ok=ok, at_least=True, range=ends, **extra)


def _scattered(model: NominalPls, X: np.ndarray, packed: tuple) -> dict[str, float]:
    """The same at states drawn one by one: no motion does that, caches do not help."""
    rng = np.random.default_rng(2)
    new = rng.uniform(X.min(axis=0), X.max(axis=0), (_COUNT, X.shape[1]))
    levels, out = model.levels.encode(new).values, np.empty((_COUNT, 3))
    columns, B = _sparse(levels), model.coefficients()
    theirs = seconds(lambda: columns @ B, 5)
    ours = seconds(lambda: evaluate_levels(levels, packed, out), 5)
    rate = _COUNT / seconds(lambda: evaluate_rows(new, packed, out), 5)
    return {"ratio": theirs / ours, "rate": rate}


def _sparse(levels: np.ndarray) -> csr_matrix:
    """The matrix of eq. 30 from levels, all variables with equally many."""
    codes, places = levels.astype(np.int32), []
    pairs = combinations(range(codes.shape[1]), 2)
    for table, (i, j) in enumerate(pairs):
        places.append((table * _LEVELS + codes[:, i]) * _LEVELS + codes[:, j])
    columns = np.stack(places, axis=1)
    ends = np.arange(0, columns.size + 1, columns.shape[1])
    shape = (len(levels), columns.shape[1] * _LEVELS**2)
    return csr_matrix((np.ones(columns.size), columns.ravel(), ends), shape=shape)


def _single(X: np.ndarray, packed: tuple) -> float:
    """Median time of one row through the compiled function, called from Python [us]."""
    out = np.empty(3)
    evaluate_row(X[0], packed, out)
    spent = []
    for x in X[:20_000]:
        start = perf_counter()
        evaluate_row(x, packed, out)
        spent.append(perf_counter() - start)
    return 1e6 * float(np.median(spent))
