"""What an answer is worth beside the truth: pure functions of both.

Silence about a change is a miss. A name is right if it is the truth's name and joints,
or if the answer itself says that the logs cannot tell the two apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.changes_parts.case import Truth
from sim.catalogue import main_parameter

Place = tuple[str, tuple[int, ...]]

# Effects whose parameters no log tells by themselves, so that no size is judged.
_NO_SIZE = ("presliding", "warmup")


@dataclass(frozen=True, slots=True)
class Said:
    """One name that an answer says, at one place.

    Attributes:
        place: Effect and joints from 1, in order.
        alike: What the answer says could be there instead.
        values: Value and standard deviation by parameter; None where not told.
    """

    place: Place
    alike: tuple[Place, ...] = ()
    values: Mapping[str, tuple[float | None, float | None]] = field(
        default_factory=dict
    )


@dataclass(frozen=True, slots=True)
class Answer:
    """What a method says of two epochs.

    Attributes:
        said: Its names, the most important first.
        flagged: Joints with a change that it has no name for.
        seconds: Processor time that it took [s].
        nats: Evidence of the first name; None without one.
        factor: Friction of all joints against the first epoch's, with its standard
            deviation; None where it says nothing of that.
        minimum: Smallest size that it would see, by place: value, None where none.
    """

    said: tuple[Said, ...]
    flagged: tuple[int, ...]
    seconds: float
    nats: float | None = None
    factor: tuple[float, float] | None = None
    minimum: tuple[tuple[Place, float | None], ...] = ()


def judged(truths: Sequence[Truth], answer: Answer) -> dict:
    """Return the part of a row that judges an answer.

    Args:
        truths: What changed; effects out of the vocabulary cannot be named rightly.
    """
    named = [(t.name, t.joints) for t in truths if not t.name.startswith("x_")]
    of_each = _given(named, answer.said)
    first = answer.said[0] if answer.said else None
    matched = [s for s in of_each if s is not None]
    extra = [s for s in answer.said if all(s is not m for m in matched)]
    there = {joint for t in truths for joint in _felt(t)}
    row = {
        "truth": [[t.name, list(t.joints)] for t in truths],
        "names": [[s.place[0], list(s.place[1])] for s in answer.said],
        "alike": [[[n, list(j)] for n, j in s.alike] for s in answer.said],
        "right_first": first is not None and any(first is m for m in matched),
        "by_name": first is not None and first.place in named,
        "found": len(matched),
        "extra": [s.place[0] for s in extra],
        "flagged": list(answer.flagged),
        "flagged_right": bool(there & set(answer.flagged)),
        "seconds": round(answer.seconds, 3),
        "nats": answer.nats,
        "told_factor": answer.factor,
    }
    return row | (_estimate(truths[0], of_each) if named else {})


def _given(named: Sequence[Place], said: Sequence[Said]) -> list[Said | None]:
    """Give each truth a name of its own: the very same first, then one of its class."""
    free, out = list(said), []
    for truth in named:
        hit = next((s for s in free if s.place == truth), None)
        out.append(hit)
        free = [s for s in free if s is not hit]
    for i, truth in enumerate(named):
        if out[i] is None:
            out[i] = next((s for s in free if truth in s.alike), None)
            free = [s for s in free if s is not out[i]]
    return out


def _felt(truth: Truth) -> tuple[int, ...]:
    """Return the joints that feel a change; of a sum over a pair only the first."""
    return truth.joints[:1] if truth.name == "x_cogging_sum" else truth.joints


def _estimate(truth: Truth, of_each: Sequence[Said | None]) -> dict:
    """Return the main parameter of the first truth beside what is said of it."""
    said = of_each[0]
    out: dict = {"key": None, "value": None, "std": None, "true": None, "z": None}
    if said is None or said.place != (truth.name, truth.joints):
        return out
    key = main_parameter(truth.name, truth.parameters)
    value, std = said.values.get(str(key), (None, None))
    if key is None or value is None:
        return out
    true = float(truth.parameters[key])
    out |= {"key": key, "value": float(value), "std": std, "true": true}
    if truth.name not in _NO_SIZE and std is not None and np.isfinite(std) and std > 0:
        out["z"] = (float(value) - true) / float(std)
    return out
