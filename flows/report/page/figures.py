"""The three figures: error bars, torque over time, residual over its variable."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes

from flows.report.page import thin
from flows.report.page.plots import (
    COLOURS,
    INK,
    LABELS,
    SOFT,
    as_uri,
    blank,
    figure_style,
    rule,
)
from flows.report.words.rows import METRICS, ErrorRow
from residual.model.compare import Cloud, LogProof
from residual.quantity import bare_percent, known

_MOST_POINTS = 900
_MARKERS = "os^D"
_CLIP = 2.2


def error_bars(
    joints: Sequence[ErrorRow],
    metric: str,
    stages: Sequence[str],
    floor: Sequence,
) -> str:
    """Return bars per joint before, after the refit and with the findings.

    Args:
        joints: Errors of the joints [%].
        metric: Which error: filtered, moving or held_out.
        stages: Models to draw.
        floor: Noise per joint, or one for all [%]; empty where it is not known.

    Returns:
        The figure as a data address.
    """
    with figure_style():
        figure = blank(max(6.0, 1.25 * len(joints) + 1.2), 2.7)
        axes = figure.add_axes((0.075, 0.15, 0.915, 0.68))
        top = _bar_limit([row.values[metric] for row in joints], stages)
        for place, stage in enumerate(stages):
            _bars(axes, joints, (metric, stage), place - (len(stages) - 1) / 2, top)
        _floor(axes, floor, len(joints))
        rule(axes)
        axes.set_ylim(0, top * 1.1)
        axes.set_xlim(-0.55, len(joints) - 0.45)
        axes.set_xticks(range(len(joints)), [f"joint {row.joint}" for row in joints])
        axes.tick_params(axis="x", length=0, labelcolor=INK)
        axes.set_ylabel("error, %")
        axes.set_title(f"Held-out error, {METRICS[metric]}", loc="left", fontsize=10.5)
        figure.legend(loc="upper right", ncols=5, fontsize=8.5, borderaxespad=0.2)
        return as_uri(figure)


def over_time(proof: LogProof, joint: int, stages: Sequence[str]) -> str:
    """Return torque and predictions of one joint over time, residuals below.

    Args:
        proof: The held-out log.
        joint: Joint from 1.
        stages: Models to draw.

    Returns:
        The figure as a data address.
    """
    column = joint - 1
    tau = proof.tau[:, column]
    with figure_style():
        figure = blank(9.2, 3.5)
        top = figure.add_axes((0.078, 0.42, 0.912, 0.48))
        low = figure.add_axes((0.078, 0.125, 0.912, 0.25), sharex=top)
        top.plot(*thin.envelope(proof.t, tau), color=INK, lw=1.5, label="measured")
        for stage in stages:
            hat = proof.tau_hat[stage][:, column]
            line = {"color": COLOURS[stage], "lw": 0.8 if stage == "nominal" else 1.1}
            top.plot(*thin.envelope(proof.t, hat), label=LABELS[stage], **line)
            if stage != "nominal":
                low.plot(*thin.envelope(proof.t, tau - hat), **line)
        for axes in (top, low):
            rule(axes)
            _shade(axes, proof.t, ~proof.moving[:, column])
        low.axhline(0, color=SOFT, lw=0.8)
        top.tick_params(labelbottom=False)
        top.set_title(f"Joint {joint}, log {proof.id}", loc="left", fontsize=10.5)
        top.set_ylabel("torque, N m")
        low.set_ylabel("residual, N m")
        low.set_xlabel("time, s")
        top.set_xlim(proof.t[0], proof.t[-1])
        figure.align_ylabels([top, low])
        figure.legend(loc="upper right", ncols=5, fontsize=8.5, borderaxespad=0.2)
        return as_uri(figure)


def over_variable(cloud: Cloud) -> str:
    """Return the residual over its variable with the fitted effect through it.

    Args:
        cloud: What one finding explains on one joint, or what a joint keeps.

    Returns:
        The figure as a data address.
    """
    rows = thin.draw(len(cloud.x), _MOST_POINTS)
    with figure_style():
        figure = blank(4.6, 3.1)
        axes = figure.add_axes((0.155, 0.15, 0.83, 0.735))
        rule(axes)
        axes.axhline(0, color=SOFT, lw=0.8)
        # Drawn as pixels: a thousand vector points would be most of the page.
        axes.plot(
            *(cloud.x[rows], cloud.residual[rows], "o"),
            **{"ms": 2.4, "mew": 0, "color": "#9aa4ad", "alpha": 0.55},
            rasterized=True,
        )
        # Of what nothing explains there is no curve.
        if np.ptp(cloud.fitted) > 0:
            _fitted(axes, cloud)
        _medians(axes, cloud)
        axes.set_ylim(*_cloud_limits(cloud))
        axes.set_xlabel(cloud.variable)
        axes.set_ylabel("torque, N m")
        axes.set_title(f"Joint {cloud.joint}", loc="left", fontsize=10.5)
        figure.legend(loc="upper right", ncols=4, fontsize=8, borderaxespad=0.3)
        return as_uri(figure)


def _bars(
    axes: Axes, rows: Sequence[ErrorRow], key: tuple, shift: float, top: float
) -> None:
    metric, stage = key
    values = [row.values[metric].get(stage) for row in rows]
    heights = [min(v, top) if known(v) else 0.0 for v in values]
    at = np.arange(len(rows)) + 0.27 * shift
    colour = COLOURS[stage]
    axes.bar(at, heights, 0.25, color=colour, label=LABELS[stage].split(" ")[0])
    for x, height, value in zip(at, heights, values, strict=True):
        if not known(value):
            continue
        text = f"{bare_percent(value)}{' ↑' if value > top else ''}"
        if value > top:
            # A break across the bar: its length is not its value.
            ends = [x - 0.14, x + 0.14], [0.9 * top, 0.94 * top]
            axes.plot(*ends, color="white", lw=2.5)
        style = {"ha": "center", "va": "bottom", "fontsize": 7.5, "color": INK}
        axes.text(x, height + 0.012 * top, text, **style)


def _bar_limit(values: Sequence[Mapping], stages: Sequence[str]) -> float:
    """Return the axis limit; a nominal model far off is cut, so the rest shows."""
    found = {s: [v[s] for v in values if known(v.get(s))] for s in stages}
    rest = [v for s, listed in found.items() if s != "nominal" for v in listed]
    everything = [v for listed in found.values() for v in listed]
    most = max(everything, default=1.0)
    return max(min(most, _CLIP * max(rest, default=most)), 1e-6)


def _floor(axes: Axes, floor: Sequence, dof: int) -> None:
    levels = [level if known(level) else np.nan for level in floor]
    if len(levels) == 1:
        levels *= dof
    if len(levels) != dof or np.isnan(levels).all():
        return
    at = np.arange(dof)
    axes.hlines(levels, at - 0.46, at + 0.46, color=INK, lw=1.1, ls=(0, (4, 2)))
    axes.plot([], [], color=INK, lw=1.1, ls=(0, (4, 2)), label="noise floor")


def _shade(axes: Axes, t: np.ndarray, where: np.ndarray) -> None:
    """Shade the time where the joint stands: its torque there is set by history."""
    stretches = thin.spans(t, where)
    if stretches:
        style = {"facecolor": "#eef1f3", "lw": 0, "zorder": 0}
        axes.broken_barh(
            stretches, (0, 1), transform=axes.get_xaxis_transform(), **style
        )


def _fitted(axes: Axes, cloud: Cloud) -> None:
    colour = COLOURS["augmented"]
    order = np.argsort(cloud.x, kind="stable")
    x, y = cloud.x[order], cloud.fitted[order]
    if thin.is_curve(x, y):
        axes.plot(*thin.envelope(x, y, 400), color=colour, lw=2.2, label="fitted")
        return
    # Several values per x, since the effect hangs on more than this one variable.
    rows = thin.draw(len(x), _MOST_POINTS)
    style = {"ms": 2.2, "mew": 0, "color": colour, "label": "fitted"}
    axes.plot(x[rows], y[rows], "o", rasterized=True, **style)


def _medians(axes: Axes, cloud: Cloud) -> None:
    """Draw binned medians; one marker per log, since what repeats convinces."""
    at = thin.edges(cloud.x, cloud.fitted)
    logs = list(dict.fromkeys(cloud.log.tolist()))
    if not 1 < len(logs) <= len(_MARKERS):
        logs = [None]
    for log, marker in zip(logs, _MARKERS, strict=False):
        mine = slice(None) if log is None else cloud.log == log
        bins = thin.medians(cloud.x[mine], cloud.residual[mine], at)
        style = {"ms": 4.2, "mfc": "white", "mec": INK, "mew": 0.9, "ls": "none"}
        style["label"] = "median" if log is None else f"median {str(log)[:12]}"
        axes.plot(bins.x, bins.median, marker=marker, **style)
        if log is None:
            axes.vlines(bins.x, bins.low, bins.high, color=INK, lw=0.6, zorder=1.9)


def _cloud_limits(cloud: Cloud) -> tuple[float, float]:
    """Return limits that hold the fitted effect and 99 % of the points."""
    low, high = np.quantile(cloud.residual, (0.005, 0.995))
    low, high = min(low, cloud.fitted.min()), max(high, cloud.fitted.max())
    pad = 0.08 * (high - low) or 1.0
    return float(low - pad), float(high + pad)
