"""The results of a calibration in sentences."""

import numpy as np

from residual.calibration.calibrate import Calibration
from residual.calibration.scores import (
    BLOCK,
    DEFAULT,
    FAMILY,
    LS,
    MODELS,
    NOTHING,
    PAPER_FORM,
    RANDOM,
    RUN,
    Score,
    find,
)

HIDDEN = 1.25  # ratio from which a random split is said to hide something
WORSE = 1.03  # ... from which one error is said to be above another


def sentences(result: Calibration) -> tuple[str, ...]:
    """Return the gain of the tables on unseen runs, then on other splits."""

    def score(scheme: str, model: str) -> Score | None:
        return find(result.scores, scheme, model)

    lines = []
    ours, none, ls = (score(RUN, model) for model in (DEFAULT, NOTHING, LS))
    if ours and none and ls:
        verb = "reduce" if ours.overall < 0.97 * none.overall else "do not reduce"
        lines.append(
            f"Tables {verb} the error on unseen runs: {_p(none)} → {_p(ours)} "
            f"(LS: {_p(ls)}).{_above(ours, none)}"
        )
    drawn, unseen = score(RANDOM, PAPER_FORM), score(RUN, PAPER_FORM)
    if drawn and unseen:
        ratio = unseen.overall / drawn.overall
        hides = f"hides a factor of {ratio:.1f}" if ratio >= HIDDEN else "hides little"
        lines.append(
            f"Paper form: {_p(drawn)} on a random split, {_p(unseen)} on unseen runs: "
            f"the random split {hides}."
        )
    none = score(BLOCK, NOTHING)
    if none:
        both = (score(BLOCK, model) for model in (DEFAULT, PAPER_FORM))
        text = "".join(f", {MODELS[one.model]} {_p(one)}" for one in both if one)
        lines.append(
            "On unseen blocks of the same runs, a weaker test than an unseen run: "
            f"no compensation {_p(none)}{text}."
        )
    family, none = (score(FAMILY, model) for model in (DEFAULT, NOTHING))
    if family and none:
        lines.append(
            f"On an unseen motion family: {_p(none)} → {_p(family)}."
            f"{_above(family, none)}"
        )
    return tuple(lines)


def _above(score: Score, reference: Score) -> str:
    """The joints on which one error is above another, as a sentence; empty for none."""
    joints = [str(j + 1) for j in np.flatnonzero(score.rmsev > WORSE * reference.rmsev)]
    plural = "s" if len(joints) > 1 else ""
    return f" Worse on joint{plural} {', '.join(joints)}." if joints else ""


def _p(score: Score) -> str:
    return f"{score.overall:.3g} %"
