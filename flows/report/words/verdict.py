"""Sentences for a verdict and for a check of logs."""

from flows.inputs.repair import place_of
from flows.report.words.outlook import off_words
from flows.report.words.phrases import (
    alternatives,
    count_noun,
    effect_named,
    joint_words,
    listing,
    number_word,
    phrase,
    sentence_case,
    texts,
)
from residual.check.result import Fault, LogCheck
from residual.effects.base import Trait
from residual.quantity import bare_percent, is_number, percent, probability
from residual.verdict.result import STAGES, ErrorTables, Finding, Verdict

CLEAN = "No problems found: units, signs, joint order and timing are consistent."

# What each kind of fault means; docs/check.md has more.
MEANING = texts()["faults"]

# The motion that would help, the most useful first.
_MORE_MOTION = {
    "too_short": "Record 20 s or more in which every joint moves back and forth.",
    "lockstep": "Move the joints independently: modelgap trajectory fourier.",
    "no_reversal": "Move each joint back and forth several times.",
}


def summary(report: LogCheck) -> str:
    """Return the result of a check in one sentence."""
    if not report.faults:
        return CLEAN
    certain = len(report.certain)
    suspected = len(report.faults) - certain
    counts = [f"{certain} certain"] if certain else []
    counts += [f"{suspected} suspected"] if suspected else []
    faults = f"fault{'s' if len(report.faults) > 1 else ''}"
    verdict = "unusable" if certain else "usable with care"
    return f"The logs are {verdict}: {' and '.join(counts)} {faults}."


def title(fault: Fault) -> str:
    """Return a fault and its joints: 'torque has the opposite sign (joint 2)'."""
    joints = joint_words(fault.joints)
    meaning = MEANING.get(fault.kind, fault.kind.replace("_", " "))
    return f"{meaning} ({joints})" if joints else meaning


def check_lines(report: LogCheck) -> list[str]:
    """Return the result of a check: one line, then a paragraph for each fault."""
    lines = ["", summary(report)]
    for fault in report.faults:
        sure = "certain" if fault.certain else "suspected"
        lines += ["", f"{sentence_case(title(fault))}: {fault.kind}, {sure}."]
        lines += [f"  {line}" for line in fault.evidence.splitlines()]
        if fault.repair is not None:
            lines.append(f"  Fix ({place_of(fault.repair)}):")
            lines += [f"    {line}" for line in fault.repair.splitlines()]
    return lines


_NAMED_AT_MOST = 3
_SURE = 0.9
_DIFFERS = 1.02  # times an error: less is no difference
_NO_MODEL, _NO_NOMINAL = 50.0, 200.0  # % of torque: no model of these logs


def headline(verdict: Verdict) -> str:
    """Return the verdict in one to four plain sentences."""
    return " ".join(sentences(verdict))


def sentences(verdict: Verdict) -> list[str]:
    """Return the sentences of the headline; the first is the verdict itself."""
    dof = verdict.dof
    parts = [claim(verdict)]
    if any(effect.equivalent for effect in verdict.effects[:_NAMED_AT_MOST]):
        parts.append("These logs cannot separate the alternatives in brackets.")
    parts.append(error_sentence(verdict))
    if verdict.trusted:
        parts.append(off_words(verdict))
    joints = joint_words(verdict.unexplained.joints, dof)
    if joints and verdict.effects:
        parts.append(f"No known effect explains the remaining error on {joints}.")
    if verdict.trusted:
        parts += [_background(verdict), _drift(verdict)]
    names = [
        f"{phrase(f, dof)} ({probability(f.probability)})" for f in verdict.suspected
    ]
    if names:
        parts.append(
            f"Suspected, but not certain enough to be named: {listing(names)}."
        )
    return [part for part in (*_more_motion(verdict.log_check), *parts) if part]


def claim(verdict: Verdict) -> str:
    """Return the claim of a verdict in one sentence."""
    faults = verdict.log_check.faults if verdict.log_check else ()
    if not verdict.trusted:
        words = listing([title(fault) for fault in verdict.log_check.certain])
        return f"No effect is named, because the logs are faulty: {words}."
    if verdict.verdict == "effects":
        return _effects(verdict)
    if verdict.verdict == "unknown":
        if verdict.contradictions:
            return " ".join(sentence_case(f"{c}.") for c in verdict.contradictions)
        where = joint_words(verdict.unexplained.joints, verdict.dof)
        return f"The model lacks something on {where} that no known effect explains."
    words = listing([title(fault) for fault in faults if fault.repair])
    if words:
        return (
            f"No missing effect found, but the logs may be faulty: {words}. First "
            "apply the fix that `modelgap check` proposes."
        )
    nominal, refit = map(verdict.error.overall_moving.get, STAGES[:2])
    if (is_number(refit) and refit > _NO_MODEL) or (
        is_number(nominal) and nominal > _NO_NOMINAL
    ):
        return (
            "The model does not describe these logs, so no effect can be named: check "
            "units, signs and joint order (`modelgap check`)."
        )
    return "No missing effect found."


def _effects(verdict: Verdict) -> str:
    effects, dof = verdict.effects, verdict.dof
    shown = effects[:_NAMED_AT_MOST]
    lacking, wrong = [], []
    for effect in shown:
        others = alternatives(effect, dof)
        words = phrase(effect, dof)
        words += f" (or {' or '.join(others)})" if others else ""
        (wrong if is_wrong_value(effect, verdict) else lacking).append(words)
    (wrong or lacking).extend(
        [f"{number_word(len(effects) - len(shown))} more"] * (len(effects) > len(shown))
    )
    clauses = [f"lacks {listing(lacking)}"] if lacking else []
    if wrong:
        value = "wrong values" if len(wrong) > 1 else "a wrong value"
        clauses.append(f"has {value} for {listing(wrong)}")
    likely = [e.probability for e in shown if is_number(e.probability)]
    hedge = "most likely " if min(likely, default=1.0) < _SURE else ""
    return f"The model {hedge}{listing(clauses)}."


def is_wrong_value(effect: Finding, verdict: Verdict) -> bool:
    """Return whether the model has this effect, only with a wrong value."""
    traits = effect_named(effect.name).traits
    if effect.name in verdict.declared or Trait.IN_EVERY_MODEL in traits:
        return True
    mass = effect.parameters.get("mass")
    return mass is not None and is_number(mass.value) and mass.value < 0


def error_levels(errors: ErrorTables) -> dict[str, float]:
    """Return the held-out error of all joints by model [%], for every text.

    While they move, where that is known: friction history sets the torque at
    standstill, and no model does.
    """
    for levels in (errors.overall_moving, errors.overall_filtered, errors.overall):
        if is_number(levels.get("identified")) or is_number(levels.get("augmented")):
            return {k: levels[k] for k in STAGES[:3] if is_number(levels.get(k))}
    return {}


def with_findings(verdict: Verdict) -> str:
    """Return the difference of the augmented model: 'with payload'."""
    named = verdict.effects
    if len(named) == 1:
        return f"with {named[0].name.replace('_', ' ')}"
    return f"with {count_noun(len(named), 'finding')}"


def error_sentence(verdict: Verdict) -> str:
    """Return the error on unseen motion, from the nominal model to the last one.

    The refit stands between where it lies between: its step is no merit of a finding.
    """
    levels = error_levels(verdict.error)
    nominal, refit = levels.get("nominal"), levels.get("identified")
    words = {"nominal": "nominal", "identified": "refit"}
    if not verdict.effects:
        levels.pop("augmented", None)
    elif "augmented" not in levels:
        return "No held-out motion tests this."
    else:
        words["augmented"] = with_findings(verdict)
        after = levels["augmented"]
        if is_number(nominal) and is_number(refit):
            between = nominal > _DIFFERS * refit and refit > _DIFFERS * after
            levels = levels if between else {"nominal": nominal, "augmented": after}
    if not levels:
        return ""
    weak = " (end of the fitted run, a weak test)" if verdict.error.same_run else ""
    steps = " → ".join(f"{percent(v)} ({words[k]})" for k, v in levels.items())
    out = f"Error on unseen motion{weak}: {steps}."
    worse = rising(verdict)
    return f"{out} The findings raise it on {listing(worse)}." if worse else out


def rising(verdict: Verdict) -> list[str]:
    """Return the joints that the findings make worse beyond chance, in words."""
    stages = verdict.error.moving
    before, after = stages["identified"] or (), stages["augmented"] or ()
    return [
        f"joint {j} ({percent(before[j - 1])} → {percent(after[j - 1])})"
        for j in verdict.error.worse
        if j <= min(len(before), len(after))
    ]


def _more_motion(report: LogCheck | None) -> list[str]:
    """Return the limit of a poor motion, and the motion that would help."""
    for kind, help in _MORE_MOTION.items() if report else ():
        faults = [fault for fault in report.faults if fault.kind == kind]
        joints = joint_words(joint for fault in faults for joint in fault.joints)
        if faults:
            where = f" ({joints})" if joints else ""
            return [f"These logs show little: {MEANING[kind]}{where}. {help}"]
    return []


def _background(verdict: Verdict) -> str:
    """Return the findings that any used arm has, in one sentence, or nothing."""
    folded = listing([phrase(f, verdict.dof) for f in verdict.background])
    return f"Also present, as on any used arm: {folded}." if folded else ""


def _drift(verdict: Verdict) -> str:
    """Return by how much the friction of the joints moved together, or nothing."""
    drift = verdict.drift
    if drift is None:
        return ""
    by, std = percent(100 * abs(drift.factor - 1)), percent(100 * drift.std)
    side, arm = ("lower", "warmer") if drift.factor < 1 else ("higher", "colder")
    joints = joint_words(drift.joints, verdict.dof)
    return (
        f"Friction on {joints} is {by} (± {std}) {side} than in the baseline, as on a "
        f"{arm} arm."
    )


def brief(verdict: Verdict) -> str:
    """Return the claim with its error: "The model lacks ..., 9.6 → 7.1 %"."""
    parts = claim(verdict).removesuffix("."), errors(verdict)
    return ", ".join(part for part in parts if part)


def errors(verdict: Verdict) -> str:
    """Return the error on unseen motion from the nominal to the last model, or ""."""
    levels = error_levels(verdict.error)
    last = "augmented" if verdict.effects else "identified"
    if last not in levels:
        return ""
    start = f"{bare_percent(levels['nominal'])} → " if "nominal" in levels else ""
    return f"{start}{percent(levels[last])}"
