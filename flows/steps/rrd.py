"""A recording for the Rerun viewer: the arm moving, its torque, effect by effect."""

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.export.export import (
    AnyModel,
    ModelExport,
    excitation,
    file_stem,
    split,
    without_tables,
)
from residual.recording import Array, Recording
from residual.robot.dynamics import chain_of
from residual.signals.track import prepare

APP, CLOCK, ARM = "modelgap", "time", "arm"
THICK = 0.02  # m, of the lines that stand for links


def make_rrd(source: AnyModel, log: Recording | None = None) -> ModelExport:
    """Return a recording of a log, or of the exports' motion where there is none."""
    try:
        import rerun as rr
    except ImportError as error:
        raise InputError(
            "This target needs Rerun, which is not installed. Install the extra: pip "
            "install '.[export]' in the checkout."
        ) from error
    model = without_tables(source)
    if log is None:
        motion = excitation(model.robot)
        t, q = motion.t, motion.q
        torque = _torque(source, model.state(1 / t[1], t, motion.parts))
    else:
        (track,), _ = prepare([log], model.filters, model.speed_floor, True)
        t, q, torque = track.t, track.q, _torque(source, model.observe(track))
        measured = np.column_stack([np.interp(t, log.t, c) for c in log.tau.T])
        torque |= {"measured": measured, "residual": measured - torque["model"]}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.rrd"
        stream = rr.RecordingStream(APP, recording_id=file_stem(source))
        stream.save(str(path))
        _draw(rr, stream, source, t, q, torque)
        stream.flush()
        stream.disconnect()
        content = path.read_bytes()
    made = split(source, lambda term: "")
    return replace(made, files={f"{file_stem(source)}.rrd": content})


def _torque(source: AnyModel, state) -> dict[str, Array]:
    """Torque of the model [N m], and what it is the sum of. Shapes (n, dof)."""
    model, total = without_tables(source), source.torque_of_state(state)
    parts = {"model": total, "of/rigid_body": state.regressor @ model.inertial}
    for term in model.terms:
        name = f"of/{term.effect.name}"
        parts[name] = parts.get(name, 0.0) + term.torque(state)
    if source is not model:
        parts["of/tables"] = total - model.torque_of_state(state)
    return parts


def _draw(
    rr, stream, source: AnyModel, t: Array, q: Array, torque: Mapping[str, Array]
) -> None:
    clock = [rr.TimeColumn(CLOCK, duration=t)]
    for name, values in torque.items():
        for j, column in enumerate(values.T):
            # What acts on other joints alone would be a flat line here.
            if column.any() or not name.startswith("of/"):
                path = f"torque/joint_{j + 1}/{name}"
                stream.send_columns(path, clock, rr.Scalars.columns(scalars=column))
    chain, path = chain_of(without_tables(source).robot.model), ARM
    _line(rr, stream, path, chain.place[0])
    for j, end in enumerate([*chain.place[1:], chain.flange]):
        path = f"{path}/link_{j + 1}"
        turns = [
            pin.Quaternion(chain.rotation[j] @ pin.AngleAxis(x, chain.axis[j]).matrix())
            for x in q[:, j]
        ]
        pose = rr.Transform3D.columns(
            translation=np.tile(chain.place[j], (len(turns), 1)),
            quaternion=np.array([turn.coeffs() for turn in turns]),
        )
        stream.send_columns(path, clock, pose)
        _line(rr, stream, path, end)


def _line(rr, stream, path: str, end: Array) -> None:
    strip = rr.LineStrips3D([np.array([np.zeros(3), end])], radii=THICK)
    stream.log(path, strip, static=True)
