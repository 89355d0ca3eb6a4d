"""How every figure looks, and its curves in few bytes.

A figure is a plain mapping with ``data`` and ``layout`` as plotly's schema has them
(https://plotly.com/python/reference/); the page's script draws it.
"""

import base64
from collections.abc import Mapping
from typing import Any

import numpy as np

from flows.report.page.drawn import thin

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


def packed(values: np.ndarray) -> dict[str, str]:
    """Return values as the library reads them: four bytes each, as base64."""
    code = base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()
    return {"dtype": "f4", "bdata": code}


def whole(values: np.ndarray) -> dict[str, str]:
    """Return whole numbers from zero on: four bytes each, as base64."""
    code = base64.b64encode(np.asarray(values, "<u4").tobytes()).decode()
    return {"dtype": "u4", "bdata": code}


def over_time(t: np.ndarray, y: np.ndarray, most: int) -> Trace:
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
        x, values = thin.envelope(t[rows], y[rows], buckets)
        xs += [x, [x[-1]]]
        ys += [values, [np.nan]]
    return {"x": packed(np.concatenate(xs)), "y": packed(np.concatenate(ys))}


def line(name: str, colour: str, width: float = 1.5, **more: Any) -> Trace:
    """Return what a line looks like; its points come beside it."""
    style = {"color": colour, "width": width, **more.pop("line", {})}
    return {"type": "scatter", "mode": "lines", "name": name, "line": style, **more}


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
