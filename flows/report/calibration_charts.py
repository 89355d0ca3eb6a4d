"""Figures of the paper's chapter on a calibration: 4 to 6, 8, 9, 10 and 12."""

from collections.abc import Mapping, Sequence

import numpy as np

from flows.report.document import Chart
from flows.report.figures import look
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
from residual.calibration.views import INPUT, WHITE, Components

# Okabe and Ito's palette, as in the other figures.
MODEL_COLOURS = {
    NOTHING: "#b3b3b3",
    LS: "#e69f00",
    PLSR: "#56b4e9",
    PAPER_FORM: "#cc79a7",
    DEFAULT: "#0072b2",
}
_BLOCKS = {INPUT: "#0072b2", WHITE: "#b3b3b3"}
_CLIP = 1.5  # times no compensation, above which bars are cut
_HEIGHT = 290


def bars(made: Calibration) -> list[Chart]:
    """Return errors as bars: schemes side by side, then joint by joint (figure 10)."""
    names = list(dict.fromkeys(one.scheme for one in made.scores))
    whole = {
        model: [find(made.scores, scheme, model) for scheme in names]
        for model in MODELS
    }
    rows = {m: [one and one.overall for one in own] for m, own in whole.items()}
    out = [_bars("All joints", [SCHEMES[n] for n in names], rows)]
    joints = [f"joint {j}" for j in made.rows.joints]
    for name in names:
        own = [one for one in made.scores if one.scheme == name]
        out.append(_bars(SCHEMES[name], joints, {o.model: o.rmsev for o in own}))
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
            "marker": {"color": MODEL_COLOURS[model]},
        }
        for model, values in rows.items()
    ]
    y = look.axis("RMSEV, %", range=[0, max(top, 1e-6)])
    plot = {"data": data, "layout": look.layout(title, look.axis(""), y)}
    text = "; ".join(
        f"{MODELS[m]} {', '.join(f'{v:.3g} %' for v in values if v is not None)}"
        for m, values in rows.items()
    )
    return Chart("", f"{title}: {text}.", plot=plot, height=_HEIGHT)


def over_time(made: Calibration) -> list[Chart]:
    """Return corrections of a run beside its residual, joint by joint (figure 9)."""
    unseen, out = made.unseen, []
    for column, joint in enumerate(made.rows.joints if unseen else ()):
        residual = unseen.residual[:, column]
        curves = {"measured residual": (look.MEASURED, residual)}
        for name, values in unseen.corrections.items():
            curves[MODELS[name]] = MODEL_COLOURS[name], values[:, column]
        x = look.packed(unseen.t)
        data = [
            {**look.line(name, colour, 1.0), "x": x, "y": look.packed(values)}
            for name, (colour, values) in curves.items()
        ]
        reach = 1.5 * float(np.abs(residual).max()) or 1.0
        y = look.axis("N m", range=[-reach, reach])
        plot = {"data": data}
        plot["layout"] = look.layout(f"Joint {joint}", look.axis("t, s"), y)
        alt = f"Joint {joint}: residual of {unseen.label} and corrections over t."
        out.append(Chart("", alt, joint=joint, plot=plot, height=_HEIGHT))
    return out


def components(made: Calibration) -> list[Chart]:
    """Return explained variance, a chart for each kind of motion (figures 4 to 6)."""
    out = []
    for family in dict.fromkeys(one.family for one in made.blocks):
        own = [one for one in made.blocks if one.family == family]
        data = [trace for one in own for trace in _explained(one)]
        title, axes = family.replace("_", " "), [look.axis("component")]
        axes.append(look.axis("explained, %", rangemode="tozero"))
        text = "; ".join(f"{o.block}: {o.explained[0]:.0f} % in the first" for o in own)
        plot = {"data": data, "layout": look.layout(title, *axes)}
        out.append(Chart("", f"{title}: {text}.", plot=plot, height=_HEIGHT))
    return out


def _explained(one: Components) -> list[look.Trace]:
    colour, at = _BLOCKS.get(one.block, "#d55e00"), list(range(1, len(one.limit) + 1))
    lines = [{**look.line(one.block, colour), "x": at, "y": one.explained.tolist()}]
    if one.block != WHITE:
        dashed = look.line(f"{one.block}, chance", colour, 1.0, line={"dash": "dash"})
        lines.append({**dashed, "x": at, "y": one.limit.tolist()})
    return lines


def curves(made: Calibration) -> list[Chart]:
    """Return RMSEV over the number of components of each model (figure 8)."""
    out = []
    for model in (PLSR, PAPER_FORM):
        own = [find(made.scores, scheme, model) for scheme in (RUN, RANDOM)]
        own = [one for one in own if one is not None and one.curve is not None]
        if own:
            lines = {SCHEMES[one.scheme]: one.curve for one in own}
            least = (
                f"{SCHEMES[o.scheme]}: least at {o.components} components" for o in own
            )
            at = list(range(max(len(one.curve) for one in own)))
            title = MODELS[model]
            out.append(
                _by_joint(made, title, "components", at, lines, "; ".join(least))
            )
    return out


def levels(made: Calibration) -> list[Chart]:
    """Return RMSEV over the number of levels, and its time (figure 12)."""
    if made.sweep is None:
        return []
    at = list(made.sweep.levels)
    lines = {SCHEMES[name]: errors for name, errors in made.sweep.errors.items()}
    alt = f"RMSEV over {at[0]} to {at[-1]} levels"
    chart = _by_joint(made, "Error", "levels", at, lines, alt)
    style = look.line("time", look.SOFT)
    data = [{**style, "x": at, "y": [round(s, 3) for s in made.sweep.seconds]}]
    axes = look.axis("levels"), look.axis("processor time, s", rangemode="tozero")
    plot = {"data": data, "layout": look.layout("Time", *axes)}
    text = f"Time of {at[0]} to {at[-1]} levels."
    return [chart, Chart("", text, plot=plot, height=_HEIGHT)]


def _by_joint(
    made: Calibration,
    title: str,
    x: str,
    at: list[int],
    lines: Mapping[str, np.ndarray],
    alt: str,
) -> Chart:
    """Errors of each joint, the first scheme solid and the second dashed."""
    data = []
    for (name, errors), dash in zip(lines.items(), ("solid", "dash"), strict=False):
        for column, joint in enumerate(made.rows.joints):
            colour = look.JOINTS[column % len(look.JOINTS)]
            style = look.line(f"joint {joint}, {name}", colour, line={"dash": dash})
            y = [_number(v) for v in errors[:, column]]
            data.append({**style, "x": at[: len(y)], "y": y})
    axes = look.axis(x), look.axis("RMSEV, %", rangemode="tozero")
    plot = {"data": data, "layout": look.layout(title, *axes)}
    return Chart("", f"{title}: {alt}.", plot=plot, height=_HEIGHT + 60)


def _number(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 4)
