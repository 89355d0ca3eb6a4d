"""What a calibration shows, in sentences made of its figures."""

from collections.abc import Sequence

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

HIDDEN = 1.25  # ratio from which random rows are said to hide something
WORSE = 1.03  # ... from which one error is said to be above another


def sentences(result: Calibration) -> tuple[str, ...]:
    """Return what the table shows, the verdict on random rows first."""
    scores = result.scores
    parts = (_random, _default, _block, _family)
    return tuple(s for s in (part(scores) for part in parts) if s)


def _random(scores: Sequence[Score]) -> str | None:
    """What random rows say of the paper's form, and what unseen runs say."""
    drawn, unseen = find(scores, RANDOM, PAPER_FORM), find(scores, RUN, PAPER_FORM)
    ls_drawn, ls_unseen = find(scores, RANDOM, LS), find(scores, RUN, LS)
    if None in (drawn, unseen, ls_drawn, ls_unseen):
        return None
    ratio = unseen.overall / drawn.overall
    start = (
        f"On random rows the paper form leaves {_p(drawn)} of the torque where LS "
        f"leaves {_p(ls_drawn)}; on unseen runs it leaves {_p(unseen)}"
    )
    if ratio < HIDDEN:
        return f"{start} and LS {_p(ls_unseen)}: random rows hide little here."
    lost = unseen.overall > WORSE * ls_unseen.overall
    also = "more than LS with" if lost else "against LS with"
    return f"{start}, {also} {_p(ls_unseen)}: random rows hide a factor of {ratio:.1f}."


def _default(scores: Sequence[Score]) -> str | None:
    ours, none, ls = (find(scores, RUN, model) for model in (DEFAULT, NOTHING, LS))
    if ours is None or none is None or ls is None:
        return None
    text = f"On unseen runs the default form leaves {_p(ours)}, no compensation "
    text += f"{_p(none)}, LS {_p(ls)}"
    worse = _above(ours, none)
    if worse:
        return f"{text}; it is above no compensation on {worse}."
    if ours.overall > 0.97 * none.overall:
        return f"{text}: there is little that tables can add to this model."
    return f"{text}; it is nowhere more than 3 % above no compensation."


def _block(scores: Sequence[Score]) -> str | None:
    """What unseen blocks of few runs say, each model against no compensation."""
    none = find(scores, BLOCK, NOTHING)
    if none is None:
        return None
    both = (find(scores, BLOCK, model) for model in (DEFAULT, PAPER_FORM))
    text = "; ".join(f"{MODELS[one.model]} {_p(one)}" for one in both if one)
    return (
        "On unseen blocks of the same runs, which ask less than an unseen run, no "
        f"compensation leaves {_p(none)}; {text}."
    )


def _family(scores: Sequence[Score]) -> str | None:
    families, none = (find(scores, FAMILY, model) for model in (DEFAULT, NOTHING))
    if families is None or none is None:
        return None
    text = (
        f"On a kind of motion that it never saw, the default form leaves "
        f"{_p(families)}, no compensation {_p(none)}"
    )
    worse = _above(families, none)
    return f"{text}; above it on {worse}." if worse else f"{text}."


def _above(one: Score, other: Score) -> str:
    """Joints, from 1, on which one error is above another; empty where on none."""
    joints = [str(j + 1) for j in np.flatnonzero(one.rmsev > WORSE * other.rmsev)]
    word = "joint " if len(joints) == 1 else "joints "
    return word + ", ".join(joints) if joints else ""


def _p(score: Score) -> str:
    return f"{score.overall:.3g} %"
