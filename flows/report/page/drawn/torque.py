"""Torque of a joint over time: measured, and predicted before and after."""

from collections.abc import Sequence

import numpy as np

from flows.report.page.drawn import look, thin
from residual.model.compare import LogProof

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
