"""Which figures the page gets, each with a caption and words for who cannot see it."""

from collections.abc import Sequence

import numpy as np

from flows.report import plots
from flows.report.document import Chart
from flows.report.figures import look
from flows.report.tables import (
    METRICS,
    ErrorRow,
    error_rows,
    has,
)
from flows.report.words.phrases import effect_named, listing, noun
from residual.diagnosis.result import STAGES, Diagnosis, Finding
from residual.model.compare import Cloud, LogProof
from residual.quantity import bare_percent, fraction, known, percent

# A point of a curve is eleven bytes of the page; so it stays within two megabytes.
_POINTS = 80_000
_MOST_POINTS = 2400
MOST_LOGS = 6


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
        plot = plots.bars_plot(joints, metric, stages, floor)
        alt = _bars_alt(joints, metric, stages)
        charts.append(Chart("", alt, "", plot=plot, height=plots.BARS_HEIGHT))
    return charts


def finding_charts(found: Diagnosis) -> list[list[Chart]]:
    """Return the figures of each finding: measured over what explains it."""
    usable = [c for c in found.clouds if len(c.x) > 1]
    charts = [_cloud_chart(c, len(usable)) for c in usable]
    return [_clouds_of(charts, effect) for effect in found.effects]


def left_charts(found: Diagnosis) -> list[Chart]:
    """Return what each unexplained joint keeps, over what it depends on most."""
    usable = [c for c in found.left if len(c.x) > 1]
    return [_left_chart(c, len(usable)) for c in usable]


def motions(found: Diagnosis) -> tuple[list[tuple[str, list[Chart]]], int]:
    """Return (label and figures of held-out logs, number of logs not drawn).

    The joints that the findings concern come first. Of many logs those that the model
    predicts worst.
    """
    usable = [p for p in found.proofs if len(p.t) > 1]
    kept = sorted(usable, key=_miss, reverse=True)[:MOST_LOGS]
    kept = [p for p in usable if p in kept]
    stages, joints = _stages(found), _in_order(found)
    curves = max(1, len(kept) * len(joints) * 2 * len(stages))
    most = min(_MOST_POINTS, _POINTS // curves)
    drawn = [
        (proof.id, [_curve_chart(proof, j, stages, most) for j in joints])
        for proof in kept
    ]
    return drawn, len(usable) - len(kept)


def _in_order(found: Diagnosis) -> list[int]:
    """All joints, those that are concerned first."""
    dof = found.verdict.dof
    focus = [j for j in concerned(found) if j <= dof]
    return [*focus, *(j for j in range(1, dof + 1) if j not in focus)]


def spectrum_charts(found: Diagnosis) -> tuple[list[Chart], list[Chart]]:
    """Return spectra of the residual (of the joints concerned, of the others)."""
    focus = concerned(found)
    usable = [p for p in found.proofs if len(p.t) > 1]
    stages = [s for s in _stages(found) if s not in ("nominal", "plsr")]
    drawn = [_spectrum_chart(usable, j, stages) for j in _in_order(found)]
    charts = [chart for chart in drawn if chart]
    first = [chart for chart in charts if chart.joint in focus]
    return first, [chart for chart in charts if chart.joint not in focus]


def concerned(found: Diagnosis) -> list[int]:
    """Return the joints whose curves are shown first, the most telling one first.

    Those of the findings; of an effect on the whole arm, the two it changes most;
    then those that stay unexplained; failing all that the worst one.
    """
    named = found.effects
    whole = [f for f in named if effect_named(f.name).scope == "flange" or not f.joints]
    joints = [j for f in named if f not in whole for j in f.joints]
    joints += _most_changed(found) if whole else []
    joints += found.unexplained.joints
    return list(dict.fromkeys(joints)) or _worst(found)


def _clouds_of(charts: Sequence[Chart], finding: Finding) -> list[Chart]:
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
    share = fraction(_explained_share(shown))
    said = f"It explains {share} of what was measured there."
    alt = (
        f"Residual torque of joint {shown.joint} over {shown.variable}, "
        f"{logs} log{'' if logs == 1 else 's'}, with medians in bins and what "
        f"{noun(shown.name)} explains. The residual spans {_span(shown.residual)}, "
        f"what is explained {_span(shown.fitted)}. {said}"
    )
    plot = plots.cloud_plot(shown, many)
    return Chart("", alt, said, shown.joint, shown.name, plot, plots.CLOUD_HEIGHT)


def _left_chart(shown: Cloud, many: int) -> Chart:
    alt = (
        f"What stays unexplained of the torque of joint {shown.joint} over "
        f"{shown.variable}, with medians in bins. It spans {_span(shown.residual)}."
    )
    plot = plots.cloud_plot(shown, many)
    return Chart("", alt, "", shown.joint, None, plot, plots.CLOUD_HEIGHT)


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
    said = listing([f"{look.LABELS[s].split(' (')[0]} {e}" for s, e in errors.items()])
    caption = f"Joint {joint}, error over the samples shown: {said}."
    alt = (
        f"Measured torque of joint {joint} on log {proof.id} over "
        f"{proof.t[-1] - proof.t[0]:.1f} s with the predictions of "
        f"{len(stages)} models; below, what each leaves. Error: {said}."
    )
    plot = plots.torque_plot(proof, joint, stages, most)
    return Chart("", alt, caption, joint, None, plot, plots.TORQUE_HEIGHT)


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
    plot = plots.spectrum_plot(proofs, joint, stages)
    if plot is None:
        return None
    peaks = [_peak(proofs, joint, stage) for stage in stages]
    said = f"Spectrum of the residual of joint {joint}: {listing(peaks)}."
    return Chart("", said, "", joint, None, plot, plots.SPECTRUM_HEIGHT)


def _peak(proofs: Sequence[LogProof], joint: int, stage: str) -> str:
    f, amplitude = plots.density(proofs, joint, stage)
    top = 1 + int(amplitude[1:].argmax())
    label = look.LABELS[stage].split(" (")[0]
    return f"{label} largest at {f[top]:.2g} Hz with {amplitude[top]:.3g} N m/√Hz"
