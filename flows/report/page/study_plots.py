"""Figures of a blind study: confusion, detection, coverage, errors."""

from collections.abc import Mapping, Sequence
from math import erf, sqrt

import numpy as np
from matplotlib.patches import Rectangle

from flows.blind.score import NOTHING, UNKNOWN
from flows.report.figures.paper import (
    COLOURS,
    INK,
    SOFT,
    as_uri,
    blank,
    figure_style,
    rule,
)

_BLUE, _AMBER, _RED = "#0072b2", "#e69f00", "#d55e00"
# Standard deviations that the curve of coverage is drawn to.
_FAR = 4.0


def confusion_figure(
    counts: Mapping[str, Mapping[str, int]], rows: Sequence[str], columns: Sequence[str]
) -> str:
    """Return the matrix of what was hidden against what was said first.

    Args:
        rows: True effects in order.
        columns: What may be said, in order.
    """
    table = np.array([[counts[r].get(c, 0) for c in columns] for r in rows], float)
    share = table / np.maximum(table.sum(axis=1, keepdims=True), 1)
    with figure_style():
        wide, high = 2.2 + 0.3 * len(columns), 1.9 + 0.25 * len(rows)
        figure = blank(wide, high)
        place = (1.75 / wide, 0.15 / high, 0.3 * len(columns) / wide)
        axes = figure.add_axes((*place, 0.25 * len(rows) / high))
        for i, row in enumerate(rows):
            for k, column in enumerate(columns):
                if table[i, k]:
                    colour = _colour(row, column)
                    alpha = 0.25 + 0.75 * share[i, k]
                    box = {"facecolor": colour, "alpha": alpha, "edgecolor": "none"}
                    axes.add_patch(_square(k, i, **box))
                    ink = "white" if alpha > 0.6 else INK
                    text = f"{table[i, k]:.0f}"
                    axes.text(k, i, text, ha="center", va="center", size=8, color=ink)
        axes.set_xlim(-0.5, len(columns) - 0.5)
        axes.set_ylim(len(rows) - 0.5, -0.5)
        axes.set_xticks(range(len(columns)), [_word(c) for c in columns], rotation=90)
        axes.set_yticks(range(len(rows)), [_word(r) for r in rows])
        axes.tick_params(labelsize=8, length=0, top=True, labeltop=True)
        axes.tick_params(bottom=False, labelbottom=False)
        axes.set_xticks(np.arange(len(columns)) - 0.5, minor=True)
        axes.set_yticks(np.arange(len(rows)) - 0.5, minor=True)
        axes.grid(which="minor", color="#e3e7ea", linewidth=0.6)
        axes.tick_params(which="minor", length=0)
        return as_uri(figure)


def detection_figure(points: Sequence[Mapping]) -> str:
    """Return the share rightly named over the size in minimum detectable ones."""
    with figure_style():
        figure = blank(4.6, 2.8)
        axes = figure.add_axes((0.12, 0.17, 0.86, 0.78))
        rule(axes)
        x = [p["multiple"] for p in points]
        y = np.array([100 * p["value"] for p in points])
        low, high = 100 * np.array([p["interval"] for p in points]).T
        bars = np.maximum([y - low, high - y], 0)
        axes.axhspan(35, 65, 0, 1, color="#f0f2f4", zorder=0)
        axes.errorbar(x, y, bars, color=_BLUE, marker="o", ms=5, lw=1.4, capsize=3)
        for point, at in zip(points, y, strict=True):
            text, place = f"n = {point['n']}", (point["multiple"], at)
            axes.annotate(
                text, place, (5, -12), textcoords="offset points", size=8, color=SOFT
            )
        axes.set_xscale("log")
        axes.set_xticks([1, 3, 5, 10], ["1×", "3×", "5×", "10×"])
        axes.minorticks_off()
        axes.set_xlim(min(x) / 1.15, max(x) * 1.35)
        axes.set_ylim(0, 104)
        axes.set_xlabel("size over the minimum detectable size")
        axes.set_ylabel("rightly named, %")
        return as_uri(figure)


def coverage_figure(z: Sequence[float]) -> str:
    """Return the share of truths within so many standard deviations."""
    sizes = np.sort(np.abs(z))
    with figure_style():
        figure = blank(4.6, 2.8)
        axes = figure.add_axes((0.12, 0.17, 0.86, 0.78))
        rule(axes)
        at = np.linspace(0, _FAR, 161)
        normal = [100 * _within(a) for a in at]
        axes.plot(at, normal, color=SOFT, lw=1, ls=(0, (4, 2)), label="as it should be")
        share = 100 * np.searchsorted(sizes, at, side="right") / len(sizes)
        axes.step(at, share, color=_BLUE, lw=1.6, where="post", label="measured")
        axes.axvline(2, color="#e3e7ea", lw=1)
        axes.set_xlim(0, _FAR)
        axes.set_ylim(0, 104)
        axes.set_xlabel("standard deviations from the truth")
        axes.set_ylabel("estimates within, %")
        axes.legend(loc="lower right", fontsize=8)
        return as_uri(figure)


def errors_figure(rows: Sequence[Mapping]) -> str:
    """Return the held-out error of every case before, refitted and after.

    Args:
        rows: Cases with an oracle; drawn over the oracle's error, which nothing but
            luck gets below.
    """
    styles = {
        "error_before": ("nominal", "nominal", "."),
        "error_refit": ("identified", "refitted", "x"),
        "error_after": ("augmented", "with what was found", "o"),
    }
    with figure_style():
        figure = blank(4.6, 3.6)
        axes = figure.add_axes((0.12, 0.13, 0.86, 0.83))
        rule(axes)
        oracle = np.array([r["error_oracle"] for r in rows], float)
        ends = np.array([oracle.min() * 0.8, oracle.max() * 1.25])
        axes.plot(ends, ends, color=SOFT, lw=1, ls=(0, (4, 2)), label="oracle")
        for key, (colour, label, marker) in styles.items():
            y = np.array([r[key] for r in rows], float)
            style = {"color": COLOURS[colour], "marker": marker, "ls": "none"}
            axes.plot(oracle, y, ms=5, mew=1.2, alpha=0.8, label=label, **style)
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("error with the true effect fitted, %")
        axes.set_ylabel("held-out error, %")
        for axis in (axes.xaxis, axes.yaxis):
            axis.set_major_formatter("{x:g}")
            axis.set_minor_formatter("{x:g}")
        axes.tick_params(which="both", labelsize=7.5)
        axes.legend(loc="upper left", fontsize=8)
        return as_uri(figure)


def _colour(true: str, said: str) -> str:
    """Right, silent, or a false name."""
    unnamed = true.startswith("x_")
    if said == (UNKNOWN if unnamed else true):
        return _BLUE
    return _AMBER if said in (NOTHING, UNKNOWN) else _RED


def _square(x: float, y: float, **style):
    return Rectangle((x - 0.5, y - 0.5), 1, 1, **style)


def _word(name: str) -> str:
    return name.replace("_", " ")


def _within(deviations: float) -> float:
    """Share of a normal distribution within so many standard deviations."""
    return erf(deviations / sqrt(2))
