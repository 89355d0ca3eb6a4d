"""The figures of a calibration page, by their numbers in the paper."""

from collections.abc import Mapping, Sequence

import numpy as np

from flows.report import figure
from flows.report.document import Chart
from residual.calibration.calibrate import Calibration
from residual.calibration.scores import (
    DEFAULT,
    LS,
    MODELS,
    NOTHING,
    PAPER_FORM,
    PLSR,
    RANDOM,
    RUN,
    SCHEMES,
    find,
)
from residual.calibration.views import INPUT, WHITE

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
_RMSEV = figure.axis("RMSEV (%)", rangemode="tozero")


def _chart(
    title: str, x: str, y: Mapping, data: list, alt: str, joint: int | None = None
) -> Chart:
    plot = {"data": data, "layout": figure.layout(title, figure.axis(x), y)}
    return Chart("", f"{title}: {alt}.", joint=joint, plot=plot)


def bars(result: Calibration) -> list[Chart]:
    """Return errors as bars: schemes side by side, then joint by joint (figure 10)."""
    schemes = list(dict.fromkeys(score.scheme for score in result.scores))
    overall = {}
    for model in MODELS:
        scores = [find(result.scores, scheme, model) for scheme in schemes]
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
    y = figure.axis("RMSEV (%)", range=[0, max(top, 1e-6)])
    return _chart(title, "", y, data, text)


def over_time(result: Calibration) -> list[Chart]:
    """Return corrections of a run beside its residual, joint by joint (figure 9)."""
    unseen, out = result.unseen, []
    for column, joint in enumerate(result.rows.joints if unseen else ()):
        residual = unseen.residual[:, column]
        curves = {"residual": (figure.MEASURED, residual)}
        for name, values in unseen.corrections.items():
            curves[MODELS[name]] = MODEL_COLORS[name], values[:, column]
        x = figure.packed(unseen.t)
        data = [
            {**figure.line(name, color, 1.0), "x": x, "y": figure.packed(values)}
            for name, (color, values) in curves.items()
        ]
        reach = 1.5 * float(np.abs(residual).max()) or 1.0
        y = figure.axis("torque (N m)", range=[-reach, reach])
        alt = f"residual of {unseen.label} and corrections over time"
        out.append(_chart(f"Joint {joint}", "time (s)", y, data, alt, joint))
    return out


def components(result: Calibration) -> list[Chart]:
    """Return explained variance, a chart for each motion family (figures 4 to 6)."""
    out = []
    for family in dict.fromkeys(block.family for block in result.blocks):
        blocks, data = [block for block in result.blocks if block.family == family], []
        for block in blocks:
            color = _BLOCKS.get(block.block, "#d55e00")
            x = {"x": list(range(1, len(block.limit) + 1))}
            data.append(
                figure.line(block.block, color) | x | {"y": block.explained.tolist()}
            )
            if block.block != WHITE:
                name, dash = f"{block.block}, chance", {"dash": "dash"}
                style = figure.line(name, color, 1.0, line=dash)
                data.append(style | x | {"y": block.limit.tolist()})
        alt = "; ".join(
            f"{o.block}: {o.explained[0]:.0f} % in the first" for o in blocks
        )
        y = figure.axis("explained variance (%)", rangemode="tozero")
        out.append(_chart(family.replace("_", " "), "component", y, data, alt))
    return out


def curves(result: Calibration) -> list[Chart]:
    """Return RMSEV over the number of components of each model (figure 8)."""
    out = []
    for model in (PLSR, PAPER_FORM):
        scores = [find(result.scores, scheme, model) for scheme in (RUN, RANDOM)]
        scores = [
            score for score in scores if score is not None and score.curve is not None
        ]
        if scores:
            curves = {SCHEMES[score.scheme]: score.curve for score in scores}
            alt = "; ".join(
                f"{SCHEMES[o.scheme]}: least at {o.components} components"
                for o in scores
            )
            at = list(range(max(len(score.curve) for score in scores)))
            data = _by_joint(result, at, curves)
            out.append(_chart(MODELS[model], "components", _RMSEV, data, alt))
    return out


def levels(result: Calibration) -> list[Chart]:
    """Return RMSEV over the number of levels, and its time (figure 12)."""
    sweep = result.sweep
    if sweep is None:
        return []
    at = list(sweep.levels)
    alt = f"RMSEV over {at[0]} to {at[-1]} levels"
    curves = {SCHEMES[name]: errors for name, errors in sweep.errors.items()}
    data = _by_joint(result, at, curves)
    times = {"x": at, "y": [round(s, 3) for s in sweep.seconds]}
    y = figure.axis("processor time (s)", rangemode="tozero")
    return [
        _chart("Error", "levels", _RMSEV, data, alt),
        _chart("Time", "levels", y, [figure.line("time", figure.SOFT) | times], alt),
    ]


def _by_joint(
    result: Calibration, at: list[int], curves: Mapping[str, np.ndarray]
) -> list[figure.Trace]:
    """Errors of each joint, the first scheme solid and the second dashed."""
    data = []
    for (name, errors), dash in zip(curves.items(), ("solid", "dash"), strict=False):
        for column, joint in enumerate(result.rows.joints):
            color = figure.JOINTS[column % len(figure.JOINTS)]
            style = figure.line(f"joint {joint}, {name}", color, line={"dash": dash})
            y = [_number(v) for v in errors[:, column]]
            data.append({**style, "x": at[: len(y)], "y": y})
    return data


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 4)
