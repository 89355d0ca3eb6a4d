"""Fit, sweep and look-up of the paper form against IKPLS, scikit-learn and products.

The sweep takes levels 2 to 40 under three schemes, all component counts (figure 12).
"""

import json
import subprocess
import sys
from itertools import combinations
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.sparse import csr_matrix

from benchmarks.harness.figures import Figures, figure, missing, partial
from benchmarks.harness.origin import ROOT
from benchmarks.harness.rates import cpu
from residual.calibration.crossval import leave_one_out, random_blocks, systematic
from residual.calibration.nominal_pls import NominalForm, NominalPls, fit_nominal_pls
from residual.model.lookup_kernels import (
    evaluate_levels,
    evaluate_row,
    evaluate_rows,
)

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
    return min(cpu(job) for _ in range(times))


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


_IKPLS, _SKLEARN, _EQUAL = 40.0, 500.0, 1e-9
_SECONDS, _GIGABYTES, _EXPONENT = 1.5, 1.0, 1.1
_FORM = NominalForm()  # 22 levels, 15 components


def fit_figures(quick: bool) -> Figures:
    """Fit 22 levels of 9 variables with 15 components."""
    warm()
    return {
        **_against_ikpls(1 if quick else 3),
        **_against_sklearn(),
        **_many_rows(),
        **_exponent(quick),
    }


def warm() -> None:
    """Compile before the clock starts."""
    fit_nominal_pls(*motion_rows(500), _FORM)


def _against_ikpls(times: int) -> Figures:
    try:
        from ikpls.numpy import PLS
    except ImportError as error:
        why = f"ikpls is not installed: {error}"
        return {
            "fit_times_faster_than_ikpls_4000": missing(_IKPLS, why),
            "coefficients_against_ikpls": missing(_EQUAL, why),
        }
    X, Y = motion_rows(4000)
    ours = seconds(lambda: fit_nominal_pls(X, Y, _FORM), 7)
    model = fit_nominal_pls(X, Y, _FORM)
    columns = dense_columns(model, X)
    peer = PLS(scale_X=False, scale_Y=False)
    theirs = seconds(lambda: peer.fit(columns, Y, _FORM.components), times)
    gap = _gap(model, np.asarray(peer.B)[-1])
    return {
        "fit_times_faster_than_ikpls_4000": _at_least(
            theirs / ours, _IKPLS, times, ours=ours, peer=theirs
        ),
        "coefficients_against_ikpls": figure(gap, _EQUAL, 1, rows=4000),
    }


def _against_sklearn() -> Figures:
    from sklearn.cross_decomposition import PLSRegression

    X, Y = motion_rows(1000)
    ours = seconds(lambda: fit_nominal_pls(X, Y, _FORM), 7)
    columns = dense_columns(fit_nominal_pls(X, Y, _FORM), X)
    # Its default tolerance: the one that would give our digits takes even longer.
    peer = PLSRegression(_FORM.components, scale=False)
    theirs = seconds(lambda: peer.fit(columns, Y))
    name = "fit_times_faster_than_sklearn_1000"
    return {name: _at_least(theirs / ours, _SKLEARN, 1, ours=ours, peer=theirs)}


def _gap(model: NominalPls, theirs: np.ndarray) -> float:
    return float(np.abs(model.coefficients() - theirs).max() / np.abs(theirs).max())


def _many_rows() -> Figures:
    """Time and peak memory of 100 000 rows, in a process of its own."""
    done = subprocess.run(
        [sys.executable, "-c", f"from {__name__} import many; many(100_000)"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    names = ("fit_seconds_100000", "fit_peak_gb_100000")
    if done.returncode:
        why = done.stderr.strip()[-200:]
        return {n: {**missing(None, why), "ok": False} for n in names}
    told = json.loads(done.stdout.splitlines()[-1])
    return {
        names[0]: figure(told["seconds"], _SECONDS, 3),
        names[1]: figure(told["gigabytes"], _GIGABYTES, 1, what="whole process"),
    }


def many(rows: int) -> None:
    """Fit many rows and print seconds and peak memory of this process as JSON.

    Not getrusage(): a process starts with the peak of the one that started it, which
    here has just held the columns of the peers.
    """
    warm()
    X, Y = random_rows(rows)
    spent = seconds(lambda: fit_nominal_pls(X, Y, NominalForm()), 3)
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    peak = next(int(x.split()[1]) / 1e6 for x in lines if x.startswith("VmHWM"))
    print(json.dumps({"seconds": spent, "gigabytes": peak}))


def _exponent(quick: bool) -> Figures:
    sizes = (20_000, 100_000, 300_000 if quick else 1_000_000)
    spent = []
    for rows in sizes:
        X, Y = random_rows(rows)
        times = 1 if rows == sizes[-1] else 3
        spent.append(seconds(lambda X=X, Y=Y: fit_nominal_pls(X, Y, _FORM), times))
    slope = np.log(spent[-1] / spent[0]) / np.log(sizes[-1] / sizes[0])
    told = dict(zip(map(str, sizes), spent, strict=True))
    entry = figure(float(slope), _EXPONENT, len(sizes), seconds=told)
    return {"cost_exponent": partial(entry, "up to 300 000 rows") if quick else entry}


def _at_least(value: float, bar: float, n: int, **extra: object) -> dict:
    return figure(value, bar, n, ok=bool(value >= bar), at_least=True, **extra)


_SWEEP = 60.0
_SWEPT = range(2, 41)
_MOST = 15


def sweep_figures(quick: bool) -> Figures:
    """Validate every number of levels on 20 000 rows; the quick run every sixth."""
    X, Y, run = repeated_rows()
    n = len(X)
    schemes = [
        leave_one_out(run),
        systematic(n),
        random_blocks(n, np.random.default_rng(1)),
    ]
    tried = _SWEPT[::6] if quick else _SWEPT
    _validate(X[:4000:9], Y[:4000:9], [systematic(445)], _swept(3))

    def sweep() -> None:
        for levels in tried:
            _validate(X, Y, schemes, _swept(levels))

    spent = seconds(sweep)
    whole = spent * len(_SWEPT) / len(tried)
    entry = figure(whole, _SWEEP, len(tried), rows=n, measured=spent)
    if quick:
        entry = partial(entry, f"scaled up from {len(tried)} of {len(_SWEPT)} levels")
    return {"sweep_seconds": entry}


def _validate(X, Y, schemes, form: NominalForm) -> list[np.ndarray]:
    """Squared errors on held-out rows, of every number of components. (A + 1, j)."""
    out = []
    for folds in schemes:
        miss = 0.0
        for fold in range(folds.count):
            held = folds.of_row == fold
            model = fit_nominal_pls(X[~held], Y[~held], form)
            T, left = model.transform(X[held]), Y[held] - model.y_mean
            errors = [(left**2).sum(axis=0)]
            for t, q in zip(T.T, model.Q, strict=True):
                left = left - np.outer(t, q)
                errors.append((left**2).sum(axis=0))
            miss = miss + np.array(errors)
        out.append(miss)
    return out


def _swept(levels: int) -> NominalForm:
    # Two levels of nine variables have 45 dimensions: enough for 15 components.
    return NominalForm(levels, _MOST)


_FASTER, _ROWS, _MICROSECONDS = 3.0, 3e6, 5.0
_STATES = 200_000
_LEVELS = 22


def lookup_figures(quick: bool) -> Figures:
    """Evaluate three joints at new states, against a sparse product.

    Both start from the same codes, and the peer's matrix is made before the clock
    starts: only its product counts. Rows per second are from raw values.
    """
    rounds = 3 if quick else 9
    X, Y = motion_rows(20_000)
    model = fit_nominal_pls(X, Y, NominalForm(_LEVELS))
    new = motion_rows(_STATES, seed=1)[0]
    packed, levels = model.lookup().packed, model.levels.encode(new).values
    out = np.empty((len(new), Y.shape[1]))
    evaluate_rows(new[:9], packed, out[:9])
    evaluate_levels(levels[:9], packed, out[:9])
    columns, B = _sparse_columns(levels), model.coefficients()
    rounds_of = [_one_round(columns, B, levels, new, packed) for _ in range(rounds)]
    ratios, built, rates = (np.array(x) for x in zip(*rounds_of, strict=True))
    scattered = _scattered(model, X, packed)
    evaluate_levels(levels, packed, out)
    gap = float(np.abs(out - (columns @ B + model.offset())).max())
    single = _single(new, packed)
    return {
        "lookup_times_faster_than_csr": _middle(
            ratios,
            _FASTER,
            with_its_matrix_built=float(np.median(built)),
            random_states=scattered["ratio"],
        ),
        "lookup_rows_per_second": _middle(
            rates, _ROWS, random_states=scattered["rate"]
        ),
        "lookup_single_row_us": figure(single, _MICROSECONDS, 20_000, what="median"),
        "lookup_against_model": figure(gap, 1e-12 * float(np.abs(out).max()), _STATES),
    }


def _one_round(columns, B, levels, new, packed) -> tuple[float, float, float]:
    """Times faster than the product, than matrix and product; rows per second."""
    out = np.empty((len(new), B.shape[1]))
    theirs = seconds(lambda: columns @ B, 3)
    whole = seconds(lambda: _sparse_columns(levels) @ B)
    ours = seconds(lambda: evaluate_levels(levels, packed, out), 3)
    rate = len(new) / seconds(lambda: evaluate_rows(new, packed, out), 3)
    return theirs / ours, whole / ours, rate


def _middle(values: np.ndarray, bar: float, **extra: object) -> dict:
    middle, ends = float(np.median(values)), [float(values.min()), float(values.max())]
    ok = middle >= bar
    return figure(middle, bar, len(values), ok=ok, at_least=True, range=ends, **extra)


def _scattered(model: NominalPls, X: np.ndarray, packed: tuple) -> dict[str, float]:
    """The same at states drawn one by one: no motion does that, caches do not help."""
    rng = np.random.default_rng(2)
    new = rng.uniform(X.min(axis=0), X.max(axis=0), (_STATES, X.shape[1]))
    levels, out = model.levels.encode(new).values, np.empty((_STATES, 3))
    columns, B = _sparse_columns(levels), model.coefficients()
    theirs = seconds(lambda: columns @ B, 5)
    ours = seconds(lambda: evaluate_levels(levels, packed, out), 5)
    rate = _STATES / seconds(lambda: evaluate_rows(new, packed, out), 5)
    return {"ratio": theirs / ours, "rate": rate}


def _sparse_columns(levels: np.ndarray) -> csr_matrix:
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
