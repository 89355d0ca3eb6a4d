"""What a calibration shows, in sentences made of its figures."""

from collections.abc import Sequence

import numpy as np

from residual.calibration.calibrate import Calibration
from residual.calibration.methods import DEFAULT, EFFECTS, LS, NONE, PAPER_FORM, WORDS
from residual.calibration.scores import (
    BLOCK,
    FAMILY,
    RANDOM,
    REPEATS,
    RUN,
    SYSTEMATIC,
    Score,
    find,
    ratio_interval,
)
from residual.calibration.views import Plane

HIDDEN = 1.25  # ratio from which random rows are said to hide something
WORSE = 1.03  # ... from which one error is said to be above another


def sentences(result: Calibration) -> tuple[str, ...]:
    """Return what the table shows, the verdict on random rows first."""
    parts = [
        _random_words(result.scores),
        _repeat_words(result.scores),
        _default_words(result.scores),
        _block_words(result.scores),
        _family_words(result.scores),
        _effect_words(result.scores),
        _level_words(result),
        _jackknife_words(result),
    ]
    return tuple(s for s in parts if s)


def plane_words(plane: Plane) -> tuple[str, ...]:
    """Return what the first two components of PLSR are made of, a sentence each."""
    out = []
    for component, share in enumerate(plane.explained):
        strong = plane.strong(component)
        states = [_loading(*s) for s in strong if not s[0].startswith("residual")]
        joints = [_loading(*s) for s in strong if s[0].startswith("residual")]
        text = f"Component {component + 1} explains {share:.0f} % of the residuals"
        if not states:
            text += ", and no variable has a correlation of 0.5 with it"
        else:
            text += f" and goes with {', '.join(states)}"
        if states and joints:
            text += f"; with {', '.join(joints)}{_meaning(strong)}"
        elif states:
            text += "; no joint's residual goes with it"
        out.append(f"{text}.")
    return tuple(out)


def _loading(name: str, correlation: float) -> str:
    return f"{name} ({correlation:+.2f})"


def _meaning(strong: Sequence[tuple[str, float]]) -> str:
    """What a model that lacks it would lack, where states of one kind lead."""
    first = next(name for name, _ in strong if not name.startswith("residual"))
    kinds = {
        "qdd": "grows with acceleration: inertia is wrong or missing",
        "qd": "grows with speed: friction is wrong or missing",
        "q": "goes with position: gravity, a spring or a balancer",
    }
    return f", so that it {kinds[first.rstrip('0123456789')]}"


def _random_words(scores: Sequence[Score]) -> str | None:
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


def _repeat_words(scores: Sequence[Score]) -> str | None:
    rows, grouped = (
        find(scores, SYSTEMATIC, PAPER_FORM),
        find(scores, REPEATS, PAPER_FORM),
    )
    if rows is None or grouped is None:
        return None
    ratio = grouped.overall / rows.overall
    if ratio < HIDDEN:
        return (
            f"Keeping repetitions together changes little: {_p(rows)} and "
            f"{_p(grouped)} with the paper form."
        )
    return (
        f"Systematic blocks are no cure where a program repeats: the paper form "
        f"leaves {_p(rows)} of a block whose repetition it was fitted to, "
        f"{_p(grouped)} once all repetitions are left out together."
    )


def _default_words(scores: Sequence[Score]) -> str | None:
    ours, none = find(scores, RUN, DEFAULT), find(scores, RUN, NONE)
    ls = find(scores, RUN, LS)
    if ours is None or none is None or ls is None:
        return None
    text = f"On unseen runs the default form leaves {_p(ours)}, no compensation "
    text += f"{_p(none)}, LS {_p(ls)}"
    worse = _above(ours, none)
    if worse:
        return f"{text}; it is above no compensation on {_joints(worse)}."
    gain = 1 - ours.overall / none.overall
    if gain < 0.03:
        return f"{text}: there is little that tables can add to this model."
    return f"{text}; it is nowhere more than 3 % above no compensation."


def _block_words(scores: Sequence[Score]) -> str | None:
    """What unseen blocks of few runs say, each model against no compensation."""
    none = find(scores, BLOCK, NONE)
    if none is None:
        return None
    rng = np.random.default_rng(0)
    text = []
    for model in (DEFAULT, PAPER_FORM, EFFECTS):
        one = find(scores, BLOCK, model)
        if one is not None:
            ratio = ratio_interval(one, none, rng)
            text.append(f"{WORDS[model]} {_p(one)}, which is {ratio} times that")
    return (
        f"On unseen blocks of the same runs, which ask less than an unseen run, no "
        f"compensation leaves {_p(none)}; {'; '.join(text)}."
    )


def _family_words(scores: Sequence[Score]) -> str | None:
    runs, families = find(scores, RUN, DEFAULT), find(scores, FAMILY, DEFAULT)
    none = find(scores, FAMILY, NONE)
    if runs is None or families is None or none is None:
        return None
    text = (
        f"On a kind of motion that it never saw, the default form leaves "
        f"{_p(families)}, no compensation {_p(none)}"
    )
    worse = _above(families, none)
    return f"{text}; above it on {_joints(worse)}." if worse else f"{text}."


def _effect_words(scores: Sequence[Score]) -> str | None:
    ours, named = find(scores, RUN, DEFAULT), find(scores, RUN, EFFECTS)
    if ours is None or named is None:
        return None
    better = named.overall < ours.overall
    return (
        f"With the effects that the diagnosis named, {_p(named)} are left on unseen "
        f"runs: {'less' if better else 'more'} than the {_p(ours)} of the tables"
        + (", and each effect has a name." if better else ".")
    )


def _level_words(result: Calibration) -> str | None:
    if result.sweep is None:
        return None
    best = {
        name: result.sweep.levels[int(np.nansum(errors**2, axis=1).argmin())]
        for name, errors in result.sweep.errors.items()
    }
    if set(best) != {RUN, RANDOM}:
        return None
    text = (
        f"Of {result.sweep.levels[0]} to {result.sweep.levels[-1]} levels, random rows "
    )
    if best[RUN] == best[RANDOM]:
        return f"{text}and unseen runs both ask for {best[RUN]}."
    return f"{text}ask for {best[RANDOM]}, unseen runs for {best[RUN]}."


def _jackknife_words(result: Calibration) -> str | None:
    """What random rows say of the terms' significance, and what runs say."""
    if result.terms is None:
        return None
    parts = result.terms.by_rows, result.terms.sizes
    over_rows, over_runs = (100 * float(part.significant.mean()) for part in parts)
    text = (
        f"Jack-knifed over random rows {over_rows:.0f} % of all contributions are "
        f"significant, over runs {over_runs:.0f} %"
    )
    if over_rows < HIDDEN * over_runs:
        return f"{text}."
    return (
        f"{text}: rows left out have their neighbours in the fit, so that they say how "
        "well a contribution is known on these paths, and not whether another has it."
    )


def _above(one: Score, other: Score) -> list[int]:
    """Joints, from 1, on which one error is above another."""
    return [int(j) + 1 for j in np.flatnonzero(one.rmsev > WORSE * other.rmsev)]


def _joints(numbers: Sequence[int]) -> str:
    word = "joint" if len(numbers) == 1 else "joints"
    return f"{word} {', '.join(map(str, numbers))}"


def _p(score: Score) -> str:
    return f"{score.overall:.3g} %"


__all__ = ["WORDS", "sentences"]
