"""What a verdict is worth beside the truth: pure functions of both."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.stats import binomtest

from residual.diagnosis.result import Finding, Place, Verdict
from sim.plant.catalogue import kinds

SINGLE, PAIR, NOTHING, UNKNOWN = "single", "pair", "none", "unknown"
DRAWN = (SINGLE, PAIR, NOTHING, UNKNOWN)

# What may come out of a case.
RIGHT = "right"  # named as it is, or rightly nothing
CLASS = "class"  # the truth is among the equivalents of the name
PART = "part"  # one of a pair named, the other not
WRONG = "wrong"  # the first name is none of what is there
SILENT = "nothing"  # something is there and nothing was said of it
FLAGGED = "flagged"  # no name, but joints with something unexplained
OUTCOMES = (RIGHT, CLASS, PART, WRONG, SILENT, FLAGGED)


@dataclass(frozen=True, slots=True)
class Name:
    """An effect at its place."""

    effect: str
    joints: tuple[int, ...]  # its joints from 1, in order; () for the whole arm

    @classmethod
    def of(cls, place: Place | Finding) -> "Name":
        """Return the name of an effect at its joints."""
        return cls(place.name, tuple(sorted(place.joints)))

    def __str__(self) -> str:
        return " ".join([self.effect, ",".join(map(str, self.joints))]).strip()


@dataclass(frozen=True, slots=True)
class Said:
    """One name that a verdict says, at one place."""

    name: Name  # effect and joints
    alike: tuple[Name, ...]  # what the verdict says could be there instead
    finding: Finding = field(compare=False, hash=False)  # the finding that it is from
    # Its number among the joints of a finding on several; None where the finding is one
    # thing.
    place: int | None = None


@dataclass(frozen=True, slots=True)
class Score:
    """What a verdict is worth."""

    outcome: str  # one of ``OUTCOMES``
    first: Name | None  # what was named first, None for nothing
    found: int  # how many of the drawn effects are named, by name or by class
    extra: int  # how many names are none of them and no part of them, in all
    # Whether the first name, or where there is none the flag, is on a joint of what was
    # drawn; None where nothing was drawn or nothing said.
    joint_right: bool | None
    # What was said of each drawn effect by its very name; None otherwise.
    hits: tuple[Said | None, ...]


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
    first = [s for s in claims if s.finding is claims[0].finding]
    right = [s for s in first if all(s is not f for f in free)]
    found = sum(h is not None for h in (*hits, *classes))
    state = (found == len(hits), any(c is not None for c in classes))
    return Score(
        outcome=_outcome(drawn, bool(claims), bool(right), state, bool(flagged)),
        first=(right or first)[0].name if first else None,
        found=found,
        extra=sum(s.name not in _parts(truths, hits) for s in free),
        joint_right=_joint_right(truths, [s.name for s in first], flagged),
        hits=hits,
    )


def _parts(truths: Sequence[Name], hits: Sequence[Said | None]) -> set[Name]:
    """Return the names that are true beside those of what was found by its own."""
    return {
        Name(part, truth.joints)
        for truth, hit in zip(truths, hits, strict=False)
        if hit is not None
        for part in kinds()[truth.effect].also
    }


def members(verdict: Verdict) -> list[Said]:
    """Return what a verdict says, one entry per place, most important first.

    A finding of one effect on several joints is so many names; that of a pair of
    joints that share gearing is one.
    """
    out = []
    for found in verdict.effects:
        alike = [Name.of(e) for e in found.equivalent]
        # With a value per joint it is one thing on each.
        one_each = any(isinstance(p.value, tuple) for p in found.parameters.values())
        if len(found.joints) < 2 or not one_each:
            out.append(Said(Name.of(found), tuple(alike), found))
            continue
        for place, joint in enumerate(found.joints):
            near = tuple(Name(a.effect, (joint,)) for a in alike)
            out.append(Said(Name(found.name, (joint,)), near, found, place))
    return out


def matched(truths: Sequence[Name], claims: Sequence[Said]) -> tuple:
    """Give every truth a name of its own: the same first, then one of its class.

    Returns:
        By its very name and by class, an entry a truth, None for none; and the names
        that are no truth's.
    """
    free = list(claims)
    hits: list[Said | None] = []
    for truth in truths:
        hits.append(next((s for s in free if s.name == truth), None))
        free = [s for s in free if s is not hits[-1]]
    classes: list[Said | None] = []
    for truth, hit in zip(truths, hits, strict=True):
        near = next((s for s in free if truth in s.alike), None)
        classes.append(near if hit is None else None)
        free = [s for s in free if s is not classes[-1]]
    return tuple(hits), tuple(classes), free


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


def _joint_right(
    truths: Sequence[Name], first: Sequence[Name], flagged: set
) -> bool | None:
    if not truths or not (first or flagged):
        return None
    if first:
        return any(name.joints == truth.joints for name in first for truth in truths)
    there = {joint for truth in truths for joint in truth.joints}
    # What is on the whole arm may show anywhere.
    return bool(there & flagged) or not there


# Figures of a study: sums over its rows, each with its count and interval.


def wilson(hits: int, n: int) -> list[float]:
    """Return the 95 % Wilson interval of a rate, to four digits.

    Args:
        n: Of how many; 0 gives [0, 1].
    """
    if n == 0:
        return [0.0, 1.0]
    interval = binomtest(hits, n).proportion_ci(method="wilson")
    return [round(float(interval.low), 4), round(float(interval.high), 4)]


def rate(hits: int, n: int) -> dict:
    """Return a rate with its count and its 95 % interval, as JSON can hold it."""
    value = hits / n if n else None
    return {"value": value, "hits": hits, "n": n, "interval": wilson(hits, n)}


CLEAR = 3.0  # multiples of the minimum detectable size from which one ought to see it
_ROUNDING = 1e-6
# Where the multiples that were asked for lie, with what was capped between them.
BINS = ((0.0, 0.75), (0.75, 1.5), (1.5, 4.0), (4.0, 7.5), (7.5, np.inf))

Row = Mapping


def summary(rows: Sequence[Row]) -> dict:
    """Return the figures of a study, as JSON can hold them."""
    singles = _of(rows, SINGLE)
    clear = [r for r in singles if is_clear(r)]
    pairs = [r for r in _of(rows, PAIR) if both_clear(r)]
    named = [r for r in rows if r["named"]]
    return {
        "cases": dict(Counter(r["drawn"] for r in rows)),
        "outcomes": outcomes(rows),
        "confusion": confusion(rows),
        "singles_clear_right": _rate(clear, is_right),
        "singles_right": _rate(singles, is_right),
        "singles_of_usual_size_right": _rate(
            [r for r in singles if r["multiple"] is None], is_right
        ),
        "singles_by_name": _rate(singles, lambda r: r["outcome"] == RIGHT),
        "joint_right": _rate(
            [r for r in singles if r["named"]], lambda r: bool(r["joint_right"])
        ),
        "named_right": _rate(named, lambda r: r["outcome"] != WRONG),
        "names_none_false": _rate(named, lambda r: not r["extra"]),
        "false_alarms": _rate(_of(rows, NOTHING), lambda r: r["named"] > 0),
        "nulls_flagged": _rate(_of(rows, NOTHING), lambda r: r["outcome"] == FLAGGED),
        "unknown_flagged": _rate(_of(rows, UNKNOWN), lambda r: bool(r["unexplained"])),
        "unknown_named": _rate(_of(rows, UNKNOWN), lambda r: r["named"] > 0),
        "unknown_joint": _rate(
            [r for r in _of(rows, UNKNOWN) if r["unexplained"]],
            lambda r: bool(set(r["joints"]) & set(r["unexplained"])),
        ),
        "pairs_clear_both": _rate(pairs, lambda r: r["found"] == 2),
        "pairs_both": _rate(_of(rows, PAIR), lambda r: r["found"] == 2),
        "pairs_false_third": _rate(_of(rows, PAIR), lambda r: r["extra"] > 0),
        "detection": detection(singles),
        "coverage": coverage(rows),
        "parameter_error": parameter_error(rows),
        "errors": errors(rows),
        "seconds_median": _median(r["seconds"] for r in rows),
    }


def is_right(row: Row) -> bool:
    """Whether a case was named as it is, or in the class of what is there."""
    return row["outcome"] in (RIGHT, CLASS)


def is_clear(row: Row) -> bool:
    """Whether a hidden effect is so large that it ought to be seen."""
    return row["multiple"] is not None and row["multiple"] >= CLEAR - _ROUNDING


def both_clear(row: Row) -> bool:
    """Whether neither of a pair is known to be too small to be seen."""
    sizes = (row["multiple"], row["second_multiple"])
    return all(size is None or size >= CLEAR - _ROUNDING for size in sizes)


def outcomes(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return how often each kind of case came out how."""
    out: dict[str, Counter] = {}
    for row in rows:
        out.setdefault(row["drawn"], Counter())[row["outcome"]] += 1
    return {drawn: dict(counts) for drawn, counts in out.items()}


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return what was said of each hidden effect: true effect, then first name.

    What is in the class of the first name counts as named. "none" stands for nothing
    hidden or nothing said, "unknown" for a flag without a name. Pairs are not in it.
    """
    out: dict[str, Counter] = {}
    for row in rows:
        if row["drawn"] == PAIR:
            continue
        true = row["effect"] or NOTHING
        said = true if row["outcome"] == CLASS else row["named_first"]
        if said is None:
            said = UNKNOWN if row["unexplained"] else NOTHING
        out.setdefault(true, Counter())[said] += 1
    return {true: dict(counts) for true, counts in sorted(out.items())}


def detection(singles: Sequence[Row]) -> list[dict]:
    """Return how often an effect was rightly named, by its size in detectable ones."""
    out = []
    for low, high in BINS:
        rows = [
            r
            for r in singles
            if r["multiple"] is not None and low <= r["multiple"] < high
        ]
        if rows:
            middle = float(np.exp(np.mean([np.log(r["multiple"]) for r in rows])))
            out.append({"multiple": middle, **_rate(rows, is_right)})
    return out


def coverage(rows: Sequence[Row]) -> dict:
    """Return how often the truth is within two standard deviations."""
    z = [r["z"] for r in rows if r["z"] is not None]
    return rate(sum(abs(v) <= 2 for v in z), len(z))


def parameter_error(rows: Sequence[Row]) -> dict:
    """Return the median relative error of what was rightly named, over all and each."""
    each: dict[str, list[float]] = {}
    for row in rows:
        if row["value"] is not None and row["truth"]:
            off = abs(row["value"] / row["truth"] - 1)
            each.setdefault(row["effect"], []).append(off)
    medians = {name: _median(values) for name, values in sorted(each.items())}
    every = [v for values in each.values() for v in values]
    return {"median": _median(every), "n": len(every), "per_effect": medians}


def errors(rows: Sequence[Row]) -> dict:
    """Return median held-out errors of cases with a named truth, and the gap closed."""
    known = [r for r in rows if r["drawn"] in (SINGLE, PAIR) and r["error_oracle"]]
    keys = ("error_before", "error_refit", "error_after", "error_oracle")
    ratios = [r["error_after"] / r["error_oracle"] for r in known]
    named = [r["error_after"] / r["error_oracle"] for r in known if is_right(r)]
    gaps = [r["gap_closed"] for r in known if r["gap_closed"] is not None]
    return {
        "n": len(known),
        **{key: _median(r[key] for r in known) for key in keys},
        "over_oracle": _median(ratios),
        "over_oracle_where_right": _median(named),
        "gap_closed": _median(gaps),
        "gaps": len(gaps),
    }


def _of(rows: Sequence[Row], drawn: str) -> list[Row]:
    return [r for r in rows if r["drawn"] == drawn]


def _rate(rows: Sequence[Row], hit) -> dict:
    return rate(sum(bool(hit(r)) for r in rows), len(rows))


def _median(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.median(known)) if known else None
