"""Figures of the paper's chapter: 4 to 6, 8, 9 and 10, 12, and importance."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from flows.report.page.plots import INK, SOFT, as_uri, blank, figure_style, rule
from residual.calibration.methods import (
    CHOSEN,
    DEFAULT,
    EFFECTS,
    LS,
    NONE,
    PAPER_FORM,
    PLSR,
    WORDS,
)
from residual.calibration.scores import RANDOM, RUN, Score
from residual.calibration.scores import WORDS as SCHEMES
from residual.calibration.views import Sweep, Terms

# Okabe and Ito's palette, as in the other figures.
COLOURS = {
    NONE: "#b3b3b3",
    LS: "#e69f00",
    PLSR: "#f0e442",
    PAPER_FORM: "#cc79a7",
    CHOSEN: "#d55e00",
    DEFAULT: "#0072b2",
    EFFECTS: "#009e73",
}
JOINTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#222222")
_LINES = {RUN: "-", RANDOM: "--"}
_CLIP = 2.2


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
            style = {"color": COLOURS[one.model], "label": WORDS[one.model]}
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
    return max(float(min(max(every), _CLIP * max(rest))), 1e-6)
