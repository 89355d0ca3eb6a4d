"""How every figure looks, and its curves in few bytes.

A figure is a plain mapping with ``data`` and ``layout`` as plotly's schema has them
(https://plotly.com/python/reference/); the page's script draws it.
"""

import base64
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

Array = np.ndarray

_BIN_COUNTS = (24, 48, 96, 192)
_LEAST_IN_BIN = 8


class Bins(NamedTuple):
    """Medians of a cloud over bins of its variable; NaN where a bin is thin."""

    x: Array
    median: Array


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


def spans(t: Array, where: Array) -> list[tuple[float, float]]:
    """Return (start, length) of each stretch of time where the flag is set."""
    padded = np.concatenate([[False], where, [False]])
    edges = np.flatnonzero(padded[1:] != padded[:-1])
    last = len(t) - 1
    return [
        (float(t[a]), float(t[min(b, last)] - t[a]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]


def draw(count: int, most: int) -> Array:
    """Return at most so many row numbers, drawn without a pattern, always the same.

    Every k-th row would beat with periodic motion and show shapes that are not there.
    """
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))


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
        found = np.linspace(low, high, count + 1)
        if low < 0 < high:
            found[np.argmin(np.abs(found[1:-1])) + 1] = 0.0
        if len(x) < _LEAST_IN_BIN * count or _within(x, fitted, found) < 0.1:
            break
    return found


def medians(x: Array, y: Array, at: Array) -> Bins:
    """Return the medians of x and y in each bin of x."""
    place = np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(at) - 2)
    order = np.argsort(place, kind="stable")
    groups = np.split(order, np.searchsorted(place[order], np.arange(1, len(at) - 1)))
    rows = np.full((2, len(groups)), np.nan)
    for i, group in enumerate(groups):
        if len(group) >= _LEAST_IN_BIN:
            rows[:, i] = np.median(x[group]), np.median(y[group])
    return Bins(*rows)


def _within(x: Array, fitted: Array, at: Array) -> float:
    """Return the part of the fitted effect's variance that lies inside bins."""
    total = fitted.var()
    if total <= 0:
        return 0.0
    place = np.clip(np.searchsorted(at, x, side="right") - 1, 0, len(at) - 2)
    counts = np.maximum(np.bincount(place, minlength=len(at) - 1), 1)
    means = np.bincount(place, fitted, len(at) - 1) / counts
    return float(np.mean((fitted - means[place]) ** 2) / total)


# Okabe and Ito's palette (https://jfly.uni-koeln.de/color/): told apart with every
# common colour blindness; of it those that stand out on white.
MEASURED, NOMINAL, BEFORE, AFTER = "#1d2429", "#6f7780", "#d55e00", "#0072b2"
STAGES = {"nominal": NOMINAL, "identified": BEFORE, "augmented": AFTER}
STAGES["plsr"] = "#009e73"
SAMPLES, SOFT, GRID, STANDING = "#8b959e", "#56606a", "#e3e7ea", "#eef1f3"
JOINTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#1d2429", "#e69f00", "#56b4e9")
LABELS = {
    "nominal": "nominal (as given)",
    "identified": "before (refitted)",
    "augmented": "after (with the findings)",
    "plsr": "after, and tables of the rest",
}
_FONT = "system-ui, -apple-system, 'Segoe UI', 'Helvetica Neue', Arial, sans-serif"
_GAP = 5.0  # usual steps of time: over more no line is drawn

Trace = dict[str, Any]
Plot = dict[str, Any]


def packed(values: Array) -> dict[str, str]:
    """Return values as the library reads them: four bytes each, as base64."""
    code = base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()
    return {"dtype": "f4", "bdata": code}


def over_time(t: Array, y: Array, most: int) -> Trace:
    """Return a curve over time of at most about so many points, broken at gaps.

    Args:
        t: Time [s]. Shape (n,).
        y: Its values. Shape (n,).
        most: Points: of more the least and the largest of each bin are taken.
    """
    steps = np.diff(t)
    usual = np.median(steps) if len(steps) else 0.0
    cuts = np.flatnonzero(steps > _GAP * usual) + 1
    parts, xs, ys = np.split(np.arange(len(t)), cuts), [], []
    for rows in parts:
        buckets = max(8, most * len(rows) // (2 * len(t)))
        x, values = envelope(t[rows], y[rows], buckets)
        xs += [x, [x[-1]]]
        ys += [values, [np.nan]]
    return {"x": packed(np.concatenate(xs)), "y": packed(np.concatenate(ys))}


def line(name: str, colour: str, width: float = 1.5, **more: Any) -> Trace:
    """Return what a line looks like; its points come beside it."""
    style = {"color": colour, "width": width, **more.pop("line", {})}
    return {"type": "scatter", "mode": "lines", "name": name, "line": style, **more}


def dots(name: str, x: Array, y: Array, marker: Mapping) -> Trace:
    """Return points, drawn as marks."""
    place = {"x": packed(x), "y": packed(y)}
    return (
        {"type": "scatter", "mode": "markers", "name": name}
        | place
        | {"marker": dict(marker)}
    )


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
    """Return text that the library takes for no mark-up of its own."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
