"""Plain sentences for a verdict: what is missing, how sure, and what it cures."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from flows.report.words.phrases import (
    alternatives,
    count,
    effect_named,
    joint_words,
    listing,
    phrase,
    sentence_case,
)
from flows.report.words.quantity import (
    as_list,
    dig,
    known,
    percent,
    records,
)

_NAMED_AT_MOST = 3
_SURE = 0.9
_CANNOT_TELL = "These data cannot tell a name in brackets from the one before it."


class Change(NamedTuple):
    """Held-out error before and after the found effects were added [%]."""

    where: str
    before: float
    after: float


def headline(verdict: Mapping) -> str:
    """Return the verdict in one to four plain sentences."""
    return " ".join(sentences(verdict))


def sentences(verdict: Mapping) -> list[str]:
    """Return the sentences of the headline; the first is the verdict itself."""
    kind = verdict.get("verdict")
    if kind == "effects" and verdict.get("effects"):
        parts = [*_claim(verdict), _proof(verdict), _left_over(verdict)]
    elif kind == "unknown":
        parts = [_unknown(verdict), _level(verdict)]
    elif kind == "none":
        parts = ["No effect that the model lacks shows in these data.", _level(verdict)]
    else:
        parts = ["No verdict was reached."]
    return [part for part in parts if part]


def joint_count(verdict: Mapping) -> int | None:
    """Return the number of joints, read off the error lists; None without them."""
    for metric in ("held_out", "filtered", "moving"):
        for values in (dig(verdict, "error", metric) or {}).values():
            if as_list(values):
                return len(values)
    return None


def ordered(verdict: Mapping) -> list[Mapping]:
    """Return the effects, first found first."""
    effects = records(verdict.get("effects"))
    return sorted(effects, key=lambda effect: effect.get("order") or len(effects))


def is_wrong_value(effect: Mapping, declared: Any) -> bool:
    """Return whether the model has this effect, only with a wrong value."""
    name = effect.get("name")
    if name in as_list(declared) or effect_named(name).in_every_model:
        return True
    mass = as_list(dig(effect, "parameters", "mass", "value"))
    return bool(mass) and known(mass[0]) and mass[0] < 0


def held_out_words(word: Any) -> str:
    """Return what the held-out motion said about one finding."""
    return {
        "confirmed": "confirmed on held-out motion",
        "neutral": "neither confirmed nor refuted on held-out motion",
        "refuted": "refuted on held-out motion",
    }.get(word, "not tried on held-out motion")


def change(verdict: Mapping) -> Change | None:
    """Return the fall of the held-out error that tells most about the findings.

    One joint concerned: that joint while it moves, since standstill torque is set by
    friction history and not by the model. Several: all joints together.
    """
    joints = {j for e in ordered(verdict) for j in e.get("joints") or []}
    scopes = {effect_named(e.get("name")).scope for e in ordered(verdict)}
    if len(joints) == 1 and "flange" not in scopes:
        found = _joint_change(verdict, joints.pop())
        if found:
            return found
    error = verdict.get("error") or {}
    for metric in ("overall_filtered", "overall"):
        pair = _pair(error.get(metric))
        if pair:
            return Change("over all joints", *pair)
    return None


def rising(verdict: Mapping, metric: str = "filtered") -> list[str]:
    """Return the joints that the findings make worse by more than 2 %, in words."""
    stages = dig(verdict, "error", metric) or {}
    before, after = as_list(stages.get("identified")), as_list(stages.get("augmented"))
    rows = enumerate(zip(before, after, strict=False), start=1)
    return [
        f"joint {joint} from {percent(old)} to {percent(new)}"
        for joint, (old, new) in rows
        if known(old) and known(new) and new > 1.02 * old
    ]


def _claim(verdict: Mapping) -> list[str]:
    effects, declared = ordered(verdict), verdict.get("declared")
    dof = joint_count(verdict)
    shown = effects[:_NAMED_AT_MOST]
    unclear = sum(bool(e.get("equivalent")) for e in shown)
    said = [(is_wrong_value(e, declared), _item(e, dof, unclear > 1)) for e in shown]
    lacking, wrong = ([text for w, text in said if w is side] for side in (False, True))
    likely = [e["probability"] for e in shown if known(e.get("probability"))]
    hedge = "most likely " if likely and min(likely) < _SURE else ""
    rest = len(effects) - len(shown)
    more = [f"{count(rest)} more"] if rest else []
    clauses = []
    if lacking:
        clauses.append(f"lacks {listing(lacking + ([] if wrong else more))}")
    if wrong:
        values = "wrong values" if len(wrong) > 1 else "a wrong value"
        clauses.append(f"has {values} for {listing(wrong + more)}")
    claim = f"The model {hedge}{listing(clauses)}."
    return [claim, _CANNOT_TELL] if unclear > 1 else [claim]


def _item(effect: Mapping, dof: int | None, brief: bool) -> str:
    others = alternatives(effect, dof)
    if not others:
        return phrase(effect, dof)
    why = "" if brief else ": these data cannot tell"
    return f"{phrase(effect, dof)} (or {' or '.join(others)}{why})"


def _proof(verdict: Mapping) -> str:
    found = change(verdict)
    if found is None:
        return "No held-out motion proves it."
    old, new = percent(found.before), percent(found.after)
    if old == new:
        fall = f"stays at {new}"
    else:
        fall = f"{'falls' if found.after < found.before else 'rises'} from {old}"
        fall = f"{fall} to {new}"
    weak = " in the same run: a weak proof" if _same_run(verdict) else ""
    return f"Held-out error {found.where} {fall}{weak}."


def _left_over(verdict: Mapping) -> str:
    joints = as_list(dig(verdict, "unexplained", "joints"))
    if not joints:
        return ""
    who = sentence_case(joint_words(joints, joint_count(verdict)))
    keeps = "keeps" if len(joints) == 1 else "keep"
    return f"{who} {keeps} an error that no known effect explains."


def _unknown(verdict: Mapping) -> str:
    joints = as_list(dig(verdict, "unexplained", "joints"))
    where = joint_words(joints, joint_count(verdict))
    where = f" on {where}" if where else ""
    return f"The model lacks something{where} that no known effect explains."


def _level(verdict: Mapping) -> str:
    """Return the error of the refitted model where nothing was added to it."""
    error = verdict.get("error") or {}
    for metric in ("overall_filtered", "overall"):
        value = dig(error, metric, "identified")
        if known(value):
            run = " in the same run" if _same_run(verdict) else ""
            return f"Its held-out error{run} is {percent(value)} over all joints."
    return ""


def _same_run(verdict: Mapping) -> bool:
    return dig(verdict, "error", "same_run") is True


def _joint_change(verdict: Mapping, joint: int) -> Change | None:
    wheres = {
        "moving": f"on joint {joint}, while it moves,",
        "filtered": f"on joint {joint}",
        "held_out": f"on joint {joint}",
    }
    for metric, where in wheres.items():
        stages = dig(verdict, "error", metric) or {}
        at_joint = {
            stage: values[joint - 1]
            for stage, values in stages.items()
            if len(as_list(values)) >= joint > 0
        }
        pair = _pair(at_joint)
        if pair:
            return Change(where, *pair)
    return None


def _pair(stages: Mapping | None) -> tuple[float, float] | None:
    """Return (before, after): the refit before, since only it isolates the effect."""
    stages = stages or {}
    refit, nominal, after = map(stages.get, ("identified", "nominal", "augmented"))
    before = refit if known(refit) else nominal
    if known(before) and known(after):
        return before, after
    return None
