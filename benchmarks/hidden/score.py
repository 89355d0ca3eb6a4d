"""Compare a verdict with the truth of a case, as one row."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

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


@dataclass(frozen=True, slots=True)
class Score:
    """What a verdict is worth."""

    outcome: str  # ``RIGHT`` to ``FLAGGED``
    first: Name | None  # what was named first, None for nothing
    count: int  # how many of the drawn effects are named, by name or by class
    extra: int  # how many names are none of them and no part of them, in all
    # Whether the first name, or where there is none the flag, is on a joint of what was
    # drawn; None where nothing was drawn or nothing said.
    joint_right: bool | None
    # What was said of each drawn effect by its very name; None otherwise.
    hits: tuple[Claim | None, ...]


def score(drawn: str, truths: Sequence[Name], verdict: Verdict) -> Score:
    """Judge a verdict.

    Args:
        truths: What is there: one effect, two of a pair, none. Out of the vocabulary
            ("x_...") no name can be right.
    """
    claims = members(verdict)
    flagged = set(verdict.unexplained.joints)
    hits, classes, free = matched(truths if drawn != UNKNOWN else (), claims)
    # One finding may be on several joints, and their order says nothing.
    first = [s for s in claims if s.finding == 0]
    right = [s for s in first if all(s is not f for f in free)]
    count = sum(h is not None for h in (*hits, *classes))
    state = (count == len(hits), any(c is not None for c in classes))
    return Score(
        outcome=_outcome(drawn, bool(claims), bool(right), state, bool(flagged)),
        first=(right or first)[0].name if first else None,
        count=count,
        extra=sum(s.name not in _parts(truths, hits) for s in free),
        joint_right=_right(truths, [s.name for s in first], flagged),
        hits=hits,
    )


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


def paired(truths: Sequence, claims: Sequence, fits: Callable) -> dict[int, int]:
    """Return the number of a name for as many truths as can have one, by theirs.

    Augmenting paths (Kuhn 1955): a name gives way to another if it has a second choice.
    """
    owner: dict[int, int] = {}

    def place(name: int, tried: set[int]) -> bool:
        for i, truth in enumerate(truths):
            if i not in tried and fits(truth, claims[name]):
                tried.add(i)
                if i not in owner or place(owner[i], tried):
                    owner[i] = name
                    return True
        return False

    for name in range(len(claims)):
        place(name, set())
    return owner


def _outcome(
    drawn: str, named: bool, right_first: bool, state: tuple[bool, bool], flagged: bool
) -> str:
    if not named:
        quiet = RIGHT if drawn == NOTHING else SILENT
        return FLAGGED if flagged else quiet
    if drawn in (NOTHING, UNKNOWN) or not right_first:
        return WRONG
    complete, by_class = state
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

    Args:
        hidden: Names with their shares of the torque of their joint, where drawn so.
        truths: True parameters of each, as a verdict would state them.
        oracle: Held-out error of the true effects fitted [%], None where they have no
            name.
    """
    judged = score(drawn, [name for name, _ in hidden], verdict)
    first, second, *_ = *([n.effect, list(n.joints), x] for n, x in hidden), None, None
    each = zip(hidden, judged.hits, truths, strict=False)
    found = [(name.effect, deviation(claim, true)) for (name, _), claim, true in each]
    return {
        "drawn": drawn,
        **dict(zip(("effect", "joints", "share"), first or 3 * (None,), strict=True)),
        "second": second,
        "verdict": verdict.verdict,
        "named_first": judged.first and judged.first.effect,
        "named": len(members(verdict)),
        "outcome": judged.outcome,
        "found": judged.count,
        "extra": judged.extra,
        "joint_right": judged.joint_right,
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
