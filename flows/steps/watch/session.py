"""What a watch knows: what is usual, where the stream is, and rows for a diagnosis."""

import io
import json
from dataclasses import dataclass, replace
from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from residual.errors import InputError
from residual.monitoring.reference import Reference
from residual.monitoring.rows import Samples
from residual.monitoring.watch import (
    Change,
    State,
    begin,
    state_from_record,
    state_to_record,
    step,
)
from warehouse.files import sync

BEFORE, AFTER = 5.0, 20.0  # s around an alarm that are diagnosed
FORM = 2


@dataclass(frozen=True, slots=True)
class Origin:
    """What a reference was learnt from.

    Attributes:
        robot: Name of the robot.
        robot_hash: Hash of its description.
        diagnosis: Id of the diagnosis whose model expects the torque; None for the
            nominal one.
        good: Ids of the healthy runs.
    """

    robot: str
    robot_hash: str
    diagnosis: str | None
    good: tuple[str, ...]


@dataclass(frozen=True, eq=False, slots=True)
class Session:
    """A watch at one moment.

    Attributes:
        origin: What its reference was learnt from.
        reference: What is usual.
        state: State of the stream.
        recent: Samples since some seconds before the first alarm that is not diagnosed
            yet, or the last seconds.
        waiting: Alarms that wait for samples to be diagnosed.
        position: Where the source goes on.
    """

    origin: Origin
    reference: Reference
    state: State
    recent: Samples
    waiting: tuple[Change, ...] = ()
    position: dict | None = None


def new_session(
    origin: Origin, reference: Reference, position: dict | None = None
) -> Session:
    """Return a watch before its first sample."""
    state = begin(reference)
    return Session(origin, reference, state, state.tail.kept, (), position)


def advance(session: Session, samples: Samples) -> tuple[Session, tuple[Change, ...]]:
    """Look at new samples; keep those that a diagnosis may need."""
    state, alarms = step(session.reference, session.state, samples)
    recent = _usable(_joined(session.recent, samples))
    if not session.waiting and not alarms and len(recent.t):
        recent = recent[recent.t >= recent.t[-1] - 2 * BEFORE]
    waiting = (*session.waiting, *alarms)
    return replace(session, state=state, recent=recent, waiting=waiting), alarms


def due(session: Session, last: bool = False) -> bool:
    """Return whether the first alarm has all samples that its diagnosis is to have."""
    if not session.waiting or not len(session.recent.t):
        return False
    return last or session.recent.t[-1] >= session.waiting[0].time + AFTER


def around(session: Session) -> Samples:
    """Return the samples of the first waiting alarm: since what it saw began."""
    alarm = session.waiting[0]
    start = alarm.time - min(alarm.motion, BEFORE)
    t = session.recent.t
    return session.recent[(t >= start) & (t <= alarm.time + AFTER)]


def settled(session: Session) -> Session:
    """Return the session without the alarms of the same rows as the first."""
    alarm = session.waiting[0]
    later = tuple(a for a in session.waiting if a.time > alarm.time + AFTER)
    return replace(session, waiting=later)


def _joined(one: Samples, other: Samples) -> Samples:
    names = ("t", "q", "tau")
    return Samples(
        *(np.concatenate([getattr(one, n), getattr(other, n)]) for n in names)
    )


def _usable(samples: Samples) -> Samples:
    """Samples that are numbers, since the clock was set back the last time."""
    whole = np.isfinite(np.column_stack([samples.t, samples.q, samples.tau])).all(1)
    samples = samples[whole]
    back = np.flatnonzero(np.diff(samples.t) <= 0)
    return samples[int(back[-1]) + 1 :] if len(back) else samples


def write(path: Path, session: Session) -> None:
    """Keep a watch in a file, whole or not at all.

    Args:
        path: The file; its folder must be there.
    """
    about = {
        "form": FORM,
        "origin": {f: getattr(session.origin, f) for f in Origin.__slots__},
        "reference": session.reference.to_record(),
        "state": state_to_record(session.state),
        "waiting": [
            {f: getattr(a, f) for f in Change.__slots__} for a in session.waiting
        ],
        "position": session.position,
    }
    packed = io.BytesIO()
    recent = session.recent
    text = np.array(json.dumps(about))
    np.savez(packed, about=text, t=recent.t, q=recent.q, tau=recent.tau)
    draft = path.with_name(f".{path.name}.part")
    draft.write_bytes(packed.getvalue())
    sync(draft)
    draft.replace(path)
    sync(path.parent)


def read(path: Path) -> Session | None:
    """Return the watch of a file; None where there is none.

    Raises:
        InputError: If it is no such file, or of another version.
    """
    if not path.exists():
        return None
    try:
        with np.load(path, allow_pickle=False) as kept:
            about = json.loads(str(kept["about"]))
            recent = Samples(kept["t"], kept["q"], kept["tau"])
        if about["form"] != FORM:
            raise InputError(f"form {about['form']}")
        origin = about["origin"]
        return Session(
            origin=Origin(**origin | {"good": tuple(origin["good"])}),
            reference=Reference.from_record(about["reference"]),
            state=state_from_record(about["state"]),
            recent=recent,
            waiting=tuple(Change(**each) for each in about["waiting"]),
            position=about["position"],
        )
    except (OSError, ValueError, KeyError, TypeError, BadZipFile, InputError) as error:
        raise InputError(
            f"{path} is no state of this version of modelgap watch ({error}). Name "
            "another with --state, or delete it to begin anew."
        ) from error
