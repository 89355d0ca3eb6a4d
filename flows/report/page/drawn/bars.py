"""Bars of the held-out error, joint by joint, before and after."""

from collections.abc import Mapping, Sequence

from flows.report.page.drawn import look
from flows.report.words.rows import METRICS, ErrorRow
from residual.quantity import bare_percent, known

HEIGHT = 270
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
    found = {s: [v[s] for v in values if known(v.get(s))] for s in stages}
    rest = [v for s, listed in found.items() if s != "nominal" for v in listed]
    everything = [v for listed in found.values() for v in listed]
    most = max(everything, default=1.0)
    return max(min(most, _CLIP * max(rest, default=most)), 1e-6)
