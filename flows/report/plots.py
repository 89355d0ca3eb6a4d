"""Plots of a diagnosis: bars of errors, clouds of residuals, spectra."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.signal import welch

from flows.report.figures import look
from flows.report.tables import METRICS, ErrorRow
from residual.model.compare import Cloud, LogProof
from residual.quantity import bare_percent, known

CLOUD_HEIGHT = 290
_MOST_POINTS = 900
_POINTS = 40_000  # of all such figures of a page
_MARKERS = ("circle", "square", "diamond", "triangle-up")


def cloud_plot(cloud: Cloud, many: int = 1) -> look.Plot:
    """Return the residual over its variable with the effect through it.

    Args:
        cloud: What one finding explains on one joint, or what a joint keeps.
        many: Such figures on the page, which share its points.
    """
    most = min(_MOST_POINTS, _POINTS // many)
    rows = look.draw(len(cloud.x), most)
    samples = {
        "type": "scatter",
        "mode": "markers",
        "name": "measured",
        "marker": {"color": look.SAMPLES, "size": 3.5, "opacity": 0.5},
        "x": look.packed(cloud.x[rows]),
        "y": look.packed(cloud.residual[rows]),
    }
    # Of what nothing explains there is no curve.
    fitted = [_fitted(cloud, most)] if np.ptp(cloud.fitted) > 0 else []
    x = look.axis(escaped(cloud.variable))
    y = look.axis("torque (N m)", range=_limits(cloud), zeroline=True)
    y["zerolinecolor"] = look.SOFT
    medians = _medians(cloud)
    # Of one kind of marks the text above says all.
    more = {"showlegend": len(medians) > 1}
    more["margin"] = {"l": 56, "r": 12, "t": 80 if len(medians) > 1 else 34, "b": 44}
    layout = look.layout(f"Joint {cloud.joint}", x, y, **more)
    return {"data": [samples, *fitted, *medians], "layout": layout}


def escaped(variable: str) -> str:
    """Return a variable with its unit in round brackets, as all axes have it."""
    return look.escape(variable.replace("[", "(").replace("]", ")"))


def _fitted(cloud: Cloud, most: int) -> look.Trace:
    order = np.argsort(cloud.x, kind="stable")
    x, y = cloud.x[order], cloud.fitted[order]
    if look.is_curve(x, y):
        at, values = look.envelope(x, y, 200)
        points = {"x": look.packed(at), "y": look.packed(values)}
        return look.line("explained", look.AFTER, 2.6) | points
    # Several values per x, since the effect hangs on more than this one variable.
    rows = look.draw(len(x), most)
    return {
        "type": "scatter",
        "mode": "markers",
        "name": "explained",
        "marker": {"color": look.AFTER, "size": 3},
        "x": look.packed(x[rows]),
        "y": look.packed(y[rows]),
    }


def _medians(cloud: Cloud) -> list[look.Trace]:
    """Return binned medians; one marker per log, since what repeats convinces."""
    at = look.edges(cloud.x, cloud.fitted)
    logs = list(dict.fromkeys(cloud.log.tolist()))
    if not 1 < len(logs) <= len(_MARKERS):
        logs = [None]
    out = []
    for number, (log, marker) in enumerate(zip(logs, _MARKERS, strict=False), 1):
        mine = slice(None) if log is None else cloud.log == log
        bins = look.medians(cloud.x[mine], cloud.residual[mine], at)
        some = np.isfinite(bins.x)
        edge = {"color": look.MEASURED, "width": 1.2}
        out.append(
            {
                "type": "scatter",
                "mode": "markers",
                "name": "median" if log is None else f"median, log {number}",
                "marker": {
                    "symbol": marker,
                    "size": 7,
                    "color": "#ffffff",
                    "line": edge,
                },
                "x": look.packed(bins.x[some]),
                "y": look.packed(bins.median[some]),
            }
        )
    return out


def _limits(cloud: Cloud) -> list[float]:
    """Return limits that hold the fitted effect and 99 % of the points."""
    low, high = np.quantile(cloud.residual, (0.005, 0.995))
    low, high = min(low, cloud.fitted.min()), max(high, cloud.fitted.max())
    pad = 0.08 * (high - low) or 1.0
    return [float(low - pad), float(high + pad)]


SPECTRUM_HEIGHT = 280
_SEGMENT = 8.0  # s of one segment: lines an eighth of a hertz wide
_SHORTEST = 16  # samples of a segment


def spectrum_plot(
    proofs: Sequence[LogProof], joint: int, stages: Sequence[str]
) -> look.Plot | None:
    """Return the amplitude density of the residual of a joint; None of too little.

    Args:
        joint: Joint from 1.
    """
    traces, ceiling = [], 0.0
    for stage in stages:
        found = density(proofs, joint, stage)
        if found is None:
            return None
        f, amplitude = found
        points = {"x": look.packed(f[1:]), "y": look.packed(amplitude[1:])}
        traces.append(look.line(look.LABELS[stage], look.STAGES[stage], 1.6) | points)
        ceiling = max(ceiling, float(amplitude[1:].max()))
    x = look.axis("frequency (Hz)", rangemode="tozero")
    top = np.log10(ceiling) if ceiling > 0 else 0.0
    # Four decades: below is what the low-pass filter left, which tells nothing.
    y = look.axis("residual (N m/√Hz)", type="log", range=[top - 4, top + 0.2])
    y |= {"exponentformat": "power", "dtick": 1}
    layout = look.layout(f"Joint {joint}", x, y, hovermode="x")
    return {"data": traces, "layout": layout}


def density(
    proofs: Sequence[LogProof], joint: int, stage: str
) -> tuple[np.ndarray, np.ndarray] | None:
    """Return frequencies [Hz] and amplitude density [N m/√Hz] of a residual.

    Welch's method (Welch 1967, IEEE Trans. Audio Electroacoust. 15, p. 70): the mean
    periodogram of overlapping Hann windows, here over all stretches without a gap.

    Args:
        joint: Joint from 1.
    """
    stretches = [s for p in proofs for s in _stretches(p, joint, stage)]
    if not stretches:
        return None
    rate = 1 / np.median([step for step, _ in stretches])
    length = min(int(_SEGMENT * rate), max(len(y) for _, y in stretches))
    usable = [y for _, y in stretches if len(y) >= length]
    if length < _SHORTEST:
        return None
    powers = [welch(y, rate, nperseg=length) for y in usable]
    weights = [len(y) for y in usable]
    power = np.average([p for _, p in powers], axis=0, weights=weights)
    return powers[0][0], np.sqrt(power)


def _stretches(proof: LogProof, joint: int, stage: str):
    """Yield step [s] and residual of every stretch of a log without a gap."""
    steps = np.diff(proof.t)
    if not len(steps):
        return
    step = float(np.median(steps))
    left = proof.tau[:, joint - 1] - proof.tau_hat[stage][:, joint - 1]
    for part in np.split(left, np.flatnonzero(steps > 1.5 * step) + 1):
        yield step, part


BARS_HEIGHT = 270
_CLIP = 2.2


def bars_plot(
    joints: Sequence[ErrorRow], metric: str, stages: Sequence[str], floor: float | None
) -> look.Plot:
    """Return bars per joint as given, after the refit and with the findings.

    Args:
        joints: Errors of the joints [%].
        floor: Noise [%]; None where it is not known.
    """
    top = _top([row.values[metric] for row in joints], stages)
    names = [f"J{row.joint}" for row in joints]
    data = [
        _bars(names, [row.values[metric].get(stage) for row in joints], stage, top)
        for stage in stages
    ]
    shapes = []
    if known(floor):
        dash = {"color": look.MEASURED, "width": 1.2, "dash": "dash"}
        data.append(look.line("noise alone", look.MEASURED, 1.2, line=dash))
        data[-1] |= {"x": names[:1], "y": [floor], "hoverinfo": "skip"}
        ends = {"xref": "paper", "x0": 0, "x1": 1, "y0": floor, "y1": floor}
        shapes.append({"type": "line", "line": dash, **ends})
    y = look.axis("error (% of torque)", range=[0, 1.12 * top], fixedrange=True)
    x = look.axis("", fixedrange=True)
    more = {"barmode": "group", "bargap": 0.25, "shapes": shapes}
    more["margin"] = {"l": 56, "r": 12, "t": 58, "b": 28}
    more["uniformtext"] = {"minsize": 9, "mode": "hide"}
    title = f"Held-out error, {METRICS[metric]}"
    return {"data": data, "layout": look.layout(title, x, y, **more)}


def _bars(names: list[str], values: list, stage: str, top: float) -> look.Trace:
    heights = [round(min(v, top), 4) if known(v) else None for v in values]
    texts = [
        f"{bare_percent(v)}{' ↑' if v > top else ''}" if known(v) else ""
        for v in values
    ]
    return {
        "type": "bar",
        "name": look.LABELS[stage],
        "x": names,
        "y": heights,
        "text": texts,
        "textposition": "outside",
        "cliponaxis": False,
        "textangle": 0,
        "hovertemplate": "%{x}: %{text} %<extra></extra>",
        "marker": {"color": look.STAGES[stage]},
    }


def _top(values: Sequence[Mapping], stages: Sequence[str]) -> float:
    """Return the axis limit; a nominal model far off is cut, so the rest shows."""
    found = {s: [v[s] for v in values if known(v.get(s))] for s in stages}
    rest = [v for s, listed in found.items() if s != "nominal" for v in listed]
    everything = [v for listed in found.values() for v in listed]
    most = max(everything, default=1.0)
    return max(min(most, _CLIP * max(rest, default=most)), 1e-6)


TORQUE_HEIGHT = 400
_MOST_BANDS = 80


def torque_plot(proof: LogProof, joint: int, stages: Sequence[str], most: int):
    """Return measured and predicted torque of a joint, and below what each leaves.

    Args:
        joint: Joint from 1.
    """
    column = joint - 1
    t, tau = proof.t, proof.tau[:, column]
    style = look.line("measured", look.MEASURED, 2.6)
    traces = [style | look.over_time(t, tau, most)]
    for stage in _nominal_last(stages):
        hat = proof.tau_hat[stage][:, column]
        traces.append(_style(stage) | look.over_time(t, hat, most))
        if stage != "nominal":
            below = {"yaxis": "y2", "showlegend": False}
            left = look.over_time(t, tau - hat, most)
            traces.append(_style(stage) | below | left)
    return {"data": traces, "layout": _torque_layout(proof, joint)}


def _nominal_last(stages: Sequence[str]) -> list[str]:
    """The nominal model on top and dotted: it often lies under the refitted one."""
    return sorted(stages, key=lambda stage: stage == "nominal")


def _style(stage: str) -> look.Trace:
    colour, label = look.STAGES[stage], look.LABELS[stage]
    if stage == "nominal":
        return look.line(label, colour, 1.6, line={"dash": "dot"})
    return look.line(label, colour, 1.4)


def _torque_layout(proof: LogProof, joint: int) -> dict:
    span = [float(proof.t[0]), float(proof.t[-1])]
    time = look.axis("time (s)", range=span, anchor="y2")
    upper = look.axis("torque (N m)", domain=[0.42, 1])
    lower = look.axis("residual (N m)", domain=[0, 0.34], zeroline=True)
    lower["zerolinecolor"] = look.SOFT
    standing = _bands(proof.t, ~proof.moving[:, joint - 1])
    more = {"yaxis2": lower, "shapes": standing, "hovermode": "x"}
    return look.layout(f"Joint {joint}", time, upper, **more)


def _bands(t: np.ndarray, where: np.ndarray) -> list[dict]:
    """Shade the time where the joint stands: its torque there is set by history."""
    stretches = sorted(look.spans(t, where), key=lambda band: -band[1])
    same = {"type": "rect", "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    same |= {"fillcolor": look.STANDING, "line": {"width": 0}}
    return [
        same | {"x0": round(start, 3), "x1": round(start + length, 3)}
        for start, length in stretches[:_MOST_BANDS]
    ]
