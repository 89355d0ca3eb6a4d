"""Compare an answer with the truth at two levels, and its torque with the oracle's.

`name`: effect and joints as hidden, or one of the equivalents that the answer states.
`class`: link inertia or load (body), friction or rotor (joint), or the rest (other), on
a common joint; names of one class on one joint count once, and "unknown" stands for a
hidden "other" on its joints, so that a program without a name for a spring can say so.
Each truth has one name of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.hidden.score import UNKNOWN, Name, paired
from benchmarks.peers_parts.linear_model import Answer, Array
from residual.effects import load_effects
from residual.effects.base import EffectTrait
from residual.recording import Recording

BLOCK, EDGE = 25, 5  # samples that are averaged; averages dropped at both ends
# At standstill any torque up to friction holds; it is told over so many samples.
SPEED, SPAN = 0.05, 10  # rad/s
BODY, JOINT, OTHER = "body", "joint", "other"


@dataclass(frozen=True, eq=False, slots=True)
class Truth:
    """What a case hides."""

    kind: str  # one effect, two, nothing, or one that has no name
    effects: tuple[Name, ...]
    # By log whose torque is kept back: the log, the oracle's torque [N m], and the
    # number of the effect that is gone, None where all are there
    torque: dict[str, tuple[Recording, Array, int | None]] = field(default_factory=dict)


def class_of(name: str) -> str:
    """Return "body", "joint" (friction and rotor) or "other"."""
    effect = load_effects()[name]
    if effect.carries == BODY or effect.replaces_link:
        return BODY
    # Two joints that share a gear share its friction.
    drive = EffectTrait.FRICTION in effect.traits or effect.scope == "pair"
    drive = drive or effect.carries == "acceleration"
    return JOINT if drive else OTHER


def _is_same_class(one: Name, other: Name) -> bool:
    """Whether two names of classes may be the same: of one class, on a common joint."""
    apart = one.joints and other.joints and not set(one.joints) & set(other.joints)
    return one.effect == other.effect and not apart


def _classed(name: Name) -> Name:
    return Name(class_of(name.effect), name.joints)


LEVELS = ("name", "class")


def compare(true: Truth, answer: Answer) -> dict:
    flag, where = bool(answer.unknown), answer.unknown
    where = tuple(where) if isinstance(where, list) else ()
    # An effect without a name cannot be named: only the flag is right.
    there = () if true.kind == UNKNOWN else true.effects
    classes = tuple(dict.fromkeys(map(_classed, there)))
    said = tuple(dict.fromkeys(_classed(names[0]) for names in answer.findings))
    by_name = paired(there, answer.findings, lambda truth, names: truth in names)
    by_class = paired(classes, said, _is_same_class)
    missing = [t for i, t in enumerate(classes) if i not in by_class]
    if flag:
        missing = [t for t in missing if not _is_same_class(t, Name(OTHER, where))]
    exact = {
        "name": len(by_name) == len(there) == len(answer.findings),
        "class": not missing and len(by_class) == len(said),
    }
    if not there:
        right = not answer.findings and flag is (true.kind == UNKNOWN)
        exact = dict.fromkeys(exact, right)
    on = {j for names in answer.findings for j in names[0].joints} or set(where)
    real = {j for name in true.effects for j in name.joints}
    return {
        "kind": true.kind,
        **{f"exact_{level}": value for level, value in exact.items()},
        "named": bool(answer.findings),
        "flagged": flag,
        # None if nothing is hidden on a joint, or nothing stated of one.
        "joint": bool(on & real) if real and on else None,
        **_torque_ratios(true, answer),
    }


def _torque_ratios(true: Truth, answer: Answer) -> dict:
    """Return errors over the oracle's: held-out, and of each effect taken out again."""
    held, edits = [], []
    for name, (log, oracle, gone) in true.torque.items():
        if gone is None:
            held.append(_misses(log, oracle, answer.predictions[name]))
        elif k := _stands_for(true.effects[gone], answer):
            own = answer.predictions[f"finding_{k}_{name}"]
            edits.append(_ratio([_misses(log, oracle, own)]))
    return {"held_out": _ratio(held) if held else None, "edits": edits}


def _stands_for(truth: Name, answer: Answer) -> int | None:
    """Return the number (from 1) of the finding that stands for an effect, or None."""
    for fits in (
        lambda names: truth == names[0],
        lambda names: truth in names,
        lambda names: _is_same_class(_classed(truth), _classed(names[0])),
    ):
        for number, names in enumerate(answer.findings, start=1):
            if fits(names):
                return number
    return None


def _misses(log: Recording, *torques: Array) -> list[float]:
    """Return squared errors of oracle and program where joints move [N^2 m^2]."""
    later = np.minimum(np.arange(len(log.t)) + SPAN, len(log.t) - 1)
    before = np.maximum(np.arange(len(log.t)) - SPAN, 0)
    least = SPEED * (log.t[later] - log.t[before])[:, None]
    moves = np.abs(log.q[later] - log.q[before]) > least
    inside = _smooth(moves.astype(float)) > 1 - 1e-6
    return [float((_smooth(x - log.tau)[inside] ** 2).sum()) for x in torques]


def _smooth(rows: Array) -> Array:
    """Return means of samples in blocks, without the ends. Shape (n // BLOCK, dof)."""
    n = len(rows) // BLOCK
    return rows[: n * BLOCK].reshape(n, BLOCK, -1).mean(axis=1)[EDGE:-EDGE]


def _ratio(misses: Sequence[Sequence[float]]) -> float | None:
    """Return the program's error over the oracle's, of all logs together."""
    oracle, own = np.sum(misses, axis=0)
    return float(np.sqrt(own / oracle)) if oracle > 0 else None
