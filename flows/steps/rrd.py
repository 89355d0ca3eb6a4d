"""A recording for the Rerun viewer: the arm moving, its torque, effect by effect."""

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.export.exported import (
    Exported,
    Whole,
    body_of,
    exciting,
    file_stem,
    split,
)
from residual.recording import Array, Recording
from residual.robot.dynamics import chain_of
from residual.signals.track import Track, prepare

APP, CLOCK, ARM = "modelgap", "time", "arm"
THICK = 0.02  # m, of the lines that stand for links


@dataclass(frozen=True, eq=False, slots=True)
class Shown:
    """What is to be seen."""

    t: Array  # Time [s]. Shape (n,).
    q: Array  # Positions [rad]. Shape (n, dof).
    # Torque of each joint by what it is of [N m]. Shapes (n, dof).
    torque: Mapping[str, Array]


def make_rrd(whole: Whole, log: Recording | None = None) -> Exported:
    """Return a recording of a log, or of a usual motion where there is none."""
    try:
        import rerun as rr
    except ImportError as error:
        raise InputError(
            "This target needs Rerun, which is not installed. Install the extra: pip "
            "install '.[export]' in the checkout."
        ) from error
    shown = _of_log(whole, log) if log else _of_motion(whole)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.rrd"
        stream = rr.RecordingStream(APP, recording_id=file_stem(whole))
        stream.save(str(path))
        _draw(rr, stream, whole, shown)
        stream.flush()
        stream.disconnect()
        content = path.read_bytes()
    name = f"{file_stem(whole)}.rrd"
    return split(whole, lambda term: "").exported({name: content})


def _of_motion(whole: Whole) -> Shown:
    model, motion = body_of(whole), exciting(body_of(whole).robot)
    state = model.state(1 / motion.t[1], motion.t, motion.parts)
    return Shown(motion.t, motion.q, dict(_parts(whole, state)))


def _of_log(whole: Whole, log: Recording) -> Shown:
    model = body_of(whole)
    tracks, _ = prepare([log], model.filters, model.speed_floor, True)
    track: Track = tracks[0]
    parts = dict(_parts(whole, model.observe(track)))
    measured = np.column_stack([np.interp(track.t, log.t, c) for c in log.tau.T])
    beside = {"measured": measured, "residual": measured - parts["model"]}
    return Shown(track.t, track.q, parts | beside)


def _parts(whole: Whole, state) -> Iterator[tuple[str, Array]]:
    """Torque of the model, and what it is the sum of."""
    model = body_of(whole)
    rigid = state.regressor @ model.inertial
    parts = {"of/rigid_body": rigid}
    for term in model.terms:
        name = f"of/{term.effect.name}"
        parts[name] = parts.get(name, 0.0) + term.torque(state)
    total = whole.torque_of_state(state)
    if whole is not model:
        parts["of/tables"] = total - model.torque_of_state(state)
    yield "model", total
    yield from parts.items()


def _draw(rr, stream, whole: Whole, shown: Shown) -> None:
    clock = [rr.TimeColumn(CLOCK, duration=shown.t)]
    for name, torque in shown.torque.items():
        for j, values in enumerate(torque.T):
            # What acts on other joints alone would be a flat line here.
            if values.any() or not name.startswith("of/"):
                path = f"torque/joint_{j + 1}/{name}"
                stream.send_columns(path, clock, rr.Scalars.columns(scalars=values))
    chain, path = chain_of(body_of(whole).robot.model), ARM
    ends = [*chain.place[1:], chain.flange]
    _line(rr, stream, path, chain.place[0])
    for j, end in enumerate(ends):
        path = f"{path}/link_{j + 1}"
        turns = [
            pin.Quaternion(chain.rotation[j] @ pin.AngleAxis(q, chain.axis[j]).matrix())
            for q in shown.q[:, j]
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
