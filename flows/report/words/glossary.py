"""Every word of the program that is not everyday English, explained once.

`modelgap explain WORD` prints an entry, and the glossary of the documents is this file.
Effects explain themselves (`residual/effects/`).
"""

from collections.abc import Mapping

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
