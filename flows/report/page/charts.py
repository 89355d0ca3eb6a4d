"""Which figures the page gets, each with a caption and words for who cannot see it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from flows.report.page import figures
from flows.report.page.plots import LABELS
from flows.report.words.phrases import effect_named, noun
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
from residual.quantity import bare_percent, known, percent

# Each figure costs about 0.1 s; these limits keep the page within 1.5 s and 3 MB.
_MOST_CLOUDS = 9
_MOST_CURVES = 8


@dataclass(frozen=True, slots=True)
class Chart:
    """A figure with its text.

    Attributes:
        uri: The picture as a data address.
        alt: What it shows, for readers who do not see it.
        caption: One or two sentences below it.
        joint: Joint it shows, None where it shows all.
        name: Effect it shows, None where it shows none.
    """

    uri: str
    alt: str
    caption: str
    joint: int | None = None
    name: str | None = None


def error_charts(found: Diagnosis) -> list[Chart]:
    """Return bars of the held-out error: while moving, and over all samples."""
    joints = [row for row in error_rows(found) if row.joint is not None]
    level = found.unexplained.noise_floor
    floor = [100 * level] if known(level) else []
    # As logged, the picture is that of the filtered error: the table is enough.
    metrics = [m for m in ("moving", "filtered") if has(joints, m, "identified")]
    metrics = metrics or [m for m in METRICS if has(joints, m, "identified")]
    charts = []
    for metric in metrics:
        stages = [s for s in _stages(found) if has(joints, metric, s)]
        uri = figures.error_bars(joints, metric, stages, floor)
        charts.append(Chart(uri, _bars_alt(joints, metric, stages), ""))
    return charts


def cloud_charts(found: Diagnosis) -> tuple[list[Chart], int]:
    """Return (charts, number left out): residual over the explaining variable.

    Every finding gets its first joint before any gets its second.
    """
    order = [finding.name for finding in findings(found)]
    usable = [c for c in found.clouds if len(c.x) > 1]
    seen: dict[str, int] = {}
    ranked = []
    for cloud in usable:
        seen[cloud.name] = seen.get(cloud.name, 0) + 1
        place = order.index(cloud.name) if cloud.name in order else len(order)
        ranked.append((seen[cloud.name], place, cloud))
    ranked.sort(key=lambda entry: entry[:2])
    kept = [cloud for _, _, cloud in ranked[:_MOST_CLOUDS]]
    kept.sort(key=lambda cloud: cloud.joint)
    return [_cloud_chart(cloud) for cloud in kept], len(usable) - len(kept)


def left_charts(found: Diagnosis) -> list[Chart]:
    """Return what each unexplained joint keeps, over what it depends on most."""
    return [_left_chart(cloud) for cloud in found.left if len(cloud.x) > 1]


def curve_charts(found: Diagnosis) -> tuple[list[Chart], list[Chart], int]:
    """Return (of the joints concerned, of the others, number left out).

    Every joint is drawn on the first log before any is drawn on the next.
    """
    focus = concerned(found)
    others = [j for j in range(1, found.verdict.dof + 1) if j not in focus]
    wanted = [(p, j) for p in found.proofs for j in (*focus, *others)]
    wanted = [(p, j) for p, j in wanted if j <= p.tau.shape[1] and len(p.t) > 1]
    charts = [_curve_chart(found, p, j) for p, j in wanted[:_MOST_CURVES]]
    left = len(wanted) - len(charts)
    charts.sort(key=lambda chart: (*focus, *others).index(chart.joint))
    mine = [chart for chart in charts if chart.joint in focus]
    return mine, [chart for chart in charts if chart.joint not in focus], left


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


def _cloud_chart(cloud: Cloud) -> Chart:
    logs = list(dict.fromkeys(cloud.log.tolist()))
    where = f"logs {', '.join(map(str, logs))}" if len(logs) > 1 else f"log {logs[0]}"
    alt = (
        f"Residual torque of joint {cloud.joint} over {cloud.variable}, {where}, with "
        f"binned medians and the fitted {noun(cloud.name)} drawn through them. The "
        f"residual spans {_span(cloud.residual)}, the fitted effect "
        f"{_span(cloud.fitted)}."
    )
    return Chart(figures.over_variable(cloud), alt, "", cloud.joint, cloud.name)


def _left_chart(cloud: Cloud) -> Chart:
    alt = (
        f"What stays unexplained of the torque of joint {cloud.joint} over "
        f"{cloud.variable}, with binned medians. It spans {_span(cloud.residual)}."
    )
    return Chart(figures.over_variable(cloud), alt, "", cloud.joint)


def _span(values: np.ndarray) -> str:
    return f"{values.min():.3g} to {values.max():.3g} N m"


def _curve_chart(found: Diagnosis, proof: LogProof, joint: int) -> Chart:
    stages = [s for s in _stages(found) if s in proof.tau_hat]
    errors = _errors(proof, joint, stages)
    said = ", ".join(f"{LABELS[s].split(' ')[0]} {e}" for s, e in errors.items())
    caption = f"Error over the samples shown: {said}."
    alt = (
        f"Measured torque of joint {joint} on log {proof.id} over "
        f"{proof.t[-1] - proof.t[0]:.1f} s with the predictions of "
        f"{len(stages)} models; below, what each leaves. Error: {said}."
    )
    return Chart(figures.over_time(proof, joint, stages), alt, caption, joint)


def _errors(proof: LogProof, joint: int, stages: Sequence[str]) -> dict[str, str]:
    """Return the error of each model on the samples drawn, as text."""
    tau = proof.tau[:, joint - 1]
    size = np.linalg.norm(tau)
    found = {}
    for stage in stages:
        miss = np.linalg.norm(tau - proof.tau_hat[stage][:, joint - 1])
        found[stage] = f"{bare_percent(100 * miss / size)} %" if size else "–"
    return found


def clouds_of(charts: Sequence[Chart], finding: FindingRow) -> list[Chart]:
    """Return the charts of one finding; two of one name differ by their joints."""
    mine = [chart for chart in charts if chart.name == finding.name]
    at_home = [c for c in mine if c.joint in finding.joints or not finding.joints]
    return at_home or mine
