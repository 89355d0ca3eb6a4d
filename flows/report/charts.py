"""The figures of a diagnosis, each with a caption and a text alternative."""

from collections.abc import Sequence

import numpy as np

from flows.report import figure
from flows.report.document import Chart
from flows.report.tables import METRICS, ErrorRow, error_rows, has_error
from flows.report.words.phrases import effect_named, listing, noun
from residual.model.compare import Cloud, LogProof
from residual.quantity import bare_percent, fraction, is_number, percent
from residual.verdict.result import STAGES, Diagnosis

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


def error_chart(diagnosis: Diagnosis) -> Chart | None:
    """Return bars of the held-out error of each joint, while it moves."""
    rows = [row for row in error_rows(diagnosis) if row.joint is not None]
    metric = next((m for m in METRICS if has_error(rows, m, "identified")), None)
    if metric is None:
        return None
    stages = [s for s in _stages(diagnosis) if has_error(rows, metric, s)]
    errors = {s: [row.values[metric].get(s) for row in rows] for s in stages}
    # A nominal model far off is cut, so that the refits show.
    largest = {s: max(filter(is_number, v), default=0.0) for s, v in errors.items()}
    refits = [v for stage, v in largest.items() if stage != "nominal"]
    top = max(min(max(largest.values()), _CLIP * max(refits)), 1e-6)
    names = [f"J{row.joint}" for row in rows]
    data = [
        {
            "type": "bar",
            "name": figure.LABELS[stage],
            "x": names,
            "y": [round(min(v, top), 4) if is_number(v) else None for v in values],
            "text": [
                f"{bare_percent(v)}{' ↑' if v > top else ''}" if is_number(v) else ""
                for v in values
            ],
            "textposition": "outside",
            "cliponaxis": False,
            "textangle": 0,
            "hovertemplate": "%{x}: %{text} %<extra></extra>",
            "marker": {"color": figure.STAGES[stage]},
        }
        for stage, values in errors.items()
    ]
    shapes = []
    if is_number(diagnosis.unexplained.noise_floor):
        floor = 100 * diagnosis.unexplained.noise_floor
        dash = {"color": figure.MEASURED, "width": 1.2, "dash": "dash"}
        data.append(figure.line("noise alone", figure.MEASURED, 1.2, line=dash))
        data[-1] |= {"x": names[:1], "y": [floor], "hoverinfo": "skip"}
        ends = {"xref": "paper", "x0": 0, "x1": 1, "y0": floor, "y1": floor}
        shapes.append({"type": "line", "line": dash, **ends})
    y = figure.axis("error (% of torque)", range=[0, 1.12 * top], fixedrange=True)
    x = figure.axis("", fixedrange=True)
    more = {"barmode": "group", "bargap": 0.25, "shapes": shapes}
    more["margin"] = {"l": 56, "r": 12, "t": 58, "b": 28}
    more["uniformtext"] = {"minsize": 9, "mode": "hide"}
    title = f"Error on unseen motion, {METRICS[metric]}"
    alt = f"Bars of the {title[0].lower()}{title[1:]}: " + "; ".join(
        f"joint {row.joint} {percent(row.values[metric].get(stages[-1]))}"
        for row in rows
    )
    plot = {"data": data, "layout": figure.layout(title, x, y, **more)}
    return Chart("", alt, plot=plot, height=270)


def finding_charts(diagnosis: Diagnosis) -> list[list[Chart]]:
    """Return the figures of each finding: residual over the variable of the effect."""
    usable = [c for c in diagnosis.clouds if len(c.x) > 1]
    charts = [_cloud_chart(c, len(usable), diagnosis) for c in usable]
    out = []
    for finding in diagnosis.effects:
        own_charts = [chart for chart in charts if chart.name == finding.name]
        # Two findings of one effect differ by their joints.
        if effect_named(finding.name).variable is not None and finding.joints:
            own_charts = [
                c for c in own_charts if c.joint in finding.joints
            ] or own_charts
        out.append(own_charts)
    return out


def unexplained_charts(diagnosis: Diagnosis) -> list[Chart]:
    """Return the residual of each flagged joint, over what it depends on most."""
    usable = [c for c in diagnosis.residual_clouds if len(c.x) > 1]
    return [_cloud_chart(c, len(usable), diagnosis) for c in usable]


def _cloud_chart(cloud: Cloud, count: int, diagnosis: Diagnosis) -> Chart:
    """Return the residual over its variable with the effect through it.

    Args:
        count: Such figures on the page, which share its points.
    """
    unit = diagnosis.torque_unit(cloud.joint)
    low, high = cloud.residual.min(), cloud.residual.max()
    over = f"joint {cloud.joint} over {cloud.variable}, {low:.3g} to {high:.3g} {unit}"
    caption, alt = "", f"Unexplained torque of {over}, with medians."
    if cloud.name:
        power = float(np.mean(cloud.residual**2))
        remaining = float(np.mean((cloud.residual - cloud.fitted) ** 2))
        share = fraction(max(0.0, 1 - remaining / power) if power else None)
        caption = f"It explains {share} of the squared residual."
        alt = f"Residual torque of {over}, and {noun(cloud.name)}. {caption}"
    plot = _cloud_plot(cloud, min(_MOST_DOTS, _DOTS // count), unit)
    return Chart("", alt, caption, cloud.joint, cloud.name or None, plot)


def _cloud_plot(cloud: Cloud, most: int, unit: str) -> figure.Plot:
    rows = figure.draw(len(cloud.x), most)
    x, y, fitted = cloud.x[rows], cloud.residual[rows], cloud.fitted[rows]
    data = [figure.dots("measured", x, y, color=figure.SAMPLES, size=3.5, opacity=0.5)]
    if np.ptp(cloud.fitted) > 0:
        data.append(figure.dots("explained", x, fitted, color=figure.EXPLAINED, size=4))
    edges = figure.edges(cloud.x, cloud.fitted)
    edge = {"color": figure.MEASURED, "width": 1.2}
    medians = figure.medians(cloud.x, cloud.residual, edges)
    data.append(figure.dots("median", *medians, size=7, color="#ffffff", line=edge))
    # Limits hold the fitted effect and 99 % of the points.
    low, high = np.quantile(cloud.residual, (0.005, 0.995))
    low, high = min(low, cloud.fitted.min()), max(high, cloud.fitted.max())
    pad = 0.08 * (high - low) or 1.0
    limits = [float(low - pad), float(high + pad)]
    y_axis = figure.axis(f"torque ({unit})", range=limits, zeroline=True)
    y_axis["zerolinecolor"] = figure.SOFT
    # The note of the section explains the marks.
    more = {"showlegend": False, "margin": {"l": 56, "r": 12, "t": 34, "b": 44}}
    variable = cloud.variable.replace("[", "(").replace("]", ")")
    x_axis = figure.axis(figure.escape(variable))
    title = f"Joint {cloud.joint}"
    return {"data": data, "layout": figure.layout(title, x_axis, y_axis, **more)}


def motions(diagnosis: Diagnosis) -> tuple[list[tuple[str, list[Chart]]], int]:
    """Return (label and figures of held-out logs, number of logs not drawn).

    Of many logs those that the model predicts worst are drawn.
    """

    def miss(proof: LogProof) -> float:
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
    named, flagged = diagnosis.effects, diagnosis.unexplained.joints

    def gain(row: ErrorRow) -> tuple[bool, float]:
        before, after = map(row.values["filtered"].get, ("identified", "augmented"))
        value = (
            before - after
            if named and is_number(before) and is_number(after)
            else before
        )
        return not named and row.joint in flagged, value if is_number(value) else 0.0

    rows = [row for row in error_rows(diagnosis) if row.joint]
    ordered = [row.joint for row in sorted(rows, key=gain, reverse=True)]
    return ordered or [*range(1, diagnosis.verdict.dof + 1)]


def _curve_chart(
    proof: LogProof, joint: int, stages: Sequence[str], most: int, unit: str
) -> Chart:
    """Return the torque of a joint over time, and below the residual of each model."""
    tau, size = proof.tau[:, joint - 1], np.linalg.norm(proof.tau[:, joint - 1])
    traces = [figure.line("measured", figure.MEASURED, 2.6)]
    traces[0] |= figure.over_time(proof.t, tau, most)
    errors = []
    # The nominal model on top and dotted: it often lies under the identified one.
    stages = [s for s in stages if s in proof.tau_hat]
    for stage in sorted(stages, key=lambda stage: stage == "nominal"):
        hat = proof.tau_hat[stage][:, joint - 1]
        dotted = {"line": {"dash": "dot"}} if stage == "nominal" else {}
        style = figure.line(figure.LABELS[stage], figure.STAGES[stage], 1.5, **dotted)
        traces.append(style | figure.over_time(proof.t, hat, most))
        if stage != "nominal":
            below = {"yaxis": "y2", "showlegend": False}
            traces.append(style | below | figure.over_time(proof.t, tau - hat, most))
        miss = 100 * np.linalg.norm(tau - hat) / size if size else None
        errors.append(f"{stage} {percent(miss)}")
    text = f"Joint {joint}, error over all samples: {listing(errors)}."
    alt = f"Measured and predicted torque of joint {joint} on log {proof.id}. {text}"
    span = [float(proof.t[0]), float(proof.t[-1])]
    time = figure.axis("time (s)", range=span, anchor="y2")
    upper = figure.axis(f"torque ({unit})", domain=[0.42, 1])
    lower = figure.axis(f"residual ({unit})", domain=[0, 0.34], zeroline=True)
    lower["zerolinecolor"] = figure.SOFT
    # Shaded at standstill: friction history sets its torque there.
    standing = figure.spans(proof.t, ~proof.moving[:, joint - 1])
    same = {"type": "rect", "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    same |= {"fillcolor": figure.STANDING, "line": {"width": 0}}
    shapes = [
        same | {"x0": round(start, 3), "x1": round(start + length, 3)}
        for start, length in sorted(standing, key=lambda band: -band[1])[:_MOST_BANDS]
    ]
    more = {"yaxis2": lower, "shapes": shapes, "hovermode": "x"}
    layout = figure.layout(f"Joint {joint}", time, upper, **more)
    plot = {"data": traces, "layout": layout}
    return Chart("", alt, text, joint, None, plot, 400)
