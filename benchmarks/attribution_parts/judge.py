"""What a verdict is worth where several things changed: sets, and moved values."""

from collections.abc import Mapping, Sequence

from flows.blind.export.score import matched
from flows.blind.score import Name, members
from flows.blind.size import smallest
from residual.diagnosis.result import Detectable, Verdict
from residual.diagnosis.verdict import to_json

_MOVED = 0.05  # of what is given: less is not called a change
Values = Mapping[tuple[str, int], tuple[float, float]]


def judged(verdict: Verdict, planted: Sequence[Name]) -> dict:
    """Return how the set that is named compares with what changed.

    A name is true if it, or one that the verdict says the logs cannot tell from it, is
    among what changed and no other name stands for that already.

    Args:
        planted: What changed, in the convention of the verdict.

    Returns:
        Names with their classes, how many are true, whether the set is exact by name,
        by class, or one of the alternatives listed.
    """
    said, document = members(verdict), to_json(verdict)
    classes = [[s.name, *s.alike] for s in said]
    owners = matching(planted, classes)
    listed = alternatives(document)
    exact = len(said) == len(planted)
    return {
        "said": [[_plain(n) for n in names] for names in classes],
        "true": len(owners),
        "exact_by_name": sorted(map(str, planted)) == sorted(str(s.name) for s in said),
        "exact": exact and len(owners) == len(planted),
        "alternatives": None
        if listed is None
        else [[_plain(n) for n in names] for names in listed],
        "listed": any(
            sorted(map(str, one)) == sorted(map(str, planted)) for one in listed or ()
        ),
        "verdict": verdict.verdict,
        "unexplained": list(verdict.unexplained.joints),
    }


def matching(planted: Sequence[Name], classes: Sequence[Sequence[Name]]) -> dict:
    """Give as many names as possible a planted change of their own.

    Augmenting paths (Kuhn 1955): a name gives way to another if it has a second choice.

    Returns:
        Index of a name for each index of a planted change that has one.
    """
    return matched(planted, classes, lambda truth, own: truth in own)


def alternatives(document: Mapping) -> list[list[Name]] | None:
    """Return the other sets that a verdict lists; None where it has no such list."""
    listed = document.get("alternatives")
    if listed is None:
        return None
    return [[name for place in one["set"] for name in _apart(place)] for one in listed]


def _apart(place: Mapping) -> list[Name]:
    """One name per joint, as findings on several joints count."""
    joints = tuple(sorted(place["joints"]))
    if len(joints) < 2 or place["name"] == "coupled_friction":
        return [Name(place["name"], joints)]
    return [Name(place["name"], (j,)) for j in joints]


def moved(
    verdict: Verdict, values: Values, minimum: Sequence[Detectable], body: bool
) -> dict:
    """Return what of the moved values is among the changes that a verdict tells.

    Args:
        values: Given and true value of each drive's numbers, by name and joint.
        minimum: Detectable sizes, of the same arm without a change.
        body: Whether a body of the arm changed by enough.

    Returns:
        Moved values that were due and those of them that were told; values that were
        told although they are within 5 % of the truth; None where the verdict does not
        have the list. A changed body is told by any inertial combination.
    """
    told = to_json(verdict).get("changes")
    if told is None:
        return {"moved_due": None, "moved_told": None, "moved_false": None}
    beyond = {(c["name"], j) for c in told if c["beyond"] for j in (c["joints"] or [0])}
    due = [key for key, pair in values.items() if _is_due(key, pair, minimum)]
    hits = [key for key in due if key in beyond]
    names = {name for name, _ in values}
    if body:
        due.append(("body", 0))
        hits += [("body", 0)] * any(name not in names for name, _ in beyond)
    still = [k for k, (given, true) in values.items() if _share(given, true) < _MOVED]
    return {
        "moved_due": [list(k) for k in due],
        "moved_told": [list(k) for k in hits],
        "moved_false": [list(k) for k in still if k in beyond],
    }


def _is_due(
    key: tuple[str, int], pair: tuple[float, float], minimum: Sequence[Detectable]
) -> bool:
    least = smallest(minimum, key[0], key[1:])
    large = _share(*pair) > _MOVED
    return large and least is not None and abs(pair[1] - pair[0]) > float(least.value)


def _share(given: float, true: float) -> float:
    return abs(true - given) / max(abs(given), 1e-12)


def _plain(name: Name) -> list:
    return [name.effect, list(name.joints)]
