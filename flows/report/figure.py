"""The look of every figure, and its curves in few bytes.

A figure is a plain mapping with ``data`` and ``layout`` as plotly's schema has them
(https://plotly.com/python/reference/); the script of the page draws it.
"""

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np

Array = np.ndarray

_BIN_COUNTS = (24, 48, 96, 192)
_LEAST_IN_BIN = 8


def envelope(t: Array, y: Array, buckets: int = 450) -> tuple[Array, Array]:
    """Return a curve thinned to the two extremes of each bucket, so no peak is lost."""
    if len(t) <= 2 * buckets:
        return t, y
    size = -(-len(t) // buckets)
    # The last bucket is filled up with the last sample.
    blocks = np.pad(y, (0, -len(y) % size), mode="edge").reshape(-1, size)
    starts = np.arange(len(blocks)) * size
    picks = [starts + blocks.argmin(1), starts + blocks.argmax(1), [0, len(t) - 1]]
    rows = np.unique(np.minimum(np.concatenate(picks), len(t) - 1))
    return t[rows], y[rows]


def spans(t: Array, flags: Array) -> list[tuple[float, float]]:
    """Return (start, length) of each stretch of time where the flag is set."""
    ends = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    last = len(t) - 1
    return [
        (float(t[a]), float(t[min(b, last)] - t[a]))
        for a, b in zip(ends[::2], ends[1::2], strict=True)
    ]


def draw(count: int, most: int) -> Array:
    """Return at most so many row numbers, drawn without a pattern, always the same.

    Every k-th row would beat with periodic motion and show shapes that are not there.
    """
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))


def _bins(x: Array, edges: Array) -> Array:
    """Number of the bin of each x. Shape (n,)."""
    return np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)


def edges(x: Array, fitted: Array) -> Array:
    """Return bin edges fine enough for the fitted effect, with one at zero.

    A ripple of many periods needs narrow bins and a trend wide ones: the first count
    in whose bins the effect is nearly flat is taken. The edge at zero keeps the two
    sides of a friction step apart.
    """
    low, high = float(x.min()), float(x.max())
    if high <= low:
        return np.array([low - 0.5, low + 0.5])
    for count in _BIN_COUNTS:
        bounds = np.linspace(low, high, count + 1)
        if low < 0 < high:
            bounds[np.argmin(np.abs(bounds[1:-1])) + 1] = 0.0
        bins = _bins(x, bounds)
        sizes = np.maximum(np.bincount(bins, minlength=count), 1)
        means = np.bincount(bins, fitted, count) / sizes
        within = np.mean((fitted - means[bins]) ** 2)
        if len(x) < _LEAST_IN_BIN * count or within <= 0.1 * fitted.var():
            break
    return bounds


def medians(x: Array, y: Array, edges: Array) -> tuple[Array, Array]:
    """Return the medians of x and y in each bin of x that is not thin."""
    bins = _bins(x, edges)
    groups = [np.flatnonzero(bins == i) for i in range(len(edges) - 1)]
    groups = [rows for rows in groups if len(rows) >= _LEAST_IN_BIN]
    pairs = [(np.median(x[rows]), np.median(y[rows])) for rows in groups]
    return tuple(np.array(pairs).reshape(-1, 2).T)


# Okabe and Ito's palette (https://jfly.uni-koeln.de/color/): distinct in every
# common color blindness; of it those that stand out on white.
MEASURED, EXPLAINED = "#1d2429", "#0072b2"
STAGES = {"nominal": "#6f7780", "identified": "#d55e00", "augmented": EXPLAINED}
STAGES["plsr"] = "#009e73"
SAMPLES, SOFT, GRID, STANDING = "#8b959e", "#56606a", "#e3e7ea", "#eef1f3"
JOINTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#1d2429", "#e69f00", "#56b4e9")
LABELS = {
    "nominal": "nominal",
    "identified": "identified (refit)",
    "augmented": "augmented (with findings)",
    "plsr": "augmented, and tables of the residual",
}
_FONT = "system-ui, -apple-system, 'Segoe UI', 'Helvetica Neue', Arial, sans-serif"
_GAP = 5.0  # median steps of time: over more no line is drawn

Trace = dict[str, Any]
Plot = dict[str, Any]


def packed(values: Array) -> dict[str, str]:
    """Return values as plotly reads them: four bytes each, as base64."""
    code = base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()
    return {"dtype": "f4", "bdata": code}


def over_time(t: Array, y: Array, most: int) -> Trace:
    """Return a curve over time, thinned to about so many points, broken at gaps.

    Args:
        t: Time [s]. Shape (n,).
        y: Its values. Shape (n,).
        most: Number of points.
    """
    steps = np.diff(t)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1 if len(steps) else []
    xs, ys = [], []
    for rows in np.split(np.arange(len(t)), gaps):
        x, values = envelope(t[rows], y[rows], max(8, most * len(rows) // (2 * len(t))))
        xs += [x, [x[-1]]]
        ys += [values, [np.nan]]
    return {"x": packed(np.concatenate(xs)), "y": packed(np.concatenate(ys))}


def line(name: str, color: str, width: float = 1.5, **more: Any) -> Trace:
    """Return the style of a line, without its points."""
    style = {"color": color, "width": width, **more.pop("line", {})}
    return {"type": "scatter", "mode": "lines", "name": name, "line": style, **more}


def dots(name: str, x: Array, y: Array, **marker: Any) -> Trace:
    """Return points, drawn as marks."""
    place = {"x": packed(x), "y": packed(y), "marker": marker}
    return {"type": "scatter", "mode": "markers", "name": name} | place


def axis(title: str, **more: Any) -> dict[str, Any]:
    """Return an axis with its title, which has the unit."""
    return {
        "title": {"text": title, "standoff": 6},
        "gridcolor": GRID,
        "zeroline": False,
        "automargin": True,
        "ticks": "outside",
        "ticklen": 4,
        "tickcolor": GRID,
        **more,
    }


def layout(title: str, x: Mapping, y: Mapping, **more: Any) -> dict[str, Any]:
    """Return the layout that all figures have."""
    return {
        "title": {
            "text": escape(title),
            "x": 0,
            "xanchor": "left",
            "xref": "paper",
            "font": {"size": 14},
            "yref": "container",
            "y": 1,
            "yanchor": "top",
            "pad": {"t": 6},
        },
        "font": {"family": _FONT, "size": 12, "color": MEASURED},
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "margin": {"l": 56, "r": 12, "t": 58, "b": 44},
        "legend": {
            "orientation": "h",
            "x": 0,
            "xanchor": "left",
            "y": 1,
            "yanchor": "bottom",
            "yref": "paper",
            "font": {"size": 11},
        },
        "hovermode": "closest",
        "xaxis": dict(x),
        "yaxis": dict(y),
        **more,
    }


def escape(text: str) -> str:
    """Return text in which plotly sees no markup."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
