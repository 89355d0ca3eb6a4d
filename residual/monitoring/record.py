"""A monitor as plain numbers that JSON can hold, and back."""

from collections.abc import Mapping
from dataclasses import fields

import numpy as np

from residual.errors import InputError
from residual.model.model import Model
from residual.monitoring.monitor import Monitor
from residual.monitoring.scores import Scale
from residual.recording import Array

FORM = 1
_ARRAYS = ("theta", "lowest", "highest")
_PLAIN = ("rate", "per_hour", "hours", "referenced")


def to_record(monitor: Monitor) -> dict:
    """Return a monitor whole, with its model.

    A limit that is never reached is null.
    """
    scale = {f.name: getattr(monitor.scale, f.name).tolist() for f in fields(Scale)}
    return {
        "form": FORM,
        "robot": monitor.model.robot.name,
        "model": monitor.model.to_record(),
        **{name: getattr(monitor, name) for name in _PLAIN},
        **{name: getattr(monitor, name).tolist() for name in _ARRAYS},
        "scale": scale,
        "limits": {kind: _told(limit) for kind, limit in monitor.limits.items()},
    }


def from_record(record: Mapping) -> Monitor:
    """Return the monitor of a record.

    Args:
        record: What ``to_record`` returned.

    Raises:
        InputError: If it is of another form, or its model is damaged.
    """
    if record.get("form") != FORM or "model" not in record:
        raise InputError(
            f"A monitor of form {record.get('form')!r}, expected {FORM} with its "
            "model. Calibrate it again."
        )
    scale = Scale(**{f.name: np.array(record["scale"][f.name]) for f in fields(Scale)})
    return Monitor(
        model=Model.from_record(record["model"]),
        scale=scale,
        limits={k: _read(limit) for k, limit in record["limits"].items()},
        **{name: record[name] for name in _PLAIN},
        **{name: np.array(record[name]) for name in _ARRAYS},
    )


def _told(limit: Array) -> list[float | None]:
    return [float(x) if np.isfinite(x) else None for x in limit]


def _read(limit: list) -> Array:
    return np.array([np.inf if x is None else x for x in limit])
