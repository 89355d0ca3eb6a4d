"""Sentences for a verdict, its open questions, and a check of logs."""

from collections.abc import Sequence

from flows.outputs import describe_repair_file
from flows.report.phrases import (
    WEIGH_LOAD,
    At,
    capitalize_first,
    count_noun,
    effect_joints_key,
    find_effect,
    format_effect_noun,
    format_effect_place,
    format_equivalent_phrases,
    format_joints,
    is_link_or_load,
    join_with_and,
    read_page_texts,
    spell_number,
)
from residual.check.result import Fault, LogCheck
from residual.effects.base import EffectTrait
from residual.errors import format_joint_numbers
from residual.quantity import (
    format_fraction,
    format_number,
    format_percent,
    format_percent_number,
    format_probability,
    format_unit,
    is_number,
)
from residual.verdict.result import (
    LOAD,
    MOTION,
    NOTHING,
    STAGES,
    TOGETHER,
    Change,
    Dependence,
    ErrorTables,
    Finding,
    Place,
    Verdict,
    describe_settling_time,
)


def describe_unexplained(verdict: Verdict) -> list[str]:
    """Return the unexplained torque in sentences."""
    unexplained = verdict.unexplained
    words = []
    if is_number(unexplained.fraction):
        noise = f"; noise alone is {format_fraction(unexplained.noise_floor)}"
        source = f" (estimated from {unexplained.noise_model})" if unexplained.noise_model else ""
        noise = noise + source if is_number(unexplained.noise_floor) else ""
        words.append(f"Unexplained: {format_fraction(unexplained.fraction)} of the torque{noise}.")
    if unexplained.joints:
        joints = format_joints(unexplained.joints, verdict.dof)
        kind = f" It is {unexplained.kind}." if unexplained.kind else ""
        words.append(f"The residual on {joints} is larger than noise.{kind}")
    by_joint: dict[int, list[str]] = {}
    for entry in unexplained.depends_on:
        by_joint.setdefault(entry.joint, []).append(_dependence(entry))
    words += [
        f"Of the residual on joint {joint}, {join_with_and(parts)}."
        for joint, parts in by_joint.items()
    ]
    unclear = format_joints(j for j in unexplained.joints if j not in by_joint)
    if unclear:
        words.append(f"The residual on {unclear} depends on no known variable.")
    return words


def _dependence(entry: Dependence) -> str:
    share = format_fraction(entry.share)
    if entry.on == "frequency":
        return f"{share} oscillates at {format_number(entry.frequency)} Hz"
    by_sign = ", by direction of motion" if entry.form == "by direction" else ""
    if entry.on == "t":
        return f"{share} drifts with time{by_sign}"
    sign = " - " if entry.form == "difference" else " + "
    variable = sign.join(f"{entry.on}{joint}" for joint in entry.of)
    return f"{share} follows {variable}{by_sign}"


_SHOWN = 3


def describe_alternative_sets(verdict: Verdict) -> list[str]:
    """Return sentences on other sets of effects that explain the logs as well.

    Sets in which one finding gives way to its equivalent stand with that finding.
    """
    named = set()  # one joint each where a finding is on several
    for finding in verdict.effects:
        lists = any(isinstance(p.value, tuple) for p in finding.parameters.values())
        joints = [(j,) for j in finding.joints] if lists else [finding.joints]
        named |= {(finding.name, each) for each in joints}
    shown_with_finding = {
        frozenset(named - {(finding.name, finding.joints)} | {effect_joints_key(other)})
        for finding in verdict.effects
        for other in finding.equivalent
    }
    loads = [a for a in verdict.alternatives if a.separated_by == LOAD]
    sets = [
        a
        for a in verdict.alternatives
        if a.separated_by != LOAD
        and frozenset(map(effect_joints_key, a.set)) not in shown_with_finding
    ]
    lines = []
    for each in sets[:_SHOWN]:
        effects = join_with_and([format_effect_place(p, verdict.dof) for p in each.set])
        lines.append(f"Equally well supported: {effects or 'no effect at all'}.")
    if len(sets) > _SHOWN:
        more = count_noun(len(sets) - _SHOWN, "more set")
        lines.append(f"And {more}: see 'alternatives' in the JSON.")
    if sets:
        motion = any(a.separated_by == MOTION for a in sets)
        lines.append(f"{'Another' if motion else 'No'} motion would separate them.")
    bodies = [p for a in loads for p in a.set if effect_joints_key(p) not in named]
    if bodies:
        words = " or ".join(format_effect_place(body, verdict.dof) for body in bodies)
        lines.append(
            f"Part of the load may instead be {words}: no motion separates them. Weigh "
            "the load, or log the arm without it."
        )
    return lines


MOST_VALUES = 12
_LONGEST = 2  # parts of a sum that are printed; the JSON has all of them


def list_wrong_values(verdict: Verdict) -> list[Change]:
    """Return the nominal values that are off and in no finding, worst first."""
    changes = [c for c in verdict.changes if c.beyond and not c.explained]
    given = verdict.declared
    return sorted(changes, key=lambda c: (c.name not in given, -abs(compute_change_share(c))))


def describe_wrong_values(verdict: Verdict) -> str:
    """Return in one sentence which nominal values are off; empty where none is."""
    changes = list_wrong_values(verdict)
    drives = [c for c in changes if c.name in verdict.declared]
    sums = len(changes) - len(drives)
    if not changes:
        return ""
    shown = drives if len(drives) <= _SHOWN + 1 else drives[:_SHOWN]
    parts = []
    for c in shown:
        values = f"{format_number(c.nominal)} → {format_number(c.identified)} {format_unit(c.unit)}"
        parts.append(f"{name_value(c, verdict)} ({values.strip()})")
    if len(drives) > len(shown):
        parts.append(f"{spell_number(len(drives) - len(shown))} more")
    if sums:
        noun = "combination" if sums == 1 else "combinations"
        parts.append(f"{spell_number(sums)} {noun} of masses and inertias")
    verb = "value disagrees" if len(changes) == 1 else "values disagree"
    number_of = capitalize_first(spell_number(len(changes)))
    return f"{number_of} nominal {verb} with the logs: {join_with_and(parts)}."


def name_value(change: Change, verdict: Verdict) -> str:
    """Return a nominal value in words: its parameter, or the first parts of a sum."""
    if change.name not in verdict.declared:
        parts = change.parameter.split(" + ")
        more = " + ..." if len(parts) > _LONGEST else ""
        return " + ".join(parts[:_LONGEST]) + more
    words = change.name.replace("_", " ")
    if change.parameter not in words:
        words = f"{words} {change.parameter}"
    joints = format_joints(change.joints, verdict.dof)
    return f"{words} of {joints}" if joints else words


def compute_change_share(change: Change) -> float:
    """By how much a value is off, as a share of the nominal."""
    if not is_number(change.identified) or not is_number(change.nominal):
        return 0.0
    gap = change.identified - change.nominal
    return gap / abs(change.nominal) if change.nominal else float("inf")


def describe_next_experiment(verdict: Verdict) -> list[str]:
    """Return the proposed experiment, a sentence each; none where nothing is open."""
    plan = verdict.next_experiment
    if not plan:
        alike = {is_link_or_load(f) for f in verdict.effects if f.equivalent}
        if alike == {True}:
            return [f"{capitalize_first(WEIGH_LOAD)}."]
        text = "modelgap next looks for a motion that separates the alternatives."
        return [text] if alike else []
    rivals = [Place(p["name"], tuple(p["joints"])) for p in plan["rivals"]]
    apart, seconds = describe_separation(rivals), format_number(plan["seconds"])
    chance = plan["chance"]
    sure = describe_settling_time(plan["seconds"], plan.get("sure_after"), chance)
    if plan["family"] is None:
        chances = f" ({sure})" if is_number(chance) else ""
        return [
            f"{seconds} s of another motion may separate {apart}{chances}, if no "
            "obstacle is in the way: modelgap next designs it for this arm."
        ]
    periods = plan["parameters"].get("periods")
    times = f" in {count_noun(periods, 'period')}" if periods else ""
    family = plan["family"].replace("_", "-")
    program = plan["program"]
    return [
        f"{seconds} s of {family} motion{times} separates {apart}.",
        *([f"The question is {sure}."] if is_number(chance) else []),
        f"Program for the controller: {program}"
        if program
        else "modelgap next looks for a better one and writes it for a controller.",
    ]


def describe_separation(rivals: Sequence[Place]) -> str:
    """Return rivals in words: 'a spring on joint 2 from an offset on joint 2'."""
    words = [describe_place(place) for place in rivals]
    if len(words) == 2:
        return f"{words[0]} from {words[1]}"
    return f"{join_with_and(words)} from one another"


def describe_place(place: At) -> str:
    """Return a rival in words."""
    if place == NOTHING:
        return "no effect at all"
    if TOGETHER not in place.name:
        return format_effect_place(place)
    names = join_with_and(place.name.split(TOGETHER))
    return f"{names} together on {format_joint_numbers(place.joints)}"


CLEAN = "No problems found: units, signs, joint order and timing are consistent."

# What each kind of fault means; docs/check.md has more.
MEANING = read_page_texts()["faults"]

# The motion that would help, the most useful first.
MORE_MOTION = {
    "too_short": "Record 20 s or more in which every joint moves back and forth.",
    "lockstep": "Move the joints independently: modelgap trajectory fourier.",
    "no_reversal": "Move each joint back and forth several times.",
}


def summarize_check(report: LogCheck) -> str:
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


def title_fault(fault: Fault) -> str:
    """Return a fault and its joints: 'torque has the opposite sign (joint 2)'."""
    joints = format_joints(fault.joints)
    meaning = MEANING.get(fault.kind, fault.kind.replace("_", " "))
    return f"{meaning} ({joints})" if joints else meaning


def describe_faults(report: LogCheck) -> list[str]:
    """Return a paragraph for each fault."""
    lines = []
    for fault in report.faults:
        sure = "certain" if fault.certain else "suspected"
        either = ", or ".join([title_fault(fault), *fault.rivals[:1]])
        lines += ["", f"{capitalize_first(either)}: {fault.kind}, {sure}."]
        lines += [f"  {line}" for line in fault.evidence.splitlines()]
        if fault.rivals[1:]:
            lines.append(f"  Or: {'; '.join(fault.rivals[1:])}.")
        if fault.settle:
            lines.append(f"  To settle it: {fault.settle}")
        for number, repair in enumerate(fault.repair):
            word = "Fix" if number == 0 else "Or as well"
            lines.append(f"  {word} ({describe_repair_file(repair)}):")
            lines += [f"    {line}" for line in repair.splitlines()]
    return lines


_NAMED_AT_MOST = 3
_SURE = 0.9
_DIFFERS = 1.02  # factor between errors: a smaller one is no difference
_NO_MODEL, _NO_NOMINAL = 50.0, 200.0  # % of torque: no model of these logs


def format_headline(verdict: Verdict) -> str:
    """Return the verdict in one to four plain sentences."""
    return " ".join(list_headline_sentences(verdict))


def list_headline_sentences(verdict: Verdict) -> list[str]:
    """Return the sentences of the headline; the first is the verdict itself."""
    dof = verdict.dof
    parts = [format_claim(verdict)]
    if any(effect.equivalent for effect in verdict.effects[:_NAMED_AT_MOST]):
        parts.append("These logs cannot separate the alternatives in brackets.")
    parts += [describe_errors(verdict), describe_position(verdict)]
    parts += [_first_fitted(verdict), describe_wrong_values(verdict)]
    joints = format_joints(verdict.unexplained.joints, dof)
    if joints and verdict.effects:
        parts.append(f"No known effect explains the remaining error on {joints}.")
    usual = [format_effect_place(f, dof) for f in verdict.background]
    if usual:
        parts.append(f"Also present, as on any used arm: {join_with_and(usual)}.")
    parts.append(_drift(verdict))
    names = [
        f"{format_effect_place(f, dof)} ({format_probability(f.probability)})"
        for f in verdict.suspected
    ]
    if names:
        parts.append(f"Suspected, but not certain enough to be named: {join_with_and(names)}.")
    if not verdict.trusted:
        words = join_with_and([title_fault(f) for f in verdict.log_check.certain])
        parts.insert(0, f"The logs have a fault ({words}): what follows may be due to it.")
    return [part for part in (*_more_motion(verdict.log_check), *parts) if part]


def format_claim(verdict: Verdict) -> str:
    """Return the claim of a verdict in one sentence."""
    faults = verdict.log_check.faults if verdict.log_check else ()
    if verdict.verdict == "effects":
        return _effects(verdict)
    if verdict.verdict == "unknown":
        if verdict.contradictions:
            return " ".join(capitalize_first(f"{c}.") for c in verdict.contradictions)
        where = format_joints(verdict.unexplained.joints, verdict.dof)
        return f"The model lacks something on {where} that no known effect explains."
    doubts = [f for f in faults if f.rivals and not f.certain]
    if doubts:
        lines = ["No missing effect found."]
        for fault in doubts:
            others = ", or ".join(fault.rivals)
            words = f"Either {title_fault(fault)}, or {others}. {fault.settle}"
            lines.append(words.strip())
        return " ".join(lines)
    words = join_with_and([title_fault(f) for f in faults if f.repair])
    if words:
        return (
            f"No missing effect found, but the logs may be faulty: {words}. First "
            "apply the fix that `modelgap check` proposes."
        )
    nominal, refit = map(verdict.error.overall_moving.get, STAGES[:2])
    if (is_number(refit) and refit > _NO_MODEL) or (is_number(nominal) and nominal > _NO_NOMINAL):
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
        others = format_equivalent_phrases(effect, dof)
        words = format_effect_place(effect, dof)
        words += f" (or {' or '.join(others)})" if others else ""
        (wrong if is_wrong_value(effect, verdict) else lacking).append(words)
    (wrong or lacking).extend(
        [f"{spell_number(len(effects) - len(shown))} more"] * (len(effects) > len(shown))
    )
    clauses = [f"lacks {join_with_and(lacking)}"] if lacking else []
    if wrong:
        value = "wrong values" if len(wrong) > 1 else "a wrong value"
        clauses.append(f"has {value} for {join_with_and(wrong)}")
    likely = [e.probability for e in shown if is_number(e.probability)]
    hedge = "most likely " if min(likely, default=1.0) < _SURE else ""
    return f"The model {hedge}{join_with_and(clauses)}."


def is_wrong_value(effect: Finding, verdict: Verdict) -> bool:
    """Return whether the model has this effect, only with a wrong value."""
    traits = find_effect(effect.name).traits
    if effect.name in verdict.declared or EffectTrait.IN_EVERY_MODEL in traits:
        return True
    mass = effect.parameters.get("mass")
    return mass is not None and is_number(mass.value) and mass.value < 0


def summarize_errors(errors: ErrorTables) -> dict[str, float]:
    """Return the held-out error of all joints by model [%], for every text.

    While they move, where that is known: friction history sets the torque at
    standstill, and no model does.
    """
    for levels in (errors.overall_moving, errors.overall_filtered, errors.overall):
        if is_number(levels.get("identified")) or is_number(levels.get("augmented")):
            return {k: levels[k] for k in STAGES[:3] if is_number(levels.get(k))}
    return {}


def describe_position(verdict: Verdict) -> str:
    """Return the position error of models in free simulation, before and after."""
    position = verdict.error.position
    if position is None:
        return ""
    names = {"nominal": "nominal"}
    if verdict.effects:
        names["augmented"] = format_augmented_label(verdict)
    else:
        names["identified"] = "refit"
    steps = [
        f"diverged in {join_with_and(at)} ({words})"
        if (at := position.diverged[k])
        else f"{format_number(position.overall[k])} rad ({words})"
        for k, words in names.items()
    ]
    return f"Position by itself under the logged goal, rms: {' → '.join(steps)}."


def format_augmented_label(verdict: Verdict) -> str:
    """Return the difference of the augmented model: 'with payload'."""
    named = verdict.effects
    if len(named) == 1:
        return f"with {named[0].name.replace('_', ' ')}"
    return f"with {count_noun(len(named), 'finding')}"


def describe_errors(verdict: Verdict) -> str:
    """Return the error on unseen motion, from the nominal model to the last one.

    The refit is listed if its error lies between: its gain is not due to a finding.
    """
    levels = summarize_errors(verdict.error)
    nominal, refit = levels.get("nominal"), levels.get("identified")
    words = {"nominal": "nominal", "identified": "refit"}
    if not verdict.effects:
        levels.pop("augmented", None)
    elif "augmented" not in levels:
        return "No held-out motion tests this."
    else:
        words["augmented"] = format_augmented_label(verdict)
        after = levels["augmented"]
        if is_number(nominal) and is_number(refit):
            between = nominal > _DIFFERS * refit and refit > _DIFFERS * after
            levels = levels if between else {"nominal": nominal, "augmented": after}
    if not levels:
        return ""
    weak = " (end of the fitted run, a weak test)" if verdict.error.same_run else ""
    steps = " → ".join(f"{format_percent(v)} ({words[k]})" for k, v in levels.items())
    out = f"Error on unseen motion{weak}: {steps}."
    moving = verdict.error.moving
    pairs = [*zip(moving["identified"] or (), moving["augmented"] or (), strict=False)]
    worse = [  # beyond chance
        f"joint {j} ({format_percent(pairs[j - 1][0])} → {format_percent(pairs[j - 1][1])})"
        for j in verdict.error.worse
        if j <= len(pairs)
    ]
    return f"{out} The findings raise it on {join_with_and(worse)}." if worse else out


def _first_fitted(verdict: Verdict) -> str:
    """Return which effects explain a better refit though the robot has no values."""
    levels = summarize_errors(verdict.error)
    nominal, refit = levels.get("nominal"), levels.get("identified")
    # Every value of the robot is in `changes`; a verdict without any lists none.
    given = {change.name for change in verdict.changes}
    nouns = [format_effect_noun(n) for n in verdict.declared if n not in given]
    if verdict.verdict != "none" or not (given and nouns and nominal and refit):
        return ""
    if nominal < _DIFFERS * refit:
        return ""
    return f"The refit also fitted {join_with_and(nouns)}, for which the robot file has no values."


def _more_motion(report: LogCheck | None) -> list[str]:
    """Return the limit of a poor motion, and the motion that would help."""
    for kind, help in MORE_MOTION.items() if report else ():
        faults = [fault for fault in report.faults if fault.kind == kind]
        joints = format_joints(joint for fault in faults for joint in fault.joints)
        if faults:
            where = f" ({joints})" if joints else ""
            return [f"These logs show little: {MEANING[kind]}{where}. {help}"]
    return []


def _drift(verdict: Verdict) -> str:
    """Return by how much the friction of the joints moved together, or nothing."""
    d = verdict.drift
    if d is None:
        return ""
    by, std = (format_percent(100 * x) for x in (abs(d.factor - 1), d.std))
    side, arm = ("lower", "warmer") if d.factor < 1 else ("higher", "colder")
    joints = format_joints(d.joints, verdict.dof)
    return f"Friction on {joints} is {by} (± {std}) {side} than in the baseline, as on a {arm} arm."


def format_brief_claim(verdict: Verdict) -> str:
    """Return the claim with its error: "The model lacks ..., 9.6 → 7.1 %"."""
    parts = format_claim(verdict).removesuffix("."), format_error_change(verdict)
    return ", ".join(part for part in parts if part)


def format_error_change(verdict: Verdict) -> str:
    """Return the error on unseen motion from the nominal to the last model, or ""."""
    levels = summarize_errors(verdict.error)
    last = "augmented" if verdict.effects else "identified"
    if last not in levels:
        return ""
    start = f"{format_percent_number(levels['nominal'])} → " if "nominal" in levels else ""
    return f"{start}{format_percent(levels[last])}"
