"""The state of a stream as JSON can hold it, and back, to the last bit."""

from collections.abc import Mapping
from dataclasses import asdict, fields

import numpy as np

from residual.errors import InputError
from residual.monitoring.stream.rows import Heard, Samples, Tail
from residual.monitoring.stream.watch import State
from residual.names import shown

FORM = 1
_ARRAYS = ("lags", "rest", "slow", "g", "sums")
_PLAIN = ("count", "left", "moved", "alarms")


def state_to_record(state: State) -> dict:
    """Return the state of a stream."""
    kept = state.tail.kept
    return {
        "form": FORM,
        "dof": kept.q.shape[1],
        "kept": {f.name: getattr(kept, f.name).tolist() for f in fields(Samples)},
        "in_piece": state.tail.count,
        "heard": asdict(state.tail.heard),
        **{name: getattr(state, name).tolist() for name in _ARRAYS},
        **{name: getattr(state, name) for name in _PLAIN},
    }


def state_from_record(record: Mapping) -> State:
    """Return the state of a record.

    Raises:
        InputError: If it is of another form, or damaged.
    """
    if record.get("form") != FORM:
        raise InputError(
            f"A state of form {shown(record.get('form'))}, expected {FORM}. Delete it "
            "to begin anew."
        )
    try:
        dof, kept = record["dof"], record["kept"]
        wide = (np.array(kept[name], float).reshape(-1, dof) for name in ("q", "tau"))
        tail = Tail(
            kept=Samples(np.array(kept["t"], float), *wide),
            count=record["in_piece"],
            heard=Heard(**record["heard"]),
        )
        arrays = {name: np.array(record[name]) for name in _ARRAYS}
        return State(tail, **arrays, **{name: record[name] for name in _PLAIN})
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"The state of the stream is damaged: {error}.") from error
