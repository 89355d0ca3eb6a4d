"""The figures of a diagnosis, each with a caption and words for who cannot see it."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace

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
MOST_LOGS = 6
CLOUD_HEIGHT, SPECTRUM_HEIGHT, BARS_HEIGHT, TORQUE_HEIGHT = 290, 280, 270, 400


def error_charts(diagnosis: Diagnosis) -> list[Chart]:
    """Return bars of the held-out error: while moving, and over all samples."""
    joints = [row for row in error_rows(diagnosis) if row.joint is not None]
    level = diagnosis.unexplained.noise_floor
    floor = 100 * level if known(level) else None
    # As logged, the picture is that of the filtered error: the table is enough.
    metrics = [m for m in ("moving", "filtered") if has(joints, m, "identified")]
    metrics = metrics or [m for m in METRICS if has(joints, m, "identified")]
    charts = []
    for metric in metrics:
        stages = [s for s in _stages(diagnosis) if has(joints, metric, s)]
        plot = bars_plot(joints, metric, stages, floor)
        alt = _bars_alt(joints, metric, stages)
        charts.append(Chart("", alt, "", plot=plot, height=BARS_HEIGHT))
    return charts


def finding_charts(diagnosis: Diagnosis) -> list[list[Chart]]:
    """Return the figures of each finding: measured over what explains it."""
    usable = [c for c in diagnosis.clouds if len(c.x) > 1]
    charts = [_in_units(_cloud_chart(c, len(usable)), diagnosis) for c in usable]
    return [_clouds_of(charts, effect) for effect in diagnosis.effects]


def left_charts(diagnosis: Diagnosis) -> list[Chart]:
    """Return what each unexplained joint keeps, over what it depends on most."""
    usable = [c for c in diagnosis.left if len(c.x) > 1]
    return [_in_units(_left_chart(c, len(usable)), diagnosis) for c in usable]


def motions(diagnosis: Diagnosis) -> tuple[list[tuple[str, list[Chart]]], int]:
    """Return (label and figures of held-out logs, number of logs not drawn).

    The joints that the findings concern come first. Of many logs those that the model
    predicts worst.
    """
    usable = [p for p in diagnosis.proofs if len(p.t) > 1]
    kept = sorted(usable, key=_miss, reverse=True)[:MOST_LOGS]
    kept = [p for p in usable if p in kept]
    stages, joints = _stages(diagnosis), _in_order(diagnosis)
    curves = max(1, len(kept) * len(joints) * 2 * len(stages))
    most = min(_MOST_POINTS, _POINTS // curves)
    drawn = [
        (
            proof.id,
            [
                _in_units(_curve_chart(proof, j, stages, most), diagnosis)
                for j in joints
            ],
        )
        for proof in kept
    ]
    return drawn, len(usable) - len(kept)


def _in_units(chart: Chart, diagnosis: Diagnosis) -> Chart:
    """Return a chart of one joint with what it is driven by in its own unit."""
    unit = diagnosis.torque_unit(chart.joint) if chart.joint else "N m"
    if unit == "N m":
        return chart

    document = json.dumps([chart.alt, chart.caption, (chart.plot or {}).get("layout")])
    alt, caption, layout = json.loads(document.replace("N m", unit))
    plot = chart.plot and {**chart.plot, "layout": layout}
    return replace(chart, alt=alt, caption=caption, plot=plot)


def _in_order(diagnosis: Diagnosis) -> list[int]:
    """All joints, those that are concerned first."""
    dof = diagnosis.verdict.dof
    focus = [j for j in concerned(diagnosis) if j <= dof]
    return [*focus, *(j for j in range(1, dof + 1) if j not in focus)]


def spectrum_charts(diagnosis: Diagnosis) -> tuple[list[Chart], list[Chart]]:
    """Return spectra of the residual (of the joints concerned, of the others)."""
    focus = concerned(diagnosis)
    usable = [p for p in diagnosis.proofs if len(p.t) > 1]
    stages = [s for s in _stages(diagnosis) if s not in ("nominal", "plsr")]
    drawn = [_spectrum_chart(usable, j, stages) for j in _in_order(diagnosis)]
    charts = [_in_units(chart, diagnosis) for chart in drawn if chart]
    first = [chart for chart in charts if chart.joint in focus]
    return first, [chart for chart in charts if chart.joint not in focus]


def concerned(diagnosis: Diagnosis) -> list[int]:
    """Return the joints whose curves are shown first, the most telling one first.

    Those of the findings; of an effect on the whole arm, the two it changes most;
    then those that stay unexplained; failing all that the worst one.
    """
    named = diagnosis.effects
    whole = [f for f in named if effect_named(f.name).scope == "flange" or not f.joints]
    joints = [j for f in named if f not in whole for j in f.joints]
    joints += _most_changed(diagnosis) if whole else []
    joints += diagnosis.unexplained.joints
    return list(dict.fromkeys(joints)) or _worst(diagnosis)


def _clouds_of(charts: Sequence[Chart], finding: Finding) -> list[Chart]:
    """Return the charts of one finding; two of one name differ by their joints."""
    mine = [chart for chart in charts if chart.name == finding.name]
    if effect_named(finding.name).variable is None:
        return mine
    at_home = [c for c in mine if c.joint in finding.joints or not finding.joints]
    return at_home or mine


def _most_changed(diagnosis: Diagnosis) -> list[int]:
    falls = []
    for row in error_rows(diagnosis):
        before, after = map(row.values["filtered"].get, ("identified", "augmented"))
        if row.joint and known(before) and known(after):
            falls.append((after - before, row.joint))
    return [joint for fall, joint in sorted(falls)[:2] if fall < 0]


def _worst(diagnosis: Diagnosis) -> list[int]:
    errors = [
        (row.values["filtered"].get("identified"), row.joint)
        for row in error_rows(diagnosis)
        if row.joint and known(row.values["filtered"].get("identified"))
    ]
    return [max(errors)[1]] if errors else [1]


def _stages(diagnosis: Diagnosis) -> list[str]:
    """Return the models worth drawing: augmented only where something was added."""
    added = bool(diagnosis.effects)
    return [stage for stage in STAGES if added or stage != "augmented"]


def _miss(proof: LogProof) -> float:
    hat = proof.tau_hat.get("augmented", proof.tau_hat.get("identified", proof.tau))
    return float(np.linalg.norm(proof.tau - hat)) / max(
        float(np.linalg.norm(proof.tau)), 1e-30
    )


def _bars_alt(rows: Sequence[ErrorRow], metric: str, stages: Sequence[str]) -> str:
    parts = []
    for row in rows:
        shown = [
            f"{stage} {percent(row.values[metric].get(stage))}"
            for stage in stages
            if known(row.values[metric].get(stage))
        ]
        parts.append(f"Joint {row.joint}: {', '.join(shown) or 'not known'}.")
    return f"Bars of the held-out error, {METRICS[metric]}. {' '.join(parts)}"


def _cloud_chart(shown: Cloud, many: int) -> Chart:
    logs = len(set(shown.log.tolist()))
    share = fraction(_explained_share(shown))
    text = f"It explains {share} of what was measured there."
    alt = (
        f"Residual torque of joint {shown.joint} over {shown.variable}, "
        f"{logs} log{'' if logs == 1 else 's'}, with medians in bins and what "
        f"{noun(shown.name)} explains. The residual spans {_span(shown.residual)}, "
        f"what is explained {_span(shown.fitted)}. {text}"
    )
    plot = cloud_plot(shown, many)
    return Chart("", alt, text, shown.joint, shown.name, plot, CLOUD_HEIGHT)


def _left_chart(shown: Cloud, many: int) -> Chart:
    alt = (
        f"What stays unexplained of the torque of joint {shown.joint} over "
        f"{shown.variable}, with medians in bins. It spans {_span(shown.residual)}."
    )
    plot = cloud_plot(shown, many)
    return Chart("", alt, "", shown.joint, None, plot, CLOUD_HEIGHT)


def _explained_share(cloud: Cloud) -> float | None:
    """Return the part of a residual's mean square that an effect explains."""
    whole = float(np.mean(cloud.residual**2))
    if not whole:
        return None
    left = float(np.mean((cloud.residual - cloud.fitted) ** 2))
    return max(0.0, 1 - left / whole)


def _span(values: np.ndarray) -> str:
    return f"{values.min():.3g} to {values.max():.3g} N m"


def _curve_chart(
    proof: LogProof, joint: int, stages: Sequence[str], most: int
) -> Chart:
    stages = [s for s in stages if s in proof.tau_hat]
    errors = _errors(proof, joint, stages)
    text = listing([f"{look.LABELS[s].split(' (')[0]} {e}" for s, e in errors.items()])
    caption = f"Joint {joint}, error over the samples shown: {text}."
    alt = (
        f"Measured torque of joint {joint} on log {proof.id} over "
        f"{proof.t[-1] - proof.t[0]:.1f} s with the predictions of "
        f"{len(stages)} models; below, what each leaves. Error: {text}."
    )
    plot = torque_plot(proof, joint, stages, most)
    return Chart("", alt, caption, joint, None, plot, TORQUE_HEIGHT)


def _errors(proof: LogProof, joint: int, stages: Sequence[str]) -> dict[str, str]:
    """Return the error of each model on the samples drawn, as text."""
    tau = proof.tau[:, joint - 1]
    size = np.linalg.norm(tau)
    errors = {}
    for stage in stages:
        miss = np.linalg.norm(tau - proof.tau_hat[stage][:, joint - 1])
        errors[stage] = f"{bare_percent(100 * miss / size)} %" if size else "–"
    return errors


def _spectrum_chart(
    proofs: Sequence[LogProof], joint: int, stages: Sequence[str]
) -> Chart | None:
    stages = [s for s in stages if all(s in p.tau_hat for p in proofs)]
    plot = spectrum_plot(proofs, joint, stages)
    if plot is None:
        return None
    peaks = [_peak(proofs, joint, stage) for stage in stages]
    text = f"Spectrum of the residual of joint {joint}: {listing(peaks)}."
    return Chart("", text, "", joint, None, plot, SPECTRUM_HEIGHT)


def _peak(proofs: Sequence[LogProof], joint: int, stage: str) -> str:
    f, amplitude = density(proofs, joint, stage)
    top = 1 + int(amplitude[1:].argmax())
    label = look.LABELS[stage].split(" (")[0]
    return f"{label} largest at {f[top]:.2g} Hz with {amplitude[top]:.3g} N m/√Hz"


_MOST_DOTS = 900
_DOTS = 40_000  # of all such figures of a page
_MARKERS = ("circle", "square", "diamond", "triangle-up")


def cloud_plot(cloud: Cloud, many: int = 1) -> look.Plot:
    """Return the residual over its variable with the effect through it.

    Args:
        cloud: What one finding explains on one joint, or what a joint keeps.
        many: Such figures on the page, which share its points.
    """
    most = min(_MOST_DOTS, _DOTS // many)
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
    # As all axes have it, the unit stands in round brackets.
    variable = cloud.variable.replace("[", "(").replace("]", ")")
    x = look.axis(look.escape(variable))
    y = look.axis("torque (N m)", range=_limits(cloud), zeroline=True)
    y["zerolinecolor"] = look.SOFT
    medians = _medians(cloud)
    # Of one kind of marks the text above says all.
    more = {"showlegend": len(medians) > 1}
    more["margin"] = {"l": 56, "r": 12, "t": 80 if len(medians) > 1 else 34, "b": 44}
    layout = look.layout(f"Joint {cloud.joint}", x, y, **more)
    return {"data": [samples, *fitted, *medians], "layout": layout}


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


_SEGMENT = 8.0  # s of one segment: lines an eighth of a hertz wide
_SHORTEST = 16  # samples of a segment


def spectrum_plot(
    proofs: Sequence[LogProof], joint: int, stages: Sequence[str]
) -> look.Plot | None:
    """Return the amplitude density of the residual of a joint; None of too little."""
    traces, ceiling = [], 0.0
    for stage in stages:
        spectrum = density(proofs, joint, stage)
        if spectrum is None:
            return None
        f, amplitude = spectrum
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
    """
    stretches = [s for p in proofs for s in _stretches(p, joint, stage)]
    if not stretches:
        return None
    from scipy.signal import welch

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
    errors = {s: [v[s] for v in values if known(v.get(s))] for s in stages}
    rest = [v for s, listed in errors.items() if s != "nominal" for v in listed]
    everything = [v for listed in errors.values() for v in listed]
    most = max(everything, default=1.0)
    return max(min(most, _CLIP * max(rest, default=most)), 1e-6)


_MOST_BANDS = 80


def torque_plot(proof: LogProof, joint: int, stages: Sequence[str], most: int):
    """Return measured and predicted torque of a joint, and below what each leaves."""
    column = joint - 1
    t, tau = proof.t, proof.tau[:, column]
    style = look.line("measured", look.MEASURED, 2.6)
    traces = [style | look.over_time(t, tau, most)]
    # The nominal model on top and dotted: it often lies under the refitted one.
    for stage in sorted(stages, key=lambda stage: stage == "nominal"):
        hat = proof.tau_hat[stage][:, column]
        traces.append(_style(stage) | look.over_time(t, hat, most))
        if stage != "nominal":
            below = {"yaxis": "y2", "showlegend": False}
            left = look.over_time(t, tau - hat, most)
            traces.append(_style(stage) | below | left)
    return {"data": traces, "layout": _torque_layout(proof, joint)}


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
