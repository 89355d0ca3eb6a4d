"""A calibration in the terminal and on a page: errors by scheme and model."""

from collections.abc import Mapping, Sequence

import numpy as np

from flows.report import BoldText, Chart, Document, Note, ReportTable, Section, charts
from flows.report.page import render_html as render_page
from flows.report.phrases import capitalize_first, count_noun, read_page_texts
from flows.steps.fit import StoredCalibration
from residual.calibration.calibrate import Calibration
from residual.calibration.calibration_rows import INPUT, PAPER, WHITE
from residual.calibration.validation_scores import (
    BLOCK,
    DEFAULT,
    FAMILY,
    LS,
    MODELS,
    NOTHING,
    PAPER_FORM,
    PLSR,
    RANDOM,
    RUN,
    SCHEMES,
    ModelScore,
    find_model_score,
)

HIDDEN = 1.25  # ratio from which a random split is said to hide something
WORSE = 1.03  # ... from which one error is said to be above another


def describe_calibration(result: Calibration) -> tuple[str, ...]:
    """Return the gain of the tables on unseen runs, then on other splits."""

    def score(scheme: str, model: str) -> ModelScore | None:
        return find_model_score(result.scores, scheme, model)

    lines = []
    ours, none, ls = (score(RUN, model) for model in (DEFAULT, NOTHING, LS))
    if ours and none and ls:
        verb = "reduce" if ours.overall < 0.97 * none.overall else "do not reduce"
        lines.append(
            f"Tables {verb} the error on unseen runs: {_p(none)} → {_p(ours)} "
            f"(LS: {_p(ls)}).{_above(ours, none)}"
        )
    drawn, unseen = score(RANDOM, PAPER_FORM), score(RUN, PAPER_FORM)
    if drawn and unseen:
        ratio = unseen.overall / drawn.overall
        hides = f"hides a factor of {ratio:.1f}" if ratio >= HIDDEN else "hides little"
        lines.append(
            f"Paper form: {_p(drawn)} on a random split, {_p(unseen)} on unseen runs: "
            f"the random split {hides}."
        )
    none = score(BLOCK, NOTHING)
    if none:
        both = (score(BLOCK, model) for model in (DEFAULT, PAPER_FORM))
        text = "".join(f", {MODELS[one.model]} {_p(one)}" for one in both if one)
        lines.append(
            "On unseen blocks of the same runs, a weaker test than an unseen run: "
            f"no compensation {_p(none)}{text}."
        )
    family, none = (score(FAMILY, model) for model in (DEFAULT, NOTHING))
    if family and none:
        lines.append(
            f"On an unseen motion family: {_p(none)} → {_p(family)}.{_above(family, none)}"
        )
    return tuple(lines)


def _above(score: ModelScore, reference: ModelScore) -> str:
    """The joints on which one error is above another, as a sentence; empty for none."""
    joints = [str(j + 1) for j in np.flatnonzero(score.rmsev > WORSE * reference.rmsev)]
    plural = "s" if len(joints) > 1 else ""
    return f" Worse on joint{plural} {', '.join(joints)}." if joints else ""


def _p(score: ModelScore) -> str:
    return f"{score.overall:.3g} %"


_TEXT = read_page_texts()["calibration"]


def build_terminal_parts(outcome: StoredCalibration) -> list[str | ReportTable]:
    """Return a calibration for the terminal: errors, how they are meant, warnings."""
    result = outcome.calibration
    return [
        _errors(result),
        describe_error_schemes(result),
        describe_default_forms(result),
        *describe_calibration(result),
        *(f"note: {n}" for n in result.notes),
        *(f"warning: {w}" for w in outcome.warnings),
    ]


def _errors(result: Calibration) -> ReportTable:
    paper = result.rows.mode == PAPER
    joints = [f"J{j}" for j in result.rows.joints]
    heads = ["RMSEV (RMSEC) [%]", "model", *joints, "all"]
    heads += [f"mean {joint}" for joint in joints] if paper else []
    schemes = [score.scheme for score in result.scores]
    first = [i for i, name in enumerate(schemes) if name not in schemes[:i]]
    rows = []
    for i, score in enumerate(result.scores):
        scheme_errors = [each.overall for each in result.scores if each.scheme == score.scheme]
        kind = BoldText if score.overall == min(scheme_errors) else str  # the best of its scheme
        cells = [
            kind(f"{_percent(v)} ({_percent(c)})")
            for v, c in zip(score.rmsev, score.rmsec, strict=True)
        ]
        means = [_percent(m) for m in score.mean] if paper else []
        count = "" if score.components is None else f", A = {score.components}"
        start = [SCHEMES[score.scheme] if i in first else "", MODELS[score.model] + count]
        rows.append([*start, *cells, kind(_percent(score.overall)), *means])
    return ReportTable(heads, rows, text_columns=(0, 1), sections=first[1:])


def _percent(value: float) -> str:
    return "–" if not np.isfinite(value) else f"{value:.1f}"


def describe_error_schemes(result: Calibration) -> str:
    """Return the definitions of X and Y in a sentence."""
    rows = result.rows
    if rows.mode == PAPER:
        joints = ", ".join(map(str, rows.joints))
        pair = (
            f"X: reference of joints {joints} and its derivatives; Y: torque minus "
            "that of the simulated twin, one sample ahead"
        )
    else:
        declared = ", ".join(result.declared) or "nothing"
        pair = (
            "X: measured motion of all joints; Y: torque minus that of a model "
            f"(declared: {declared}) identified without the held-out runs"
        )
    return (
        f"{pair}; {len(rows.X)} rows of {count_noun(len(rows.labels), 'run')}; errors "
        "are in per cent of the measured torque."
    )


def describe_default_forms(result: Calibration) -> str:
    """Return in a sentence the default form of each joint."""
    forms = []
    for joint, option in zip(result.rows.joints, result.chosen, strict=True):
        form = option.kind
        if form == PLSR:
            count = count_noun(option.count, "component")
            form = f"PLSR, {count}" if option.count else "a constant"
        forms.append(f"J{joint} {form}")
    where = "runs" if result.proven else "blocks of the runs (fewer than four runs)"
    return f"Default form, chosen on left-out {where}: {'; '.join(forms)}."


def render_calibration_page(result: Calibration, warnings: Sequence[str] = ()) -> str:
    """Return the page of a calibration."""

    def section(id: str, heading: str, charts: Sequence[Chart], *more: ReportTable) -> Section:
        parts = [charts, *more] if charts else ()
        return Section(id, heading, parts, _TEXT.get(id, ""))

    words = describe_calibration(result)
    logs = f"Logs: {', '.join(result.rows.labels)}."
    note = (
        "RMSEV on held-out rows, RMSEC in brackets on fitted rows, per cent of the "
        "measured torque, pooled over folds"
    )
    if result.rows.mode == PAPER:
        note += "; the mean over subsets, as in the paper, in the last columns"
    note = f"{note}. {_TEXT['newness']}"
    below = Note(
        f"{capitalize_first(describe_default_forms(result))} {_TEXT['flatters']}", "soft spaced"
    )
    loadings = [
        (
            block.family.replace("_", " "),
            block.block,
            str(block.real),
            ", ".join(f"{name} {value:+.2f}" for name, value in block.strongest(0)),
        )
        for block in result.blocks
    ]
    heads = ("Motion", "Block", "Real components", "Largest loadings of the first")
    table = ReportTable(heads, loadings, text_columns=(0, 1, 3))
    pca = chart_components(result)
    return render_page(
        Document(
            title=f"modelgap calibration: {result.robot}",
            about=f"modelgap calibration of {result.robot}",
            headline=words[0] if words else "A data-driven correction",
            lead=[*words[1:], describe_error_schemes(result), logs],
            warnings=warnings,
            sections=(
                Section("table", "Models and schemes", [_errors(result), below], note),
                section("bars", "Errors as bars (figure 10)", chart_validation_errors(result)),
                section("time", "Corrections over time (figure 9)", chart_torque_over_time(result)),
                section("pca", "Principal components (figures 4 to 6)", pca, table),
                section("curves", "Components (figure 8)", chart_lookup_curves(result)),
                section("levels", "Levels (figure 12)", chart_lookup_levels(result)),
                Section("read", "How to read this page", [read_page_texts()["read_calibration"]]),
                Section("notes", "Notes", [result.notes]),
            ),
        )
    )


# Okabe and Ito's palette, as in the other figures.
MODEL_COLORS = {
    NOTHING: "#b3b3b3",
    LS: "#e69f00",
    PLSR: "#56b4e9",
    PAPER_FORM: "#cc79a7",
    DEFAULT: "#0072b2",
}
_BLOCKS = {INPUT: "#0072b2", WHITE: "#b3b3b3"}
_CLIP = 1.5  # times no compensation, above which bars are cut
_RMSEV = charts.build_axis("RMSEV (%)", rangemode="tozero")


def _chart(title: str, x: str, y: Mapping, data: list, alt: str, joint: int | None = None) -> Chart:
    plot = {"data": data, "layout": charts.build_layout(title, charts.build_axis(x), y)}
    return Chart(f"{title}: {alt}.", joint=joint, plot=plot)


def chart_validation_errors(result: Calibration) -> list[Chart]:
    """Return errors as bars: schemes side by side, then joint by joint (figure 10)."""
    schemes = list(dict.fromkeys(score.scheme for score in result.scores))
    overall = {}
    for model in MODELS:
        scores = [find_model_score(result.scores, scheme, model) for scheme in schemes]
        overall[model] = [score and score.overall for score in scores]
    out = [_bars("All joints", [SCHEMES[name] for name in schemes], overall)]
    joints = [f"joint {j}" for j in result.rows.joints]
    for name in schemes:
        scores = {s.model: s.rmsev for s in result.scores if s.scheme == name}
        out.append(_bars(SCHEMES[name], joints, scores))
    return out


def _bars(title: str, at: list[str], rows: Mapping[str, Sequence]) -> Chart:
    top = _CLIP * max(v for v in rows[NOTHING] if v is not None and np.isfinite(v))
    data = [
        {
            "type": "bar",
            "name": MODELS[model],
            "x": at,
            "y": [_number(v) for v in values],
            "text": [f"{v:.3g}" if _number(v) is not None else "" for v in values],
            "marker": {"color": MODEL_COLORS[model]},
        }
        for model, values in rows.items()
    ]
    text = "; ".join(
        f"{MODELS[m]} {', '.join(f'{v:.3g} %' for v in values if v is not None)}"
        for m, values in rows.items()
    )
    y = charts.build_axis("RMSEV (%)", range=[0, max(top, 1e-6)])
    return _chart(title, "", y, data, text)


def chart_torque_over_time(result: Calibration) -> list[Chart]:
    """Return corrections of a run beside its residual, joint by joint (figure 9)."""
    unseen, out = result.unseen, []
    for column, joint in enumerate(result.rows.joints if unseen else ()):
        residual = unseen.residual[:, column]
        curves = {"residual": (charts.MEASURED, residual)}
        for name, values in unseen.corrections.items():
            curves[MODELS[name]] = MODEL_COLORS[name], values[:, column]
        x = charts.encode_values(unseen.t)
        data = [
            {**charts.line_style(name, color, 1.0), "x": x, "y": charts.encode_values(values)}
            for name, (color, values) in curves.items()
        ]
        reach = 1.5 * float(np.abs(residual).max()) or 1.0
        y = charts.build_axis("torque (N m)", range=[-reach, reach])
        alt = f"residual of {unseen.label} and corrections over time"
        out.append(_chart(f"Joint {joint}", "time (s)", y, data, alt, joint))
    return out


def chart_components(result: Calibration) -> list[Chart]:
    """Return explained variance, a chart for each motion family (figures 4 to 6)."""
    out = []
    for family in dict.fromkeys(block.family for block in result.blocks):
        blocks, data = [block for block in result.blocks if block.family == family], []
        for block in blocks:
            color = _BLOCKS.get(block.block, "#d55e00")
            x = {"x": list(range(1, len(block.limit) + 1))}
            data.append(charts.line_style(block.block, color) | x | {"y": block.explained.tolist()})
            if block.block != WHITE:
                name, dash = f"{block.block}, chance", {"dash": "dash"}
                style = charts.line_style(name, color, 1.0, line=dash)
                data.append(style | x | {"y": block.limit.tolist()})
        alt = "; ".join(f"{o.block}: {o.explained[0]:.0f} % in the first" for o in blocks)
        y = charts.build_axis("explained variance (%)", rangemode="tozero")
        out.append(_chart(family.replace("_", " "), "component", y, data, alt))
    return out


def chart_lookup_curves(result: Calibration) -> list[Chart]:
    """Return RMSEV over the number of components of each model (figure 8)."""
    out = []
    for model in (PLSR, PAPER_FORM):
        schemes = (RUN, RANDOM)
        scores = [find_model_score(result.scores, s, model) for s in schemes]
        scores = [s for s in scores if s is not None and s.curve is not None]
        if scores:
            curves = {SCHEMES[s.scheme]: s.curve for s in scores}
            alt = "; ".join(
                f"{SCHEMES[o.scheme]}: least at {o.components} components" for o in scores
            )
            at = list(range(max(len(s.curve) for s in scores)))
            data = _by_joint(result, at, curves)
            out.append(_chart(MODELS[model], "components", _RMSEV, data, alt))
    return out


def chart_lookup_levels(result: Calibration) -> list[Chart]:
    """Return RMSEV over the number of levels, and its time (figure 12)."""
    sweep = result.sweep
    if sweep is None:
        return []
    at = list(sweep.levels)
    alt = f"RMSEV over {at[0]} to {at[-1]} levels"
    curves = {SCHEMES[name]: errors for name, errors in sweep.errors.items()}
    data = _by_joint(result, at, curves)
    times = {"x": at, "y": [round(s, 3) for s in sweep.seconds]}
    y = charts.build_axis("processor time (s)", rangemode="tozero")
    return [
        _chart("Error", "levels", _RMSEV, data, alt),
        _chart("Time", "levels", y, [charts.line_style("time", charts.SOFT) | times], alt),
    ]


def _by_joint(
    result: Calibration, at: list[int], curves: Mapping[str, np.ndarray]
) -> list[charts.Trace]:
    """Errors of each joint, the first scheme solid and the second dashed."""
    data = []
    for (name, errors), dash in zip(curves.items(), ("solid", "dash"), strict=False):
        for column, joint in enumerate(result.rows.joints):
            color = charts.JOINTS[column % len(charts.JOINTS)]
            style = charts.line_style(f"joint {joint}, {name}", color, line={"dash": dash})
            y = [_number(v) for v in errors[:, column]]
            data.append({**style, "x": at[: len(y)], "y": y})
    return data


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 4)
