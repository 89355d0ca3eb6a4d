"""An arm and its motion as data for the page's script."""

from typing import Any

import numpy as np

from flows.report.page.drawn import look
from residual.recording import Recording
from residual.robot.shapes import Body, Look

_RATE = 40.0  # poses per second that an eye tells apart
_MOST_POSES = 6000


def frames_of(log: Recording) -> np.ndarray:
    """Return the samples that are shown as poses, evenly over time. Shape (k,)."""
    span = float(log.t[-1] - log.t[0])
    count = int(min(_MOST_POSES, len(log.t), max(2, _RATE * span)))
    at = np.linspace(log.t[0], log.t[-1], count)
    return np.unique(np.searchsorted(log.t, at))


def arm_data(arm: Look) -> dict[str, Any]:
    """Return what an arm is drawn from: joints, axes and shapes."""
    return {
        "size": round(arm.size, 4),
        "joints": [
            {"place": _columns(place), "axis": [round(float(a), 9) for a in axis]}
            for place, axis in zip(arm.places, arm.axes, strict=True)
        ],
        "bodies": [_body(body) for body in arm.bodies],
    }


def _body(body: Body) -> dict[str, Any]:
    told: dict[str, Any] = {
        "joint": body.joint,
        "kind": body.kind,
        "place": _columns(body.place),
        "size": [round(x, 6) for x in body.size],
    }
    if body.kind == "mesh":
        told["points"] = look.packed(body.points.ravel())
        told["faces"] = look.whole(body.faces.ravel())
    return told


def _columns(place: np.ndarray) -> list[float]:
    """A pose as the library takes it: sixteen numbers, column by column."""
    return [round(float(x), 9) for x in place.T.ravel()]
