"""The look of the pictures that Matplotlib draws for --plot."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

INK, SOFT, GRID = "#222222", "#5c6670", "#e3e7ea"
_STYLE: dict[Any, Any] = {
    # Names of logs and columns are text, never formulas.
    "text.parse_math": False,
    "font.size": 9.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": SOFT,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    # A fixed place for titles: finding a free one costs a sixth of the whole page.
    "axes.titley": 1.0,
    "xtick.color": SOFT,
    "ytick.color": SOFT,
    "legend.frameon": False,
    "lines.solid_joinstyle": "round",
    "path.simplify_threshold": 0.3,
}


@contextmanager
def figure_style() -> Iterator[None]:
    """Apply the report's style while a figure is made and saved."""
    with matplotlib.rc_context(_STYLE):
        yield


def blank(width: float, height: float) -> Figure:
    """Return an empty figure of that size [inch]."""
    return Figure(figsize=(width, height), facecolor="white", layout=None)


def rule(axes: Axes) -> None:
    """Draw pale lines at the values of the vertical axis."""
    axes.grid(axis="y", color=GRID, linewidth=0.8)
