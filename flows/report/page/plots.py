"""Figures of the report as data addresses: one look, one palette, no global state."""

import base64
import io
import re
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette: told apart with every common colour blindness, and of
# different lightness, so that a grey print can be read as well.
COLOURS = {
    "measured": "#222222",
    "nominal": "#b3b3b3",
    "identified": "#e69f00",
    "augmented": "#0072b2",
    "plsr": "#009e73",
}
LABELS = {
    "nominal": "nominal",
    "identified": "identified (refit)",
    "augmented": "augmented (with the findings)",
    "plsr": "PLSR",
}
INK, SOFT, GRID = "#222222", "#5c6670", "#e3e7ea"

_FONTS = "'Helvetica Neue', Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif"
_STYLE: dict[Any, Any] = {
    "svg.hashsalt": "modelgap",
    "svg.fonttype": "none",
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


def as_uri(figure: Figure) -> str:
    """Return the figure as an SVG data address, the same bytes at every call."""
    buffer = io.StringIO()
    # Without date and with a salt for its ids, the file depends on the data alone.
    figure.savefig(buffer, format="svg", dpi=170, metadata={"Date": None})
    text = re.sub(r"(\.\d\d)\d+", r"\1", buffer.getvalue())
    text = re.sub(r"'DejaVu Sans'(, [^;\"]*)?sans-serif", _FONTS, text)
    code = base64.b64encode(text.encode()).decode("ascii")
    return f"data:image/svg+xml;base64,{code}"
