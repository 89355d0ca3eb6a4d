"""Group fit: the paper form against IKPLS and scikit-learn, and alone on many rows."""

import json
import subprocess
import sys

import numpy as np

from benchmarks.figures import ROOT, Figures, figure, missing, partial
from benchmarks.plsr_parts.rows import (
    dense_columns,
    motion_rows,
    random_rows,
    seconds,
)
from residual.tables.nominal_pls import NominalForm, NominalPls, fit_nominal_pls

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
        [sys.executable, "-m", "benchmarks.plsr_parts.many", "100000"],
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
