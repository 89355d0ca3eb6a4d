"""Compare a verdict with the truth of a case, as one row."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import linear_sum_assignment

from residual.effects import number_reported_joints
from residual.verdict.result import Finding, Place, Verdict
from sim.engine.plant_records import PlantEffect
from sim.plant.effect_catalogue import list_plant_effects
from tests.synthetic.amounts import find_main_parameter

SINGLE, PAIR, NOTHING, UNKNOWN = "single", "pair", "none", "unknown"

# What may come out of a case.
RIGHT = "right"  # named as it is, or rightly nothing
CLASS = "class"  # the truth is among the equivalents of the name
PART = "part"  # one of a pair named, the other not
WRONG = "wrong"  # the first name is none of what is there
SILENT = "nothing"  # something is there and nothing was said of it
FLAGGED = "flagged"  # no name, but joints with something unexplained


@dataclass(frozen=True, slots=True)
class Name:
    """An effect at its place."""

    effect: str
    joints: tuple[int, ...]  # its joints from 1, in order; () for the whole arm

    @classmethod
    def of(cls, place: Place | Finding) -> "Name":
        """Return the name of an effect at its joints."""
        return cls(place.name, tuple(sorted(place.joints)))

    @classmethod
    def hidden(cls, effect: PlantEffect, dof: int) -> "Name":
        """Return the name of an effect of the plant as a verdict has it."""
        return cls(effect.name, number_reported_joints(effect.name, effect.joints, dof))

    def __str__(self) -> str:
        return " ".join([self.effect, ",".join(map(str, self.joints))]).strip()


@dataclass(frozen=True, slots=True)
class Claim:
    """One name that an answer says, at one place."""

    name: Name  # effect and joints
    alike: tuple[Name, ...] = ()  # what the answer says could be there instead
    # Value and standard deviation by parameter; None where not stated
    values: Mapping[str, tuple[float | None, float | None]] = field(default_factory=dict)
    finding: int = 0  # number of the finding that it is from


def _parts(truths: Sequence[Name], hits: Sequence[Claim | None]) -> set[Name]:
    """Return the names that are true beside those of what was found by its own."""
    return {
        Name(part, truth.joints)
        for truth, hit in zip(truths, hits, strict=False)
        if hit is not None
        for part in list_plant_effects()[truth.effect].also
    }


def members(verdict: Verdict) -> list[Claim]:
    """Return what a verdict says, one entry per place, most important first.

    A finding of one effect on several joints is so many names; that of a pair of
    joints that share gearing is one.
    """
    out = []
    for number, finding in enumerate(verdict.effects):
        alike = [Name.of(e) for e in finding.equivalent]
        pairs = {key: p.pairs for key, p in finding.parameters.items()}
        # With a value per joint it is one thing on each.
        one_each = any(isinstance(p.value, tuple) for p in finding.parameters.values())
        if len(finding.joints) < 2 or not one_each:
            values = {key: each[0] for key, each in pairs.items()}
            out.append(Claim(Name.of(finding), tuple(alike), values, number))
            continue
        for place, joint in enumerate(finding.joints):
            near = tuple(Name(a.effect, (joint,)) for a in alike if joint in a.joints)
            own = {k: each[place if len(each) > 1 else 0] for k, each in pairs.items()}
            out.append(Claim(Name(finding.name, (joint,)), near, own, number))
    return out


def matched(truths: Sequence[Name], claims: Sequence[Claim]) -> tuple:
    """Give every truth a name of its own: the same first, then one of its class.

    Returns:
        By its very name and by class, an entry a truth, None for none; and the names
        that are no truth's.
    """
    free = list(claims)
    hits: list[Claim | None] = []
    for truth in truths:
        hits.append(next((s for s in free if s.name == truth), None))
        free = [s for s in free if s is not hits[-1]]
    classes: list[Claim | None] = []
    for truth, hit in zip(truths, hits, strict=True):
        near = next((s for s in free if truth in s.alike), None)
        classes.append(near if hit is None else None)
        free = [s for s in free if s is not classes[-1]]
    return tuple(hits), tuple(classes), free


def paired(truths: Sequence, claims: Sequence, fits: Callable) -> set[int]:
    """Return the numbers of as many truths as can have a name of their own."""
    fit = np.zeros((len(truths), len(claims)), bool)
    for i, truth in enumerate(truths):
        fit[i] = [fits(truth, claim) for claim in claims]
    each, theirs = linear_sum_assignment(fit, maximize=True)
    return set(each[fit[each, theirs]].tolist())


def _outcome(
    drawn: str, named: bool, right_first: bool, complete: bool, by_class: bool, flagged: bool
) -> str:
    if not named:
        quiet = RIGHT if drawn == NOTHING else SILENT
        return FLAGGED if flagged else quiet
    if drawn in (NOTHING, UNKNOWN) or not right_first:
        return WRONG
    if not complete:
        return PART
    return CLASS if by_class else RIGHT


def _right(truths: Sequence[Name], first: Sequence[Name], flagged: set) -> bool | None:
    if not truths or not (first or flagged):
        return None
    if first:
        return any(name.joints == truth.joints for name in first for truth in truths)
    there = {joint for truth in truths for joint in truth.joints}
    # What is on the whole arm may show anywhere.
    return bool(there & flagged) or not there


def is_right(row: Mapping) -> bool:
    """Whether a case was named as it is, or in the class of what is there."""
    return row["outcome"] in (RIGHT, CLASS)


def case_row(
    drawn: str,
    hidden: Sequence[tuple[Name, float | None]],
    truths: Sequence[Mapping[str, float]],
    verdict: Verdict,
    oracle: float | None,
) -> dict:
    """Return a case as one row: what was hidden, what was said, what that is worth.

    `found` is how many of the hidden effects are named, by name or by class, `extra`
    how many names are none of them and no part of them. `joint_right` is whether the
    first name, or where there is none the flag, is on a joint of what was hidden; None
    where nothing was hidden or nothing said.

    Args:
        hidden: Names with their shares of the torque of their joint, where drawn so.
            Out of the vocabulary ("x_...") no name can be right.
        truths: True parameters of each, as a verdict would state them.
        oracle: Held-out error of the true effects fitted [%], None where they have no
            name.
    """
    names, claims = [name for name, _ in hidden], members(verdict)
    flagged = set(verdict.unexplained.joints)
    hits, classes, free = matched(names if drawn != UNKNOWN else (), claims)
    # One finding may be on several joints, and their order says nothing.
    said = [s for s in claims if s.finding == 0]
    right = [s for s in said if all(s is not f for f in free)]
    count = sum(h is not None for h in (*hits, *classes))
    complete, by_class = count == len(hits), any(c is not None for c in classes)
    first, second, *_ = *([n.effect, list(n.joints), x] for n, x in hidden), None, None
    each = zip(names, hits, truths, strict=False)
    found = [(name.effect, deviation(claim, true)) for name, claim, true in each]
    return {
        "drawn": drawn,
        **dict(zip(("effect", "joints", "share"), first or 3 * (None,), strict=True)),
        "second": second,
        "verdict": verdict.verdict,
        "named_first": (right or said)[0].name.effect if said else None,
        "named": len(claims),
        "outcome": _outcome(drawn, bool(claims), bool(right), complete, by_class, bool(flagged)),
        "found": count,
        "extra": sum(s.name not in _parts(names, hits) for s in free),
        "joint_right": _right(names, [s.name for s in said], flagged),
        "unexplained": list(verdict.unexplained.joints),
        "error_after": verdict.error.overall_filtered["augmented"],
        "error_oracle": oracle,
        "deviations": [[name, z] for name, z in found if z is not None],
    }


def deviation(claim: Claim | None, true: Mapping[str, float]) -> float | None:
    """Return by how many standard deviations the main parameter of a name is off."""
    key = find_main_parameter(claim.name.effect, true) if claim else None
    value, std = claim.values.get(str(key), (None, None)) if claim else (None, None)
    return (value - float(true[key])) / std if value is not None and std else None
