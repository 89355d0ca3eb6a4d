"""The figures of a diagnosis, each with a caption and a text alternative, and its page."""

import base64
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from flows.report import Chart, Pairs
from flows.report.diagnosis import DiagnosisFigures, build_diagnosis_document
from flows.report.page import render_html
from flows.report.phrases import HiddenEffect, find_effect, format_effect_noun, join_with_and
from flows.report.tables import METRICS, list_errors, list_metrics
from residual.model.compare import FindingScatter, LogPrediction
from residual.quantity import format_fraction, format_percent, format_percent_number, is_number
from residual.verdict.result import STAGES, Diagnosis

Array = np.ndarray

_BIN_COUNTS = (24, 48, 96, 192)
_LEAST_IN_BIN = 8


def thin_to_extremes(t: Array, y: Array, buckets: int = 450) -> tuple[Array, Array]:
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


def find_flagged_spans(t: Array, flags: Array) -> list[tuple[float, float]]:
    """Return (start, length) of each stretch of time where the flag is set."""
    ends = np.flatnonzero(np.diff(flags, prepend=False, append=False))
    last = len(t) - 1
    return [
        (float(t[a]), float(t[min(b, last)] - t[a]))
        for a, b in zip(ends[::2], ends[1::2], strict=True)
    ]


def sample_rows(count: int, most: int) -> Array:
    """Return at most a number of rows, drawn at random with a fixed seed.

    Every k-th row would beat with periodic motion and show shapes that are not there.
    """
    if count <= most:
        return np.arange(count)
    return np.sort(np.random.default_rng(0).choice(count, most, replace=False))


def _bins(x: Array, edges: Array) -> Array:
    """Number of the bin of each x. Shape (n,)."""
    return np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)


def choose_bin_edges(x: Array, fitted: Array) -> Array:
    """Return bin edges fine enough for the fitted effect, with one at zero.

    A ripple of many periods needs narrow bins and a trend wide ones: the first count
    in whose bins the effect is nearly flat is taken. The edge at zero keeps the two
    sides of a friction step apart.
    """
    low, high = float(x.min()), float(x.max())
    if high <= low:
        return np.array([low - 0.5, low + 0.5])
    for count in _BIN_COUNTS:
        bounds = np.linspace(low, high, count + 1)
        if low < 0 < high:
            bounds[np.argmin(np.abs(bounds[1:-1])) + 1] = 0.0
        bins = _bins(x, bounds)
        sizes = np.maximum(np.bincount(bins, minlength=count), 1)
        means = np.bincount(bins, fitted, count) / sizes
        within = np.mean((fitted - means[bins]) ** 2)
        if len(x) < _LEAST_IN_BIN * count or within <= 0.1 * fitted.var():
            break
    return bounds


def compute_bin_medians(x: Array, y: Array, edges: Array) -> tuple[Array, Array]:
    """Return the medians of x and y in each bin of x that is not thin."""
    bins = _bins(x, edges)
    groups = [np.flatnonzero(bins == i) for i in range(len(edges) - 1)]
    groups = [rows for rows in groups if len(rows) >= _LEAST_IN_BIN]
    pairs = [(np.median(x[rows]), np.median(y[rows])) for rows in groups]
    return tuple(np.array(pairs).reshape(-1, 2).T)


# Okabe and Ito's palette (https://jfly.uni-koeln.de/color/): distinct in every
# common color blindness; of it those that stand out on white.
MEASURED, EXPLAINED = "#1d2429", "#0072b2"
COLORS = {"nominal": "#6f7780", "identified": "#d55e00", "augmented": EXPLAINED}
COLORS["plsr"] = "#009e73"
SAMPLES, SOFT, STANDING = "#8b959e", "#56606a", "#eef1f3"
JOINTS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#1d2429", "#e69f00", "#56b4e9")
LABELS = {
    "nominal": "nominal",
    "identified": "identified (refit)",
    "augmented": "augmented (with findings)",
    "plsr": "augmented, and tables of the residual",
}
# The common layout of all figures, for plotly.
_STYLE = json.loads((Path(__file__).parent / "templates" / "figure.json").read_text("utf-8"))
_GAP = 5.0  # median steps of time: over more no line is drawn

Trace = dict[str, Any]
Plot = dict[str, Any]


def encode_values(values: Array) -> dict[str, str]:
    """Return values as plotly reads them: four bytes each, as base64."""
    code = base64.b64encode(np.asarray(values, "<f4").tobytes()).decode()
    return {"dtype": "f4", "bdata": code}


def build_time_trace(t: Array, y: Array, most: int) -> Trace:
    """Return a curve over time, thinned to about `most` points, broken at gaps.

    Args:
        t: Time [s]. Shape (n,).
        y: Its values. Shape (n,).
        most: Number of points.
    """
    steps = np.diff(t)
    gaps = np.flatnonzero(steps > _GAP * np.median(steps)) + 1 if len(steps) else []
    xs, ys = [], []
    for rows in np.split(np.arange(len(t)), gaps):
        x, values = thin_to_extremes(t[rows], y[rows], max(8, most * len(rows) // (2 * len(t))))
        xs += [x, [x[-1]]]
        ys += [values, [np.nan]]
    return {"x": encode_values(np.concatenate(xs)), "y": encode_values(np.concatenate(ys))}


def line_style(name: str, color: str, width: float = 1.5, **more: Any) -> Trace:
    """Return the style of a line, without its points."""
    style = {"color": color, "width": width, **more.pop("line", {})}
    return {"type": "scatter", "mode": "lines", "name": name, "line": style, **more}


def build_marker_trace(name: str, x: Array, y: Array, **marker: Any) -> Trace:
    """Return points, drawn as marks."""
    place = {"x": encode_values(x), "y": encode_values(y), "marker": marker}
    return {"type": "scatter", "mode": "markers", "name": name} | place


def build_axis(title: str, **more: Any) -> dict[str, Any]:
    """Return an axis with its title, which has the unit."""
    return {"title": {"text": title, "standoff": 6}, **_STYLE["axis"], **more}


def build_layout(title: str, x: Mapping, y: Mapping, **more: Any) -> dict[str, Any]:
    """Return the layout that all figures have."""
    named = {"text": escape_plotly_markup(title), **_STYLE["title"]}
    return {"title": named, **_STYLE["layout"], "xaxis": dict(x), "yaxis": dict(y), **more}


def escape_plotly_markup(text: str) -> str:
    """Return text in which plotly sees no markup."""
    return text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")


# A point of a curve is eleven bytes of the page, which stays within two megabytes.
_POINTS = 80_000
_MOST_POINTS = 2400
_MOST_DOTS = 900
_DOTS = 40_000  # of all clouds of a page
MOST_LOGS = 6
_MOST_BANDS = 80
_CLIP = 2.2  # times the largest other error: where the bars of the nominal are cut


def _stages(diagnosis: Diagnosis) -> list[str]:
    """Return the models worth drawing: augmented only where something was added."""
    added = bool(diagnosis.effects)
    return [stage for stage in STAGES if added or stage != "augmented"]


def chart_errors(diagnosis: Diagnosis) -> Chart | None:
    """Return bars of the held-out error of each joint, while it moves."""
    joints = range(1, diagnosis.verdict.dof + 1)
    metrics = list_metrics(diagnosis.verdict)
    known = list_errors(diagnosis.verdict, metrics[0]) if metrics else {}
    errors = {s: known[s][:-1] for s in _stages(diagnosis) if s in known}
    if not any(map(is_number, errors.get("identified", ()))):
        return None
    # A nominal model far off is cut, so that the refits show.
    largest = {s: max(filter(is_number, v), default=0.0) for s, v in errors.items()}
    refits = [v for stage, v in largest.items() if stage != "nominal"]
    top = max(min(max(largest.values()), _CLIP * max(refits)), 1e-6)
    names = [f"J{joint}" for joint in joints]
    data = [
        {
            "type": "bar",
            "name": LABELS[stage],
            "x": names,
            "y": [round(min(v, top), 4) if is_number(v) else None for v in values],
            "text": [
                f"{format_percent_number(v)}{' ↑' if v > top else ''}" if is_number(v) else ""
                for v in values
            ],
            "textposition": "outside",
            "cliponaxis": False,
            "textangle": 0,
            "hovertemplate": "%{x}: %{text} %<extra></extra>",
            "marker": {"color": COLORS[stage]},
        }
        for stage, values in errors.items()
    ]
    shapes = []
    if is_number(diagnosis.unexplained.noise_floor):
        floor = 100 * diagnosis.unexplained.noise_floor
        dash = {"color": MEASURED, "width": 1.2, "dash": "dash"}
        data.append(line_style("noise alone", MEASURED, 1.2, line=dash))
        data[-1] |= {"x": names[:1], "y": [floor], "hoverinfo": "skip"}
        ends = {"xref": "paper", "x0": 0, "x1": 1, "y0": floor, "y1": floor}
        shapes.append({"type": "line", "line": dash, **ends})
    y = build_axis("error (% of torque)", range=[0, 1.12 * top], fixedrange=True)
    x = build_axis("", fixedrange=True)
    more = {"barmode": "group", "bargap": 0.25, "shapes": shapes}
    more["margin"] = {"l": 56, "r": 12, "t": 58, "b": 28}
    more["uniformtext"] = {"minsize": 9, "mode": "hide"}
    title = f"Error on unseen motion, {METRICS[metrics[0]]}"
    last = [*errors.values()][-1]
    alt = f"Bars of the {title[0].lower()}{title[1:]}: " + "; ".join(
        f"joint {joint} {format_percent(error)}" for joint, error in zip(joints, last, strict=True)
    )
    plot = {"data": data, "layout": build_layout(title, x, y, **more)}
    return Chart(alt, plot=plot, height=270)


def chart_clouds(clouds: Sequence[FindingScatter], diagnosis: Diagnosis) -> list[Chart]:
    """Return the residual of each cloud over its variable."""
    usable = [c for c in clouds if len(c.x) > 1]
    return [_cloud_chart(c, len(usable), diagnosis) for c in usable]


def chart_findings(diagnosis: Diagnosis) -> list[list[Chart]]:
    """Return the figures of each finding: residual over the variable of the effect."""
    charts, out = chart_clouds(diagnosis.clouds, diagnosis), []
    for finding in diagnosis.effects:
        drawn = [chart for chart in charts if chart.name == finding.name]
        # Two findings of one effect differ by their joints.
        if find_effect(finding.name).variable is not None and finding.joints:
            drawn = [c for c in drawn if c.joint in finding.joints] or drawn
        out.append(drawn)
    return out


def _cloud_chart(cloud: FindingScatter, count: int, diagnosis: Diagnosis) -> Chart:
    """Return the residual over its variable with the effect; `count` figures share the points."""
    unit = diagnosis.torque_unit(cloud.joint)
    low, high = cloud.residual.min(), cloud.residual.max()
    over = f"joint {cloud.joint} over {cloud.variable}, {low:.3g} to {high:.3g} {unit}"
    caption, alt = "", f"Unexplained torque of {over}, with medians."
    if cloud.name:
        power = float(np.mean(cloud.residual**2))
        remaining = float(np.mean((cloud.residual - cloud.fitted) ** 2))
        share = format_fraction(max(0.0, 1 - remaining / power) if power else None)
        caption = f"It explains {share} of the squared residual."
        alt = f"Residual torque of {over}, and {format_effect_noun(cloud.name)}. {caption}"
    plot = _cloud_plot(cloud, min(_MOST_DOTS, _DOTS // count), unit)
    return Chart(alt, caption, cloud.joint, cloud.name or None, plot)


def _cloud_plot(cloud: FindingScatter, most: int, unit: str) -> Plot:
    rows = sample_rows(len(cloud.x), most)
    x, y, fitted = cloud.x[rows], cloud.residual[rows], cloud.fitted[rows]
    data = [build_marker_trace("measured", x, y, color=SAMPLES, size=3.5, opacity=0.5)]
    if np.ptp(cloud.fitted) > 0:
        data.append(build_marker_trace("explained", x, fitted, color=EXPLAINED, size=4))
    middles = compute_bin_medians(cloud.x, cloud.residual, choose_bin_edges(cloud.x, cloud.fitted))
    edge = {"color": MEASURED, "width": 1.2}
    data.append(build_marker_trace("median", *middles, size=7, color="#ffffff", line=edge))
    # Limits hold the fitted effect and 99 % of the points.
    low, high = np.quantile(cloud.residual, (0.005, 0.995))
    low, high = min(low, cloud.fitted.min()), max(high, cloud.fitted.max())
    pad = 0.08 * (high - low) or 1.0
    limits = [float(low - pad), float(high + pad)]
    y_axis = build_axis(f"torque ({unit})", range=limits, zeroline=True)
    y_axis["zerolinecolor"] = SOFT
    # The note of the section explains the marks.
    more = {"showlegend": False, "margin": {"l": 56, "r": 12, "t": 34, "b": 44}}
    variable = cloud.variable.replace("[", "(").replace("]", ")")
    x_axis = build_axis(escape_plotly_markup(variable))
    title = f"Joint {cloud.joint}"
    return {"data": data, "layout": build_layout(title, x_axis, y_axis, **more)}


def chart_held_out_motions(diagnosis: Diagnosis) -> tuple[list[tuple[str, list[Chart]]], int]:
    """Return (label and figures of held-out logs, number of logs not drawn).

    Of many logs those that the model predicts worst are drawn.
    """

    def miss(proof: LogPrediction) -> float:
        hat = proof.tau_hat.get("augmented", proof.tau_hat.get("identified", proof.tau))
        size = max(float(np.linalg.norm(proof.tau)), 1e-30)
        return float(np.linalg.norm(proof.tau - hat)) / size

    usable = [p for p in diagnosis.proofs if len(p.t) > 1]
    worst = sorted(usable, key=miss, reverse=True)[:MOST_LOGS]
    kept = [p for p in usable if p in worst]
    stages, joints = _stages(diagnosis), _by_gain(diagnosis)
    curves = max(1, len(kept) * len(joints) * 2 * len(stages))
    most = min(_MOST_POINTS, _POINTS // curves)
    drawn = [
        (
            proof.id,
            [
                _curve_chart(proof, joint, stages, most, diagnosis.torque_unit(joint))
                for joint in joints
            ],
        )
        for proof in kept
    ]
    return drawn, len(usable) - len(kept)


def _by_gain(diagnosis: Diagnosis) -> list[int]:
    """All joints, by how much findings lower their errors.

    Without findings flagged joints come first, then by their errors.
    """
    named, errors = diagnosis.effects, list_errors(diagnosis.verdict, "filtered")

    def gain(joint: int) -> tuple[bool, float]:
        old, new = (
            errors[stage][joint - 1] if stage in errors else None
            for stage in ("identified", "augmented")
        )
        value = old - new if named and is_number(old) and is_number(new) else old
        flagged = not named and joint in diagnosis.unexplained.joints
        return flagged, value if is_number(value) else 0.0

    return sorted(range(1, diagnosis.verdict.dof + 1), key=gain, reverse=True)


def _curve_chart(
    proof: LogPrediction, joint: int, stages: Sequence[str], most: int, unit: str
) -> Chart:
    """Return the torque of a joint over time, and below the residual of each model."""
    tau, size = proof.tau[:, joint - 1], np.linalg.norm(proof.tau[:, joint - 1])
    traces = [line_style("measured", MEASURED, 2.6)]
    traces[0] |= build_time_trace(proof.t, tau, most)
    errors = []
    # The nominal model on top and dotted: it often lies under the identified one.
    stages = [s for s in stages if s in proof.tau_hat]
    for stage in sorted(stages, key=lambda stage: stage == "nominal"):
        hat = proof.tau_hat[stage][:, joint - 1]
        dotted = {"line": {"dash": "dot"}} if stage == "nominal" else {}
        style = line_style(LABELS[stage], COLORS[stage], 1.5, **dotted)
        traces.append(style | build_time_trace(proof.t, hat, most))
        if stage != "nominal":
            below = {"yaxis": "y2", "showlegend": False}
            traces.append(style | below | build_time_trace(proof.t, tau - hat, most))
        miss = 100 * np.linalg.norm(tau - hat) / size if size else None
        errors.append(f"{stage} {format_percent(miss)}")
    text = f"Joint {joint}, error over all samples: {join_with_and(errors)}."
    alt = f"Measured and predicted torque of joint {joint} on log {proof.id}. {text}"
    span = [float(proof.t[0]), float(proof.t[-1])]
    time = build_axis("time (s)", range=span, anchor="y2")
    upper = build_axis(f"torque ({unit})", domain=[0.42, 1])
    lower = build_axis(f"residual ({unit})", domain=[0, 0.34], zeroline=True)
    lower["zerolinecolor"] = SOFT
    # Shaded at standstill: friction history sets its torque there.
    standing = find_flagged_spans(proof.t, ~proof.moving[:, joint - 1])
    same = {"type": "rect", "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    same |= {"fillcolor": STANDING, "line": {"width": 0}}
    shapes = [
        same | {"x0": round(start, 3), "x1": round(start + length, 3)}
        for start, length in sorted(standing, key=lambda band: -band[1])[:_MOST_BANDS]
    ]
    more = {"yaxis2": lower, "shapes": shapes, "hovermode": "x"}
    titled = build_layout(f"Joint {joint}", time, upper, **more)
    plot = {"data": traces, "layout": titled}
    return Chart(alt, text, joint, None, plot, 400)


def render_diagnosis_page(
    result: Diagnosis,
    robot: str,
    hidden: Sequence[HiddenEffect] | None = None,
    origin: Pairs = (),
    records: Sequence[str] = (),
) -> str:
    """Return the report page: one HTML document, the same bytes every time."""
    figures = DiagnosisFigures(
        chart_errors(result),
        chart_findings(result),
        *chart_held_out_motions(result),
        chart_clouds(result.residual_clouds, result),
    )
    document = build_diagnosis_document(result, robot, hidden, origin, records, figures)
    return render_html(document)
