"""Figures of a calibration that show it in one view: schemes, time, components."""

from collections.abc import Sequence

import numpy as np

from flows.report.page.calibration_plots import COLOURS, JOINTS
from flows.report.page.plots import INK, SOFT, as_uri, blank, figure_style, rule
from residual.calibration.methods import NONE, WORDS
from residual.calibration.scores import WORDS as SCHEMES
from residual.calibration.scores import Score
from residual.calibration.views import INPUT, WHITE, Components, Plane, Unseen

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
            axes.bar(at, height, 0.92 * width, color=COLOURS[one.model], label=label)
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
            style = {"color": COLOURS[name], "lw": 1.0, "label": WORDS[name]}
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
