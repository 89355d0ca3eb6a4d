"""Other sets of effects that the logs cannot tell from the one named, in words."""

from flows.report.words.phrases import count, listing, phrase, sentence_case
from residual.diagnosis.causes.alternative import LOAD, Alternative, Place
from residual.diagnosis.result import Verdict

_SHOWN = 3
Key = tuple[str, tuple[int, ...]]


def other_sets(verdict: Verdict) -> list[str]:
    """Return sentences on what else it could be, and what would tell.

    Sets in which one finding gives way to its equivalent are said with that finding.
    """
    known = _said(verdict)
    loads = [a for a in verdict.alternatives if a.separated_by == LOAD]
    others = [
        a
        for a in verdict.alternatives
        if a.separated_by != LOAD and frozenset(map(_key, a.set)) not in known
    ]
    lines = [f"As likely: {_set(a, verdict)}." for a in others[:_SHOWN]]
    if len(others) > _SHOWN:
        more = len(others) - _SHOWN
        words = f"{count(more)} more {'set' if more == 1 else 'sets'}"
        lines.append(f"{sentence_case(words)}: 'alternatives' in the JSON.")
    if others:
        lines.append("Another motion would tell them apart.")
    return lines + _mixed(loads, verdict)


def _said(verdict: Verdict) -> set[frozenset[Key]]:
    """Sets that differ from the named one by an equivalent alone."""
    named = _named(verdict)
    return {
        (named - {(finding.name, finding.joints)}) | {_key(other)}
        for finding in verdict.effects
        for other in finding.equivalent
    }


def _named(verdict: Verdict) -> frozenset[Key]:
    """What is named, one joint each where a finding is on several."""
    out = set()
    for finding in verdict.effects:
        several = [(j,) for j in finding.joints]
        lists = any(isinstance(p.value, tuple) for p in finding.parameters.values())
        places = several if lists else [finding.joints]
        out |= {(finding.name, joints) for joints in places}
    return frozenset(out)


def _mixed(loads: list[Alternative], verdict: Verdict) -> list[str]:
    """One sentence on bodies that move alike."""
    named = _named(verdict)
    extra = [place for a in loads for place in a.set if _key(place) not in named]
    if not extra:
        return []
    whole = " or ".join(phrase(place, verdict.dof) for place in extra)
    return [
        f"A part of the load may as well be {whole}: motion cannot tell them apart. "
        "Weigh the load, or log the arm without it."
    ]


def _key(place: Place) -> Key:
    return place.name, place.joints


def _set(alternative: Alternative, verdict: Verdict) -> str:
    words = [phrase(place, verdict.dof) for place in alternative.set]
    return listing(words) or "nothing"
