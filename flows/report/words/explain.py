"""What `modelgap explain` says, and every word of the program that it explains.

Texts are Markdown, so that the terminal and the site of the documents show the same.
Effects explain themselves (`residual/effects/`).
"""

import sys
from collections.abc import Mapping
from difflib import get_close_matches
from inspect import getdoc

from flows.report.words.phrases import sentence_case
from residual.effects import registry
from residual.effects.base import Effect
from residual.errors import UnknownNameError, listed, shown

VERDICTS: Mapping[str, str] = {
    "effects": (
        "The verdict: at least one physical effect that the model lacks is named, with "
        "its joint and size. It was needed to explain the fit logs, won again with a "
        "third of the data left out, and did not make the held-out motion worse. Next: "
        "check the size against what you know of the arm; adopt the model."
    ),
    "unknown": (
        "The verdict: more than noise is left on some joint, and no known effect "
        "explains it; or the logs are at fault. The model should not be trusted there. "
        "Next: read which joint, and what its remainder depends on; `modelgap next` "
        "designs a motion that would tell the candidates apart."
    ),
    "none": (
        "The verdict: no known effect is missing that these logs could show. It is as "
        "good as the list of minimum detectable sizes: what is smaller than that may "
        "still be there. Next: look up the size that matters to you in that list."
    ),
    "changes": (
        "Values of the model that these logs contradict: friction, rotor or inertia "
        "declared as one number and found to be another. They stand in a table of "
        "their own, whatever the verdict. Next: correct the value in robot.toml, or "
        "adopt the model."
    ),
    "ambiguous": (
        "A named effect with `equivalent` others: these logs cannot tell them apart. "
        "One of them is there. Next: `modelgap next` designs the motion that decides; "
        "where none can, the sentence says so and only a measurement by hand helps."
    ),
}

TERMS: Mapping[str, str] = {
    "adopted model": (
        "The model that a robot has in the store from now on: that of a diagnosis, "
        "taken over by `modelgap adopt`, given back by `modelgap rollback`."
    ),
    "alternatives": (
        "Whole sets of effects that explain the logs as well as the named set, within "
        "6 nats. One of the sets is right; these logs do not say which."
    ),
    "augmented model": (
        "The identified model with the effects that were found, all fitted together."
    ),
    "background": (
        "Small friction and ripple that every joint of a used arm has beside something "
        "much larger. It is said in one sentence instead of many names."
    ),
    "base parameters": (
        "The sums of masses, centres and inertias that motion can determine at all. A "
        "six-joint arm has 60 inertial parameters and some 36 base parameters."
    ),
    "baseline": (
        "Logs of the same arm while it was healthy. With them the question is what has "
        "changed since, which is easier than what is missing from a data sheet."
    ),
    "blind study": (
        "Arms with hidden effects are drawn at random, diagnosed, and only then is the "
        "truth opened: how often the program is right, as a number."
    ),
    "campaign": "Many experiments from one file: a grid, or random draws.",
    "contradictions": (
        "What of a fit no real arm can be: friction that drives, an inertia below "
        "zero. With one of them the verdict is never `none`."
    ),
    "declared effect": (
        "An effect that the nominal model already has, by robot.toml or `--declared`."
    ),
    "drift": (
        "With a baseline: friction of all joints together, now against then. It moves "
        "with warmth and wear, and is no effect by itself."
    ),
    "edit test": (
        "A found effect is taken out of the augmented model again, without a new fit, "
        "and an arm that never had it is predicted. Only the right cause passes."
    ),
    "effect": (
        "One physical cause of torque with a name: a kind of friction, a payload, a "
        "spring, a wrong sensor."
    ),
    "equivalent": (
        "Another effect that these logs cannot tell from the one that is named."
    ),
    "error": (
        "100 * ||measured - predicted torque|| / ||measured torque||, in per cent. The "
        "denominator is the torque, so a joint that carries little shows a large one."
    ),
    "evidence": (
        "How much likelier the logs are with an effect than without it, in nats."
    ),
    "excitation": (
        "How much a motion moves every parameter. Without enough of it no method can "
        "tell causes apart; `modelgap trajectory` designs motion that has it."
    ),
    "gear side": (
        "Torque of the motor times gear ratio is torque of the link. A log must say "
        "which it has: `side` in COLUMNS.toml."
    ),
    "held out": (
        "Logs, or a part of one, that no fit and no choice has seen. They prove."
    ),
    "identification filter": (
        "A low-pass (8 Hz, or 8 % of the sample rate) for torque and for every column "
        "of the model alike, so that it cannot be mistaken for dynamics."
    ),
    "identified model": (
        "The nominal model with its own parameters fitted to the logs, and nothing "
        "added: it shows how much of a gain is mere fitting."
    ),
    "loadings": "Of PCA or PLS: how much each original variable is in a component.",
    "log check": (
        "What `modelgap check` says of the logs before anything is fitted: wrong unit, "
        "sign, order of joints, clock, sensor."
    ),
    "minimum detectable": (
        "The size of an effect of which half would have been found in these logs. It "
        "says how much the answer `none` is worth."
    ),
    "monitor": (
        "Scores of new runs against a model of healthy ones: is a sensor still right?"
    ),
    "nats": (
        "Units of evidence: the natural logarithm of how many times likelier the logs "
        "are. 10 nats are a factor of 22 000, and the least for a name; within 6 nats "
        "(a factor of 400) two names count as not told apart."
    ),
    "noise floor": "The part of the torque that is noise, and that no model explains.",
    "nominal model": (
        "What was believed before the logs were seen: inertias of the URDF and the "
        "declared effects."
    ),
    "null": (
        "Recordings of your arm in which nothing is missing, made from your own logs "
        "by `modelgap calibrate-null`. How often they give a name is the false-alarm "
        "rate, and from them comes the p-value."
    ),
    "p-value": (
        "How often logs in which nothing is missing would show as much evidence. From "
        "a null; empty without one."
    ),
    "plsr": (
        "Partial least squares regression of what no name explains, on the state of "
        "the joint: tables that correct the torque without saying why."
    ),
    "prior": (
        "What is believed before the logs: how far an inertia or a friction may be "
        "from its given value."
    ),
    "probability": (
        "How sure the name is (with its equivalents), against all other candidates. "
        "It is not the probability that nothing else is missing."
    ),
    "recording": "One checked log in memory: time, angles, torque in SI units.",
    "regressor": (
        "The matrix Y(q, qd, qdd) that makes torque of inertial parameters: "
        "tau = Y * parameters."
    ),
    "residual": "Measured torque minus the torque of a model, in N m. Nothing else.",
    "rmsec": "Root mean square error of calibration: on rows that were fitted.",
    "rmsev": "Root mean square error of validation: on rows that were left out.",
    "run": (
        "A recording that is kept in the store, with a record of how it came to be."
    ),
    "scores": "Of PCA or PLS: how much of each component a sample has.",
    "splits": (
        "The search done again three times, each with a third of the data left out. "
        "'3 of 3' is a name that does not hang on one part of the data."
    ),
    "standstill": (
        "Friction at rest may have any value up to breakaway, so no model predicts it. "
        "Rows near it do not count in a fit, and errors are also shown without them."
    ),
    "store": "A folder of Parquet files with all runs, diagnoses and models.",
    "unexplained": "Joints on which more than noise is left after all that was named.",
}


def entries() -> dict[str, str]:
    """Every word with its explanation, verdicts first."""
    return {**VERDICTS, **TERMS}


_WHERE = {
    "local": "one joint; its torque is on that joint alone",
    "pair": "two neighbouring joints that share gearing",
    "link": "one joint, and through the arm on the torque of all others",
    "flange": "the flange, reported at the last joint",
    "global": "the whole arm; reported without a joint",
}


def explain(word: str) -> str:
    """Return the explanation of one word, as Markdown.

    Args:
        word: An effect's name, or a word of the glossary, however it is spaced.

    Raises:
        UnknownNameError: If there is none; the message has the nearest.
    """
    effects, words = registry(), entries()
    wanted = _key(word)
    names = {_key(name): name for name in (*words, *effects)}
    names |= {_key(each.noun): name for name, each in effects.items() if each.noun}
    if wanted not in names:
        near = get_close_matches(wanted, names, n=3, cutoff=0.5)
        hint = f"did you mean {' or '.join(map(repr, near))}? " if near else ""
        raise UnknownNameError(
            f"Nothing is known of {shown(word)}: {hint}"
            "modelgap explain lists all words."
        )
    name = names[wanted]
    if name in effects:
        return effect_page(effects[name])
    return f"# {name}\n\n{words[name]}\n"


def overview() -> str:
    """Return all words that can be explained, one line each, as Markdown."""
    effects = [f"- **{each.name}**: {each.sentence}" for each in registry().values()]
    verdicts = [f"- **{name}**: {_first(text)}" for name, text in VERDICTS.items()]
    return "\n".join(
        [
            "## Effects that a model may lack\n",
            *effects,
            "\n## Words of a verdict\n",
            *verdicts,
            "\n## Other words\n",
            f"{listed(TERMS)}.",
        ]
    )


def effect_page(effect: Effect) -> str:
    """Return the page of one effect, from its own file and nothing else."""
    parts = [
        f"# {sentence_case(effect.noun or effect.name.replace('_', ' '))}",
        f"`{effect.name}`: {effect.sentence}.",
        f"## Equation\n\n{equation(effect)}",
        f"## Parameters\n\n{_parameters(effect.parameters)}",
        f"It acts on {_WHERE[effect.scope]}.{_wrong_value(effect)}",
        f"## What it is\n\n{_about(effect)}",
        *_confused(effect),
        *(
            [f"Where held-out motion refutes it: {effect.if_refuted}"]
            if effect.if_refuted
            else []
        ),
    ]
    return "\n\n".join(parts) + "\n"


def equation(effect: Effect) -> str:
    """Return its law as a block of Markdown, one line per part."""
    lines = [f"    {line.strip()}" for line in effect.law.split(";")]
    return "\n".join(lines)


def _parameters(parameters: Mapping[str, str]) -> str:
    rows = [f"- `{key}` [{unit}]" for key, unit in parameters.items()]
    return "\n".join(rows)


def _wrong_value(effect: Effect) -> str:
    if not effect.is_parameter:
        return ""
    return (
        " Where the model has it already, a verdict means that its value is wrong, and "
        "the number is the change to it."
    )


def _about(effect: Effect) -> str:
    """The text at the top of the file that the effect stands in."""
    return getdoc(sys.modules[f"residual.effects.{effect.name}"]) or effect.sentence


def _confused(effect: Effect) -> list[str]:
    """Members of its family: small motion does not tell them apart."""
    if not effect.family:
        return []
    names = [
        f"`{other.name}`"
        for other in registry().values()
        if other.family == effect.family and other.name != effect.name
    ]
    return [
        f"## Easily confused with\n\n{listed(names)}. On one joint only one of them is "
        "named, and motion that is too small does not tell which."
    ]


def _key(word: str) -> str:
    small = " ".join(word.lower().replace("_", " ").replace("-", " ").split())
    for article in ("a ", "an ", "the "):
        small = small.removeprefix(article)
    return small


def _first(text: str) -> str:
    return text.removeprefix("The verdict: ").split(". ")[0].split(": these")[0] + "."
