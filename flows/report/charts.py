"""The figures of a diagnosis, each with a caption and words for who cannot see it."""

from collections.abc import Sequence

import numpy as np

from flows.report.document import Chart
from flows.report.figures import look
from flows.report.tables import METRICS, ErrorRow, error_rows, has
from flows.report.words.phrases import effect_named, listing, noun
from residual.diagnosis.result import STAGES, Diagnosis, Finding
from residual.model.compare import Cloud, LogProof
from residual.quantity import bare_percent, fraction, known, percent

# A point of a curve is eleven bytes of the page; so it stays within two megabytes.
_POINTS = 80_000
_MOST_POINTS = 2400
_MOST_DOTS = 900
_DOTS = 40_000  # of all clouds of a page
MOST_LOGS = 6
_MOST_BANDS = 80
_CLIP = 2.2  # times the largest other error: where the bars of the nominal are cut


def error_chart(diagnosis: Diagnosis) -> Chart | None:
    """Return bars of the held-out error of each joint, while it moves."""
    rows = [row for row in error_rows(diagnosis) if row.joint is not None]
    metric = next((m for m in METRICS if has(rows, m, "identified")), None)
    if metric is None:
        return None
    level = diagnosis.unexplained.noise_floor
    stages = [s for s in _stages(diagnosis) if has(rows, metric, s)]
    plot = _bars_plot(rows, metric, stages, 100 * level if known(level) else None)
    alt = f"Bars of the held-out error, {METRICS[metric]}: " + "; ".join(
        f"joint {row.joint} {percent(row.values[metric].get(stages[-1]))}"
        for row in rows
    )
    return Chart("", alt, plot=plot, height=270)


def finding_charts(diagnosis: Diagnosis) -> list[list[Chart]]:
    """Return the figures of each finding: measured over what explains it."""
    usable = [c for c in diagnosis.clouds if len(c.x) > 1]
    charts = [_cloud_chart(c, len(usable), diagnosis) for c in usable]
    return [_clouds_of(charts, effect) for effect in diagnosis.effects]


def left_charts(diagnosis: Diagnosis) -> list[Chart]:
    """Return what each unexplained joint keeps, over what it depends on most."""
    usable = [c for c in diagnosis.left if len(c.x) > 1]
    return [_cloud_chart(c, len(usable), diagnosis) for c in usable]


def motions(diagnosis: Diagnosis) -> tuple[list[tuple[str, list[Chart]]], int]:
    """Return (label and figures of held-out logs, number of logs not drawn).

    The joints that the findings change most come first. Of many logs those that the
    model predicts worst.
    """
    usable = [p for p in diagnosis.proofs if len(p.t) > 1]
    worst = sorted(usable, key=_miss, reverse=True)[:MOST_LOGS]
    kept = [p for p in usable if p in worst]
    stages, joints = _stages(diagnosis), _in_order(diagnosis)
    curves = max(1, len(kept) * len(joints) * 2 * len(stages))
    most = min(_MOST_POINTS, _POINTS // curves)
    drawn = []
    for proof in kept:
        units = map(diagnosis.torque_unit, joints)
        figures = [
            _curve_chart(proof, joint, stages, most, unit)
            for joint, unit in zip(joints, units, strict=True)
        ]
        drawn.append((proof.id, figures))
    return drawn, len(usable) - len(kept)


def _in_order(diagnosis: Diagnosis) -> list[int]:
    """All joints, by how much findings lower their errors.

    Without findings those that stay unexplained come first, then by their errors.
    """
    named, left = diagnosis.effects, diagnosis.unexplained.joints

    def fall(row: ErrorRow) -> tuple[bool, float]:
        before, after = map(row.values["filtered"].get, ("identified", "augmented"))
        lost = before - after if named and known(before) and known(after) else before
        return not named and row.joint in left, lost if known(lost) else 0.0

    rows = [row for row in error_rows(diagnosis) if row.joint]
    by_fall = [row.joint for row in sorted(rows, key=fall, reverse=True)]
    return by_fall or [*range(1, diagnosis.verdict.dof + 1)]


def _clouds_of(charts: Sequence[Chart], finding: Finding) -> list[Chart]:
    """Return the charts of one finding; two of one name differ by their joints."""
    mine = [chart for chart in charts if chart.name == finding.name]
    if effect_named(finding.name).variable is None:
        return mine
    at_home = [c for c in mine if c.joint in finding.joints or not finding.joints]
    return at_home or mine


def _stages(diagnosis: Diagnosis) -> list[str]:
    """Return the models worth drawing: augmented only where something was added."""
    added = bool(diagnosis.effects)
    return [stage for stage in STAGES if added or stage != "augmented"]


def _miss(proof: LogProof) -> float:
    hat = proof.tau_hat.get("augmented", proof.tau_hat.get("identified", proof.tau))
    size = max(float(np.linalg.norm(proof.tau)), 1e-30)
    return float(np.linalg.norm(proof.tau - hat)) / size


# What a finding explains, or a joint keeps, over its variable.


def _cloud_chart(cloud: Cloud, many: int, diagnosis: Diagnosis) -> Chart:
    """Return the residual over its variable with the effect through it.

    Args:
        many: Such figures on the page, which share its points.
    """
    unit = diagnosis.torque_unit(cloud.joint)
    low, high = cloud.residual.min(), cloud.residual.max()
    where = f"joint {cloud.joint} over {cloud.variable}, {low:.3g} to {high:.3g} {unit}"
    if cloud.name:
        whole = float(np.mean(cloud.residual**2))
        left = float(np.mean((cloud.residual - cloud.fitted) ** 2))
        share = fraction(max(0.0, 1 - left / whole) if whole else None)
        text = f"It explains {share} of what was measured there."
        alt = f"Residual torque of {where}; what {noun(cloud.name)} explains. {text}"
    else:
        text, alt = "", f"What stays unexplained of torque of {where}, with medians."
    plot = _cloud_plot(cloud, min(_MOST_DOTS, _DOTS // many), unit)
    return Chart("", alt, text, cloud.joint, cloud.name or None, plot, 290)


def _cloud_plot(cloud: Cloud, most: int, unit: str) -> look.Plot:
    rows = look.draw(len(cloud.x), most)
    x, fitted = cloud.x[rows], cloud.fitted[rows]
    samples = {"color": look.SAMPLES, "size": 3.5, "opacity": 0.5}
    data = [look.dots("measured", x, cloud.residual[rows], samples)]
    # Of what nothing explains there is no curve.
    if np.ptp(cloud.fitted) > 0:
        data.append(look.dots("explained", x, fitted, {"color": look.AFTER, "size": 4}))
    bins = look.medians(cloud.x, cloud.residual, look.edges(cloud.x, cloud.fitted))
    some = np.isfinite(bins.x)
    edge = {"color": look.MEASURED, "width": 1.2}
    white = {"size": 7, "color": "#ffffff", "line": edge}
    data.append(look.dots("median", bins.x[some], bins.median[some], white))
    # As all axes have it, the unit stands in round brackets.
    variable = cloud.variable.replace("[", "(").replace("]", ")")
    y = look.axis(f"torque ({unit})", range=_limits(cloud), zeroline=True)
    y["zerolinecolor"] = look.SOFT
    # The text above says what the marks are.
    more = {"showlegend": False, "margin": {"l": 56, "r": 12, "t": 34, "b": 44}}
    x_axis = look.axis(look.escape(variable))
    return {
        "data": data,
        "layout": look.layout(f"Joint {cloud.joint}", x_axis, y, **more),
    }


def _limits(cloud: Cloud) -> list[float]:
    """Return limits that hold the fitted effect and 99 % of the points."""
    low, high = np.quantile(cloud.residual, (0.005, 0.995))
    low, high = min(low, cloud.fitted.min()), max(high, cloud.fitted.max())
    pad = 0.08 * (high - low) or 1.0
    return [float(low - pad), float(high + pad)]


# Errors, a bar per joint and model.


def _bars_plot(
    rows: Sequence[ErrorRow], metric: str, stages: Sequence[str], floor: float | None
) -> look.Plot:
    top = _top(rows, metric, stages)
    names = [f"J{row.joint}" for row in rows]
    data = [
        _bars(names, [row.values[metric].get(stage) for row in rows], stage, top)
        for stage in stages
    ]
    shapes = []
    if floor is not None:
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


def _top(rows: Sequence[ErrorRow], metric: str, stages: Sequence[str]) -> float:
    """Return the axis limit; a nominal model far off is cut, so the rest shows."""
    values = [(s, row.values[metric].get(s)) for row in rows for s in stages]
    most = max((v for _, v in values if known(v)), default=1.0)
    rest = [v for stage, v in values if known(v) and stage != "nominal"]
    return max(min(most, _CLIP * max(rest, default=most)), 1e-6)


# Torque of a joint over time, and below what each model leaves of it.


def _curve_chart(
    proof: LogProof, joint: int, stages: Sequence[str], most: int, unit: str
) -> Chart:
    column, stages = joint - 1, [s for s in stages if s in proof.tau_hat]
    tau, size = proof.tau[:, column], np.linalg.norm(proof.tau[:, column])
    traces = [look.line("measured", look.MEASURED, 2.6)]
    traces[0] |= look.over_time(proof.t, tau, most)
    errors = []
    # The nominal model on top and dotted: it often lies under the refitted one.
    for stage in sorted(stages, key=lambda stage: stage == "nominal"):
        hat, label = proof.tau_hat[stage][:, column], look.LABELS[stage]
        dotted = {"line": {"dash": "dot"}} if stage == "nominal" else {}
        style = look.line(label, look.STAGES[stage], 1.5, **dotted)
        traces.append(style | look.over_time(proof.t, hat, most))
        if stage != "nominal":
            below = {"yaxis": "y2", "showlegend": False}
            traces.append(style | below | look.over_time(proof.t, tau - hat, most))
        miss = 100 * np.linalg.norm(tau - hat) / size if size else None
        errors.append(f"{label.split(' (')[0]} {percent(miss)}")
    text = f"Joint {joint}, error over the samples shown: {listing(errors)}."
    alt = f"Measured and predicted torque of joint {joint} on log {proof.id}. {text}"
    plot = {"data": traces, "layout": _torque_layout(proof, joint, unit)}
    return Chart("", alt, text, joint, None, plot, 400)


def _torque_layout(proof: LogProof, joint: int, unit: str) -> dict:
    span = [float(proof.t[0]), float(proof.t[-1])]
    time = look.axis("time (s)", range=span, anchor="y2")
    upper = look.axis(f"torque ({unit})", domain=[0.42, 1])
    lower = look.axis(f"residual ({unit})", domain=[0, 0.34], zeroline=True)
    lower["zerolinecolor"] = look.SOFT
    # Shaded where the joint stands: its torque there is set by history.
    standing = look.spans(proof.t, ~proof.moving[:, joint - 1])
    longest = sorted(standing, key=lambda band: -band[1])[:_MOST_BANDS]
    same = {"type": "rect", "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    same |= {"fillcolor": look.STANDING, "line": {"width": 0}}
    shapes = [
        same | {"x0": round(start, 3), "x1": round(start + length, 3)}
        for start, length in longest
    ]
    more = {"yaxis2": lower, "shapes": shapes, "hovermode": "x"}
    return look.layout(f"Joint {joint}", time, upper, **more)
