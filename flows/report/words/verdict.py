"""Plain sentences for a verdict and for a check: what is missing, how sure."""

from collections.abc import Mapping
from typing import NamedTuple

from flows.inputs.repair import place_of
from flows.report.words.outlook import off_words
from flows.report.words.phrases import (
    At,
    alternatives,
    count,
    effect_named,
    joint_words,
    listing,
    phrase,
    place,
    sentence_case,
    texts,
)
from residual.check.result import Fault, LogCheck
from residual.diagnosis.result import ErrorTables, Finding, Number, Verdict
from residual.effects.base import Trait
from residual.quantity import bare_percent, known, percent, probability

CLEAN = "The logs are what they say they are: no fault was found."

# What each kind of fault means; docs/check.md has more.
MEANING = texts()["faults"]

# The motion that would help, most wanted first.
_MORE = {
    "too_short": "Record 20 s or more in which every joint moves to and fro.",
    "lockstep": "Move the joints apart from each other: modelgap trajectory fourier.",
    "no_reversal": "Let each joint move to and fro, several times.",
}


def summary(report: LogCheck) -> str:
    """Return the answer in one sentence."""
    certain, rest = len(report.certain), len(report.faults) - len(report.certain)
    if not report.faults:
        return CLEAN
    counted = [f"{certain} certain"] if certain else []
    counted += [f"{rest} suspected"] if rest else []
    many = "s" if len(report.faults) > 1 else ""
    ends = "unusable as they are" if certain else "usable, with care"
    return f"The logs are {ends}: {' and '.join(counted)} fault{many}."


def enough(report: LogCheck | None) -> list[str]:
    """Return what the motion is too poor for, and the motion that would help."""
    if report is None:
        return []
    out = []
    for kind, help in _MORE.items():
        found = [fault for fault in report.faults if fault.kind == kind]
        joints = sorted({joint for fault in found for joint in fault.joints})
        if found:
            where = f" ({joint_words(joints)})" if joints else ""
            meaning = MEANING[kind]
            out.append(f"These logs can show little: {meaning}{where}. {help}")
    return out[:1]


def title(fault: Fault) -> str:
    """Return what is wrong and where: 'torque counts the other way round, joint 2'."""
    joints = joint_words(fault.joints)
    meaning = MEANING.get(fault.kind, fault.kind.replace("_", " "))
    return f"{meaning} ({joints})" if joints else meaning


_NAMED_AT_MOST = 3
_SURE = 0.9
_REFIT = ("nominal", "identified")
_FALLS = 2.0  # times the error after a refit: half of it was in the given values
VALUES_OFF = "no effect missing, its values were off"
_WORSE = 1.02  # times the error before: less is no difference
_NO_MODEL, _NO_NOMINAL = 50.0, 200.0  # % of torque: no model of these logs
_CANNOT_TELL = "These data cannot tell a name in brackets from the one before it."


class Change(NamedTuple):
    """Held-out error before and after the found effects were added [%]."""

    where: str
    before: float
    after: float


def headline(verdict: Verdict) -> str:
    """Return the verdict in one to four plain sentences."""
    return " ".join(sentences(verdict))


def sentences(verdict: Verdict) -> list[str]:
    """Return the sentences of the headline; the first is the verdict itself."""
    if not verdict.trusted:
        parts = [_at_fault(verdict), _level(verdict)]
    elif verdict.verdict == "effects":
        proof, left = _proof(verdict), _left_over(verdict)
        said = [usual(verdict), off_words(verdict), proof, left, drifted(verdict)]
        parts = [*_claim(verdict), *said]
    elif verdict.verdict == "unknown":
        parts = [_unknown(verdict), off_words(verdict), _level(verdict)]
        parts.append(drifted(verdict))
    else:
        parts = [_nothing(verdict), off_words(verdict), usual(verdict)]
        parts += [drifted(verdict), _level(verdict)]
    parts.append(suspected(verdict))
    return [part for part in (*enough(verdict.log_check), *parts) if part]


def is_wrong_value(effect: Finding, verdict: Verdict) -> bool:
    """Return whether the model has this effect, only with a wrong value."""
    traits = effect_named(effect.name).traits
    if effect.name in verdict.declared or Trait.IN_EVERY_MODEL in traits:
        return True
    mass = effect.parameters.get("mass")
    return mass is not None and known(mass.value) and mass.value < 0


def held_out_words(word: str | None) -> str:
    """Return what the held-out motion said about one finding."""
    return {
        "confirmed": "confirmed on held-out motion",
        "neutral": "neither confirmed nor refuted on held-out motion",
        "refuted": "refuted on held-out motion",
    }.get(word, "not tried on held-out motion")


def change(verdict: Verdict) -> Change | None:
    """Return the held-out error before and after what was found: one pair everywhere.

    All joints, while they move: standstill torque is set by friction history and not by
    a model, and the joints that nothing was found on belong to the arm as well.
    """
    for stages, where in _levels(verdict.error):
        pair = _pair(stages)
        if pair:
            return Change(where, *pair)
    return None


def level(errors: ErrorTables) -> tuple[Number, str]:
    """Return the held-out error of the refitted model, and of what it is, in words."""
    for stages, where in _levels(errors):
        if known(stages.get("identified")):
            return stages["identified"], where
    return None, "over all joints"


def _levels(errors: ErrorTables) -> list[tuple[Mapping[str, Number], str]]:
    """Errors of all joints, the one that tells most first; null where none moves."""
    return [
        (errors.overall_moving, "over all joints, while they move,"),
        (errors.overall_filtered, "over all joints"),
        (errors.overall, "over all joints"),
    ]


def rising(verdict: Verdict) -> list[str]:
    """Return the joints that the findings make worse beyond chance, in words."""
    stages = verdict.error.moving
    before, after = stages["identified"] or (), stages["augmented"] or ()
    return [
        f"joint {j} from {percent(before[j - 1])} to {percent(after[j - 1])}"
        for j in verdict.error.worse
        if j <= min(len(before), len(after))
    ]


def _claim(verdict: Verdict) -> list[str]:
    effects, dof = verdict.effects, verdict.dof
    shown = effects[:_NAMED_AT_MOST]
    unclear = sum(bool(e.equivalent) for e in shown)
    said = [(is_wrong_value(e, verdict), _item(e, dof, unclear > 1)) for e in shown]
    lacking, wrong = ([text for w, text in said if w is side] for side in (False, True))
    likely = [e.probability for e in shown if known(e.probability)]
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


def _item(effect: Finding, dof: int, brief: bool) -> str:
    others = alternatives(effect, dof)
    if not others:
        return phrase(effect, dof)
    why = "" if brief else ": these data cannot tell"
    return f"{phrase(effect, dof)} (or {' or '.join(others)}{why})"


def _proof(verdict: Verdict) -> str:
    found = change(verdict)
    if found is None:
        return "No held-out motion proves it."
    old, new = percent(found.before), percent(found.after)
    if old == new:
        fall = f"stays at {new}"
    else:
        fall = f"{'falls' if found.after < found.before else 'rises'} from {old}"
        fall = f"{fall} to {new}"
    weak = " in the same run: a weak proof" if verdict.error.same_run else ""
    said = f"Held-out error {found.where} {fall}{weak}."
    worse = rising(verdict)
    return f"{said} It rises on {listing(worse)}." if worse else said


def _left_over(verdict: Verdict) -> str:
    joints = verdict.unexplained.joints
    if not joints:
        return ""
    who = sentence_case(joint_words(joints, verdict.dof))
    keeps = "keeps" if len(joints) == 1 else "keep"
    return f"{who} {keeps} an error that no known effect explains."


def _at_fault(verdict: Verdict) -> str:
    faults = listing([title(fault) for fault in verdict.log_check.certain])
    return f"Nothing is named, since the logs cannot be trusted: {faults}."


def usual(verdict: Verdict) -> str:
    """Return the findings that any used arm has, in one sentence, or nothing."""
    folded = [phrase(f, verdict.dof) for f in verdict.background]
    if not folded:
        return ""
    return f"Beside that it has the usual friction and ripple: {listing(folded)}."


def suspected(verdict: Verdict) -> str:
    """Return the names that are not sure enough to be in the model, or nothing."""
    names = [
        f"{phrase(f, verdict.dof)} ({probability(f.probability)})"
        for f in verdict.suspected
    ]
    if not names:
        return ""
    return f"Suspected, but not sure enough to be in the model: {listing(names)}."


def drifted(verdict: Verdict) -> str:
    """Return by how much the friction of the joints moved together, or nothing."""
    drift = verdict.drift
    if drift is None:
        return ""
    by, std = percent(100 * abs(drift.factor - 1)), percent(100 * drift.std)
    lower = drift.factor < 1
    joints = joint_words(drift.joints, verdict.dof)
    return (
        f"Friction is {by} (± {std}) {'lower' if lower else 'higher'} than at the "
        f"baseline on {joints}, as if the arm were {'warmer' if lower else 'colder'}."
    )


def _nothing(verdict: Verdict) -> str:
    """Return what it means that no effect is named: not always that none is missing."""
    faults = verdict.log_check.faults if verdict.log_check else ()
    # What no line mends (a short motion, a smoothed torque) is said by itself.
    suspected = [fault for fault in faults if fault.repair]
    if suspected:
        what = listing([title(fault) for fault in suspected])
        return (
            f"No effect is named, but the logs may be at fault: {what}. Try the line "
            "that `modelgap check` proposes before this is believed."
        )
    given, refit = (verdict.error.overall_moving.get(stage) for stage in _REFIT)
    if (known(refit) and refit > _NO_MODEL) or (known(given) and given > _NO_NOMINAL):
        return (
            "The model does not describe these logs "
            f"({percent(given)} of the torque is missed as given, {percent(refit)} "
            "refitted), so that nothing can be said of effects: check units, signs and "
            "the order of the joints (`modelgap check`)."
        )
    if off_words(verdict):
        return "No effect that the model lacks shows; what it has is another matter."
    return "No effect that the model lacks shows in these data."


def _unknown(verdict: Verdict) -> str:
    if verdict.contradictions:
        return " ".join(sentence_case(f"{said}.") for said in verdict.contradictions)
    where = joint_words(verdict.unexplained.joints, verdict.dof)
    return f"The model lacks something on {where} that no known effect explains."


def _level(verdict: Verdict) -> str:
    """Return the error of the refitted model where nothing was added to it."""
    if _is_worse(verdict) and not verdict.contradictions:
        before, after = map(verdict.error.overall_filtered.get, _REFIT)
        return (
            "The refit predicts held-out motion worse than the model as it was given: "
            f"{percent(after)} after {percent(before)}, over all joints."
        )
    value, where = level(verdict.error)
    if not known(value):
        return ""
    run = " in the same run" if verdict.error.same_run else ""
    return f"Its held-out error{run} is {percent(value)} {where.removesuffix(',')}."


def _is_worse(verdict: Verdict) -> bool:
    """Whether the refit predicts worse, over all and on the moving joints alike.

    At standstill friction holds what it likes, which a refit may guess or not.
    """
    before, after = map(verdict.error.overall_filtered.get, _REFIT)
    if not known(before) or not known(after) or after <= _WORSE * before:
        return False
    moving = [verdict.error.moving.get(stage) or () for stage in _REFIT]
    pairs = [(a, b) for a, b in zip(*moving, strict=False) if known(a) and known(b)]
    return sum(b > _WORSE * a for a, b in pairs) >= len(pairs) / 2


def _pair(stages: Mapping[str, Number]) -> tuple[float, float] | None:
    """Return (before, after): the refit before, since only it isolates the effect."""
    refit, nominal, after = map(stages.get, ("identified", "nominal", "augmented"))
    before = refit if known(refit) else nominal
    if known(before) and known(after):
        return before, after
    return None


_BRIEFLY = 2


def brief(verdict: Verdict) -> str:
    """Return a verdict with its errors: "load friction on joint 2, 9.6 → 7.1 %".

    The errors are those of the headline of the report: held out, refit, then with
    what was found.
    """
    return ", ".join(part for part in (finding(verdict), errors(verdict)) if part)


def finding(verdict: Verdict) -> str:
    """Return what a verdict names, and what else it may be, without its errors."""
    if not verdict.trusted:
        faults = [title(fault) for fault in verdict.log_check.certain]
        return f"logs not to be trusted: {' and '.join(faults)}"
    if verdict.verdict == "effects":
        shown = [_named(e, verdict) for e in verdict.effects[:_BRIEFLY]]
        rest = len(verdict.effects) - len(shown)
        return ", ".join([*shown, *([f"{rest} more"] if rest else [])])
    if verdict.verdict == "unknown":
        where = joint_words(verdict.unexplained.joints, verdict.dof)
        return f"unknown{f' on {where}' if where else ''}"
    return VALUES_OFF if _fall(verdict) else "nothing missing"


def errors(verdict: Verdict) -> str:
    """Return the held-out error before and after, or the one there is; "" for none."""
    found = change(verdict) if verdict.verdict == "effects" else None
    pair = found[1:] if found else _fall(verdict)
    if pair:
        return f"{bare_percent(pair[0])} → {percent(pair[1])}"
    found, _ = level(verdict.error)
    return percent(found) if known(found) else ""


def _fall(verdict: Verdict) -> tuple[float, float] | None:
    """Return the error as given and refitted, where that is what was wrong."""
    if verdict.verdict != "none":
        return None
    for stages, _ in _levels(verdict.error):
        before, after = map(stages.get, _REFIT)
        if known(before) and known(after):
            return (before, after) if before > _FALLS * after else None
    return None


def _named(effect: Finding, verdict: Verdict) -> str:
    others = [
        _name(other) if other.joints == effect.joints else _at(other, verdict)
        for other in effect.equivalent
    ]
    words = _at(effect, verdict)
    words += f" (or {' or '.join(dict.fromkeys(others))})" if others else ""
    return f"wrong {words}" if is_wrong_value(effect, verdict) else words


def _name(effect: At) -> str:
    return effect.name.replace("_", " ")


def _at(effect: At, verdict: Verdict) -> str:
    return f"{_name(effect)} {place(effect, verdict.dof)}".strip()


def check_lines(report: LogCheck) -> list[str]:
    """Return the answer: one line, then a paragraph for each fault."""
    said = ["", summary(report)]
    for fault in report.faults:
        said += ["", *_fault(fault)]
    return said


def _fault(fault: Fault) -> list[str]:
    sure = "certain" if fault.certain else "suspected"
    said = [f"{sentence_case(title(fault))}: {fault.kind}, {sure}."]
    said += [f"  {line}" for line in fault.evidence.splitlines()]
    if fault.repair is None:
        return said
    repair = fault.repair.splitlines()
    place = place_of(fault.repair)
    return [*said, f"  Fix ({place}):", *(f"    {line}" for line in repair)]
