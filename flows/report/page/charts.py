"""Which figures the page gets, each with a caption and words for who cannot see it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flows.report.page.chart import Chart
from flows.report.page.drawn import bars, cloud, look, spectrum, thin
from flows.report.words.means import explained_share
from flows.report.words.phrases import effect_named, listing, noun
from flows.report.words.rows import (
    METRICS,
    ErrorRow,
    FindingRow,
    error_rows,
    findings,
    has,
)
from residual.diagnosis.result import STAGES, Diagnosis
from residual.model.compare import Cloud, LogProof
from residual.quantity import bare_percent, fraction, known, percent

HEIGHT = 400
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
    return {"data": traces, "layout": _layout(proof, joint)}


def _nominal_last(stages: Sequence[str]) -> list[str]:
    """The nominal model on top and dotted: it often lies under the refitted one."""
    return sorted(stages, key=lambda stage: stage == "nominal")


def _style(stage: str) -> look.Trace:
    colour, label = look.STAGES[stage], look.LABELS[stage]
    if stage == "nominal":
        return look.line(label, colour, 1.6, line={"dash": "dot"})
    return look.line(label, colour, 1.4)


def _layout(proof: LogProof, joint: int) -> dict:
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
    stretches = sorted(thin.spans(t, where), key=lambda band: -band[1])
    same = {"type": "rect", "yref": "paper", "y0": 0, "y1": 1, "layer": "below"}
    same |= {"fillcolor": look.STANDING, "line": {"width": 0}}
    return [
        same | {"x0": round(start, 3), "x1": round(start + length, 3)}
        for start, length in stretches[:_MOST_BANDS]
    ]


# A point of a curve is eleven bytes of the page; so it stays within two megabytes.
_POINTS = 80_000
_MOST_POINTS = 2400
MOST_LOGS = 6


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """The figures of one held-out log.

    Attributes:
        title: In words: "Held-out motion 1".
        id: Its label.
        focus: Joints that the findings concern.
        others: All other joints.
    """

    title: str
    id: str
    focus: tuple[Chart, ...]
    others: tuple[Chart, ...]


def error_charts(found: Diagnosis) -> list[Chart]:
    """Return bars of the held-out error: while moving, and over all samples."""
    joints = [row for row in error_rows(found) if row.joint is not None]
    level = found.unexplained.noise_floor
    floor = 100 * level if known(level) else None
    # As logged, the picture is that of the filtered error: the table is enough.
    metrics = [m for m in ("moving", "filtered") if has(joints, m, "identified")]
    metrics = metrics or [m for m in METRICS if has(joints, m, "identified")]
    charts = []
    for metric in metrics:
        stages = [s for s in _stages(found) if has(joints, metric, s)]
        plot = bars.bars_plot(joints, metric, stages, floor)
        alt = _bars_alt(joints, metric, stages)
        charts.append(Chart("", alt, "", plot=plot, height=bars.HEIGHT))
    return charts


def finding_charts(found: Diagnosis) -> list[tuple[FindingRow, list[Chart]]]:
    """Return each finding with its figures: measured over what explains it."""
    usable = [c for c in found.clouds if len(c.x) > 1]
    most = max(1, len(usable))
    charts = [_cloud_chart(c, most) for c in usable]
    return [(finding, clouds_of(charts, finding)) for finding in findings(found)]


def left_charts(found: Diagnosis) -> list[Chart]:
    """Return what each unexplained joint keeps, over what it depends on most."""
    usable = [c for c in found.left if len(c.x) > 1]
    return [_left_chart(c, len(usable)) for c in usable]


def motions(found: Diagnosis) -> tuple[list[Motion], int]:
    """Return (figures by held-out log, number of logs that are not drawn).

    Of many logs those that the model predicts worst.
    """
    usable = [p for p in found.proofs if len(p.t) > 1]
    kept = sorted(usable, key=_miss, reverse=True)[:MOST_LOGS]
    kept = [p for p in usable if p in kept]
    focus, dof = concerned(found), found.verdict.dof
    others = [j for j in range(1, dof + 1) if j not in focus]
    stages = _stages(found)
    curves = max(1, len(kept) * dof * 2 * len(stages))
    most = min(_MOST_POINTS, _POINTS // curves)
    out = []
    for number, proof in enumerate(kept, 1):
        mine, rest = (
            tuple(_curve_chart(proof, j, stages, most) for j in joints if j <= dof)
            for joints in (focus, others)
        )
        many = f" {number}" if len(kept) > 1 else ""
        out.append(Motion(f"Held-out motion{many}", proof.id, mine, rest))
    return out, len(usable) - len(kept)


def spectrum_charts(found: Diagnosis) -> tuple[list[Chart], list[Chart]]:
    """Return spectra of the residual (of the joints concerned, of the others)."""
    focus = concerned(found)
    others = [j for j in range(1, found.verdict.dof + 1) if j not in focus]
    usable = [p for p in found.proofs if len(p.t) > 1]
    stages = [s for s in _stages(found) if s not in ("nominal", "plsr")]
    drawn = []
    for joints in (focus, others):
        charts = [_spectrum_chart(usable, j, stages) for j in joints]
        drawn.append([chart for chart in charts if chart])
    return drawn[0], drawn[1]


def concerned(found: Diagnosis) -> list[int]:
    """Return the joints whose curves are shown first, the most telling one first.

    Those of the findings; of an effect on the whole arm, the two it changes most;
    then those that stay unexplained; failing all that the worst one.
    """
    named = findings(found)
    whole = [f for f in named if effect_named(f.name).scope == "flange" or not f.joints]
    joints = [j for f in named if f not in whole for j in f.joints]
    joints += _most_changed(found) if whole else []
    joints += found.unexplained.joints
    return list(dict.fromkeys(joints)) or _worst(found)


def clouds_of(charts: Sequence[Chart], finding: FindingRow) -> list[Chart]:
    """Return the charts of one finding; two of one name differ by their joints."""
    mine = [chart for chart in charts if chart.name == finding.name]
    if effect_named(finding.name).variable is None:
        return mine
    at_home = [c for c in mine if c.joint in finding.joints or not finding.joints]
    return at_home or mine


def _most_changed(found: Diagnosis) -> list[int]:
    falls = []
    for row in error_rows(found):
        before, after = map(row.values["filtered"].get, ("identified", "augmented"))
        if row.joint and known(before) and known(after):
            falls.append((after - before, row.joint))
    return [joint for fall, joint in sorted(falls)[:2] if fall < 0]


def _worst(found: Diagnosis) -> list[int]:
    errors = [
        (row.values["filtered"].get("identified"), row.joint)
        for row in error_rows(found)
        if row.joint and known(row.values["filtered"].get("identified"))
    ]
    return [max(errors)[1]] if errors else [1]


def _stages(found: Diagnosis) -> list[str]:
    """Return the models worth drawing: augmented only where something was added."""
    added = bool(found.effects)
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
    share = fraction(explained_share(shown))
    said = f"It explains {share} of what was measured there."
    alt = (
        f"Residual torque of joint {shown.joint} over {shown.variable}, "
        f"{logs} log{'' if logs == 1 else 's'}, with medians in bins and what "
        f"{noun(shown.name)} explains. The residual spans {_span(shown.residual)}, "
        f"what is explained {_span(shown.fitted)}. {said}"
    )
    plot = cloud.cloud_plot(shown, many)
    return Chart("", alt, said, shown.joint, shown.name, plot, cloud.HEIGHT)


def _left_chart(shown: Cloud, many: int) -> Chart:
    alt = (
        f"What stays unexplained of the torque of joint {shown.joint} over "
        f"{shown.variable}, with medians in bins. It spans {_span(shown.residual)}."
    )
    plot = cloud.cloud_plot(shown, many)
    return Chart("", alt, "", shown.joint, None, plot, cloud.HEIGHT)


def _span(values: np.ndarray) -> str:
    return f"{values.min():.3g} to {values.max():.3g} N m"


def _curve_chart(
    proof: LogProof, joint: int, stages: Sequence[str], most: int
) -> Chart:
    stages = [s for s in stages if s in proof.tau_hat]
    errors = _errors(proof, joint, stages)
    said = listing([f"{look.LABELS[s].split(' (')[0]} {e}" for s, e in errors.items()])
    caption = f"Joint {joint}, error over the samples shown: {said}."
    alt = (
        f"Measured torque of joint {joint} on log {proof.id} over "
        f"{proof.t[-1] - proof.t[0]:.1f} s with the predictions of "
        f"{len(stages)} models; below, what each leaves. Error: {said}."
    )
    plot = torque_plot(proof, joint, stages, most)
    return Chart("", alt, caption, joint, None, plot, HEIGHT)


def _errors(proof: LogProof, joint: int, stages: Sequence[str]) -> dict[str, str]:
    """Return the error of each model on the samples drawn, as text."""
    tau = proof.tau[:, joint - 1]
    size = np.linalg.norm(tau)
    found = {}
    for stage in stages:
        miss = np.linalg.norm(tau - proof.tau_hat[stage][:, joint - 1])
        found[stage] = f"{bare_percent(100 * miss / size)} %" if size else "–"
    return found


def _spectrum_chart(
    proofs: Sequence[LogProof], joint: int, stages: Sequence[str]
) -> Chart | None:
    stages = [s for s in stages if all(s in p.tau_hat for p in proofs)]
    plot = spectrum.spectrum_plot(proofs, joint, stages)
    if plot is None:
        return None
    peaks = [_peak(proofs, joint, stage) for stage in stages]
    said = f"Spectrum of the residual of joint {joint}: {listing(peaks)}."
    return Chart("", said, "", joint, None, plot, spectrum.HEIGHT)


def _peak(proofs: Sequence[LogProof], joint: int, stage: str) -> str:
    f, amplitude = spectrum.density(proofs, joint, stage)
    top = 1 + int(amplitude[1:].argmax())
    label = look.LABELS[stage].split(" (")[0]
    return f"{label} largest at {f[top]:.2g} Hz with {amplitude[top]:.3g} N m/√Hz"
