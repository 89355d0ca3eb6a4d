"""All that a stream has to know of what was before, and as JSON can hold it."""

import base64
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields

import numpy as np

from residual.epochs.window import Past
from residual.errors import InputError
from residual.monitoring.rows import Heard, Rows, Samples, Tail
from residual.names import shown
from residual.recording import Array

FORM = 2
_PLAIN = ("clock", "last", "left", "waited", "moved", "alarms")


@dataclass(frozen=True, eq=False, slots=True)
class State:
    """A stream at one moment.

    Attributes:
        tail: Of the samples.
        rows: Rows in which a joint moves, of the bin that is not full yet.
        use: Where each joint of them counts. Shape (k, dof), bool.
        clocks: Time of each, gaps counted [s]. Shape (k,).
        since: Rows since each joint stood. Shape (dof,).
        past: Sums of the bins before.
        clock: Time of the last row, gaps counted [s].
        last: The same on the clock of the stream; NaN before the first [s].
        left: Bins of motion until the last alarm is over.
        waited: Bins that an alarm waits for its name.
        moved: Rows of motion so far.
        alarms: How many there were.
    """

    tail: Tail
    rows: Rows
    use: Array
    clocks: Array
    since: Array
    past: Past
    clock: float = 0.0
    last: float = float("nan")
    left: int = 0
    waited: int = 0
    moved: int = 0
    alarms: int = 0


def packed(values: Array) -> dict:
    """Return an array as JSON can hold it, to the last bit."""
    values = np.ascontiguousarray(values)
    bits = base64.b64encode(values.tobytes()).decode()
    return {"kind": values.dtype.str, "shape": list(values.shape), "bits": bits}


def unpacked(record: Mapping) -> Array:
    """Return the array of a record."""
    bits = base64.b64decode(record["bits"])
    return np.frombuffer(bits, record["kind"]).reshape(record["shape"]).copy()


def state_to_record(state: State) -> dict:
    """Return the state of a stream."""
    return {
        "form": FORM,
        "kept": _arrays(state.tail.kept),
        "in_piece": state.tail.count,
        "heard": asdict(state.tail.heard),
        "rows": _arrays(state.rows),
        "past": _arrays(state.past),
        **{name: packed(getattr(state, name)) for name in ("use", "clocks", "since")},
        **{name: getattr(state, name) for name in _PLAIN},
        "last": packed(np.array([state.last])),
    }


def state_from_record(record: Mapping) -> State:
    """Return the state of a record.

    Raises:
        InputError: If it is of another form, or damaged.
    """
    if record.get("form") != FORM:
        raise InputError(
            f"A state of form {shown(record.get('form'))}, expected {FORM}. Delete it "
            "to begin anew: healthy runs have to be learnt again."
        )
    try:
        heard = Heard(**record["heard"])
        tail = Tail(Samples(**_read(record["kept"])), record["in_piece"], heard)
        plain = {name: record[name] for name in _PLAIN}
        return State(
            tail=tail,
            rows=Rows(**_read(record["rows"])),
            past=Past(**_read(record["past"])),
            **{name: unpacked(record[name]) for name in ("use", "clocks", "since")},
            **plain | {"last": float(unpacked(record["last"])[0])},
        )
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"The state of the stream is damaged: {error}.") from error


def _arrays(record) -> dict:
    return {f.name: packed(getattr(record, f.name)) for f in fields(record)}


def _read(record: Mapping) -> dict:
    return {name: unpacked(own) for name, own in record.items()}
