"""Figures of the paper's chapter: 4 to 6, 8, 9 and 10, 12, importance, PLSR's plane."""

import base64
import io
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from residual.calibration.methods import (
    CHOSEN,
    DEFAULT,
    EFFECTS,
    LS,
    NONE,
    PAPER_FORM,
    PLSR,
    SPARSE,
    WORDS,
)
from residual.calibration.scores import RANDOM, RUN, Score
from residual.calibration.scores import WORDS as SCHEMES
from residual.calibration.views import (
    INPUT,
    WHITE,
    Components,
    Plane,
    Sweep,
    Terms,
    Unseen,
)

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


# Okabe and Ito's palette, as in the other figures.
MODEL_COLOURS = {
    NONE: "#b3b3b3",
    LS: "#e69f00",
    PLSR: "#f0e442",
    PAPER_FORM: "#cc79a7",
    SPARSE: "#56b4e9",
    CHOSEN: "#d55e00",
    DEFAULT: "#0072b2",
    EFFECTS: "#009e73",
}
JOINTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222")
_LINES = {RUN: "-", RANDOM: "--"}
_BAR_CLIP = 2.2


def curve_figure(scores: Sequence[Score], joints: Sequence[int]) -> str:
    """Return RMSEV over the number of components of one model (figure 8)."""
    with figure_style():
        figure = blank(4.6, 3.0)
        axes = figure.add_axes((0.13, 0.15, 0.855, 0.68))
        rule(axes)
        for one in scores:
            for colour, joint, line in zip(JOINTS, joints, one.curve.T, strict=False):
                at = np.arange(len(line))
                label = f"joint {joint}" if one is scores[0] else None
                style = {"color": colour, "lw": 1.4, "label": label}
                axes.plot(at, line, ls=_LINES.get(one.scheme, ":"), **style)
        axes.set_ylim(0)
        most = max(len(one.curve) for one in scores)
        axes.set_xticks(range(0, most, 5 if most > 12 else 1))
        axes.set_xlabel("components")
        axes.set_ylabel("RMSEV, %")
        axes.set_title(WORDS[scores[0].model], loc="left", fontsize=10.5)
        figure.legend(loc="upper right", ncols=4, fontsize=8, borderaxespad=0.3)
        return as_uri(figure)


def bars_figure(scores: Sequence[Score], joints: Sequence[int]) -> str:
    """Return bars of every model under one scheme, joint by joint (figures 9, 10)."""
    top = _bar_limit(scores)
    width = 0.84 / len(scores)
    with figure_style():
        figure = blank(max(6.0, 1.35 * len(joints) + 1.2), 2.6)
        axes = figure.add_axes((0.075, 0.13, 0.915, 0.7))
        for place, one in enumerate(scores):
            at = np.arange(len(joints)) + (place - (len(scores) - 1) / 2) * width
            style = {"color": MODEL_COLOURS[one.model], "label": WORDS[one.model]}
            axes.bar(at, np.minimum(one.rmsev, top), 0.92 * width, **style)
            _numbers(axes, at, one.rmsev, top)
        rule(axes)
        axes.set_ylim(0, 1.12 * top)
        axes.set_xlim(-0.5, len(joints) - 0.5)
        axes.set_xticks(range(len(joints)), [f"joint {j}" for j in joints])
        axes.tick_params(axis="x", length=0, labelcolor=INK)
        axes.set_ylabel("RMSEV, %")
        axes.set_title(SCHEMES[scores[0].scheme], loc="left", fontsize=10.5)
        figure.legend(loc="upper right", ncols=7, fontsize=7.5, borderaxespad=0.2)
        return as_uri(figure)


def sweep_figure(sweep: Sweep, joints: Sequence[int]) -> str:
    """Return RMSEV over levels on unseen runs and random rows, time, memory (12)."""
    with figure_style():
        figure = blank(9.2, 3.0)
        places = {RUN: 0.06, RANDOM: 0.315}
        most = max(float(np.nanmax(e)) for e in sweep.errors.values())
        for name, errors in sweep.errors.items():
            axes = figure.add_axes((places[name], 0.16, 0.205, 0.66))
            rule(axes)
            for colour, joint, line in zip(JOINTS, joints, errors.T, strict=False):
                label = f"joint {joint}" if name == RUN else None
                style = {"color": colour, "lw": 1.4, "marker": "o", "ms": 3}
                axes.plot(sweep.levels, line, label=label, **style)
            axes.set_ylim(0, 1.05 * most)
            axes.set_xlabel("levels")
            axes.set_title(SCHEMES[name], loc="left", fontsize=10)
            if name == RUN:
                axes.set_ylabel("RMSEV, %")
        costs = (
            (sweep.seconds, "time, both schemes, s"),
            (sweep.megabytes, "memory, MB"),
        )
        for place, (values, title) in zip((0.575, 0.815), costs, strict=True):
            axes = figure.add_axes((place, 0.16, 0.175, 0.66))
            rule(axes)
            axes.plot(sweep.levels, values, color=SOFT, lw=1.4, marker="o", ms=3)
            axes.set_ylim(0)
            axes.set_xlabel("levels")
            axes.set_title(title, loc="left", fontsize=10)
        figure.legend(loc="upper right", ncols=7, fontsize=8, borderaxespad=0.2)
        return as_uri(figure)


def importance_figure(terms: Terms, joint: int, column: int, count: int = 10) -> str:
    """Return the largest contributions to one joint, with their standard errors."""
    sizes, errors = terms.sizes.values[:, column], terms.sizes.errors[:, column]
    order = np.argsort(-sizes, kind="stable")[:count][::-1]
    with figure_style():
        figure = blank(4.6, 3.1)
        axes = figure.add_axes((0.24, 0.15, 0.745, 0.74))
        axes.grid(axis="x", color="#e3e7ea", linewidth=0.8)
        sure = terms.sizes.significant[order, column]
        colours = np.where(sure, "#0072b2", "#b3b3b3").tolist()
        axes.barh(range(len(order)), sizes[order], 0.7, color=colours)
        ends = np.maximum(sizes[order] - errors[order], 0), sizes[order] + errors[order]
        axes.hlines(range(len(order)), *ends, color=INK, lw=1)
        axes.set_yticks(range(len(order)), [terms.names[i] for i in order])
        axes.tick_params(axis="y", length=0, labelcolor=INK, labelsize=8.5)
        axes.set_xlabel("contribution, N m rms")
        axes.set_title(f"Joint {joint}", loc="left", fontsize=10.5)
        return as_uri(figure)


def _numbers(axes: Axes, at: np.ndarray, values: np.ndarray, top: float) -> None:
    for x, value in zip(at, values, strict=True):
        if np.isfinite(value):
            text = f"{value:.3g}{' ↑' if value > top else ''}"
            style = {"ha": "center", "va": "bottom", "fontsize": 6.5, "color": INK}
            axes.text(x, min(value, top) + 0.012 * top, text, **style)


def _bar_limit(scores: Sequence[Score]) -> float:
    """Return the axis limit; no compensation may be far off and is cut then."""
    rest = [np.nanmax(s.rmsev) for s in scores if s.model != NONE]
    every = [np.nanmax(s.rmsev) for s in scores]
    return max(float(min(max(every), _BAR_CLIP * max(rest))), 1e-6)


_BLOCKS = {INPUT: "#0072b2", WHITE: "#b3b3b3"}
_CLIP = 1.5  # times no compensation, above which bars are cut


def schemes_figure(scores: Sequence[Score]) -> str:
    """Return all schemes side by side, all joints together (figure 10)."""
    schemes = list(dict.fromkeys(one.scheme for one in scores))
    models = list(dict.fromkeys(one.model for one in scores))
    top = _CLIP * max(one.overall for one in scores if one.model == NONE)
    width = 0.84 / len(models)
    with figure_style():
        figure = blank(max(6.0, 1.7 * len(schemes) + 1.0), 2.9)
        axes = figure.add_axes((0.075, 0.13, 0.915, 0.7))
        rule(axes)
        for one in scores:
            shift = (models.index(one.model) - (len(models) - 1) / 2) * width
            at, height = schemes.index(one.scheme) + shift, min(one.overall, top)
            label = WORDS[one.model] if one.scheme == schemes[0] else None
            axes.bar(
                at, height, 0.92 * width, color=MODEL_COLOURS[one.model], label=label
            )
            text = f"{one.overall:.3g}{' ↑' if one.overall > top else ''}"
            style = {"ha": "center", "va": "bottom", "fontsize": 6.5, "color": INK}
            axes.text(at, height + 0.012 * top, text, **style)
        axes.set_ylim(0, 1.12 * top)
        axes.set_xticks(range(len(schemes)), [SCHEMES[s] for s in schemes], fontsize=8)
        axes.tick_params(axis="x", length=0, labelcolor=INK)
        axes.set_ylabel("RMSEV, all joints, %")
        figure.legend(loc="upper right", ncols=7, fontsize=7.5, borderaxespad=0.2)
        return as_uri(figure)


def over_time_figure(unseen: Unseen, joint: int, column: int) -> str:
    """Return corrections beside the measured residual of one joint (figure 9)."""
    with figure_style():
        figure = blank(9.2, 2.3)
        axes = figure.add_axes((0.07, 0.19, 0.92, 0.64))
        rule(axes)
        left = unseen.left[:, column]
        style = {"color": "#222222", "lw": 1.0, "label": "measured residual"}
        axes.plot(unseen.t, left, **style)
        for name, values in unseen.corrections.items():
            style = {"color": MODEL_COLOURS[name], "lw": 1.0, "label": WORDS[name]}
            axes.plot(unseen.t, values[:, column], **style)
        reach = 1.5 * float(np.abs(left).max()) or 1.0
        axes.set_ylim(-reach, reach)
        axes.set_xlabel("t, s")
        axes.set_ylabel("N m")
        axes.set_title(f"Joint {joint}", loc="left", fontsize=10.5)
        figure.legend(loc="upper right", ncols=6, fontsize=7.5, borderaxespad=0.2)
        return as_uri(figure)


def plane_figure(plane: Plane, labels: Sequence[str]) -> str:
    """Return scores of PLSR by run, and loadings as correlations, side by side."""
    with figure_style():
        figure = blank(9.2, 4.0)
        axes = figure.add_axes((0.07, 0.13, 0.4, 0.76))
        for number, label in enumerate(labels):
            own = plane.scores[plane.run == number]
            style = {"color": JOINTS[number % len(JOINTS)], "label": label[:24]}
            axes.plot(own[:, 0], own[:, 1], ".", ms=2.5, **style)
        axes.set_title("scores", loc="left", fontsize=10.5)
        axes.legend(fontsize=7, markerscale=3, loc="best")
        _titled(axes, plane)
        axes = figure.add_axes((0.57, 0.13, 0.33, 0.76))
        angle = np.linspace(0, 2 * np.pi, 100)
        axes.plot(np.cos(angle), np.sin(angle), color=SOFT, lw=0.8)
        axes.axhline(0, color=SOFT, lw=0.6)
        axes.axvline(0, color=SOFT, lw=0.6)
        for name, (x, y) in zip(plane.names, plane.loadings, strict=True):
            colour = "#d55e00" if name.startswith("residual") else "#0072b2"
            axes.plot(x, y, "o", ms=3.5, color=colour)
            axes.text(x + 0.02, y + 0.02, name, fontsize=7.5, color=INK)
        axes.set_xlim(-1.15, 1.15)
        axes.set_ylim(-1.15, 1.15)
        axes.set_title("loadings, as correlations", loc="left", fontsize=10.5)
        _titled(axes, plane)
        return as_uri(figure)


def components_figure(parts: Sequence[Components]) -> str:
    """Return explained variance of all families side by side (figures 4 to 6)."""
    families = list(dict.fromkeys(part.family for part in parts))
    most = max(float(part.explained.max()) for part in parts)
    room = 0.915 / len(families)
    with figure_style():
        figure = blank(max(4.6, 2.9 * len(families)), 2.9)
        for place, family in enumerate(families):
            left = 0.075 + place * room
            axes = figure.add_axes((left, 0.16, room - 0.02, 0.66))
            rule(axes)
            for part in (one for one in parts if one.family == family):
                label = part.block if place == 0 else None
                _explained(axes, part, label)
            axes.set_ylim(0, 1.05 * most)
            axes.set_xlabel("component")
            axes.set_title(family.replace("_", " "), loc="left", fontsize=10.5)
            if place == 0:
                axes.set_ylabel("explained, %")
                axes.plot([], [], color=SOFT, lw=1, ls=(0, (4, 2)), label="chance")
            else:
                axes.set_yticklabels([])
        figure.legend(loc="upper right", ncols=5, fontsize=8, borderaxespad=0.3)
        return as_uri(figure)


def _explained(axes, part: Components, label: str | None) -> None:
    colour = _BLOCKS.get(part.block, "#d55e00")
    at = np.arange(1, len(part.explained) + 1)
    style = {"color": colour, "marker": "o", "ms": 4, "lw": 1.4}
    axes.plot(at, part.explained, label=label, **style)
    if part.block != WHITE:
        axes.plot(at, part.limit, color=colour, lw=1, ls=(0, (4, 2)))


def _titled(axes, plane: Plane) -> None:
    one, two = plane.explained
    axes.set_xlabel(f"component 1 ({one:.0f} % of the residuals)")
    axes.set_ylabel(f"component 2 ({two:.0f} %)")
