"""Compare an answer with the truth at two levels.

`name`: effect and joints as hidden, or one of the equivalents that the answer states.
`class`: link inertia or load (body), friction or rotor (joint), or the rest (other), on
a common joint; names of one class on one joint count once, and "unknown" stands for a
hidden "other" on its joints, so that a program without a name for a spring can say so.
Each truth has one name of its own.
"""

from collections.abc import Sequence

from benchmarks.hidden.score import UNKNOWN, Name, paired
from benchmarks.peers_parts.linear_model import Answer
from residual.effects import load_effects
from residual.effects.base import EffectTrait

BODY, JOINT, OTHER = "body", "joint", "other"


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


def compare(kind: str, hidden: Sequence[Name], answer: Answer) -> dict:
    flag, where = bool(answer.unknown), answer.unknown
    where = tuple(where) if isinstance(where, list) else ()
    # An effect without a name cannot be named: only the flag is right.
    there = () if kind == UNKNOWN else hidden
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
        right = not answer.findings and flag is (kind == UNKNOWN)
        exact = dict.fromkeys(exact, right)
    on = {j for names in answer.findings for j in names[0].joints} or set(where)
    real = {j for name in hidden for j in name.joints}
    return {
        "kind": kind,
        **{f"exact_{level}": value for level, value in exact.items()},
        "named": bool(answer.findings),
        "flagged": flag,
        # None if nothing is hidden on a joint, or nothing stated of one.
        "joint": bool(on & real) if real and on else None,
    }
