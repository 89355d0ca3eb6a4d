"""Schemes of validation, and the errors of one model under each of them.

RMSEC and RMSEV are 100 ||Y* - Yhat|| / ||Y*|| on the rows that a fold fitted and on
those that it held out (paper, eq. 29), Y* the measured torque.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.calibration.methods import PAPER_FORM, PLSR, Method, Training
from residual.calibration.rows import Rows
from residual.errors import InputError
from residual.recording import Array
from residual.tables.crossval import (
    BLOCKS,
    Folds,
    fold_power,
    leave_one_out,
    random_blocks,
    relative_error,
    systematic,
    systematic_repeats,
)

RUN, FAMILY, SYSTEMATIC = "run", "family", "systematic"
REPEATS, RANDOM = "repeats", "random"
WORDS = {
    RUN: "leave one run out",
    FAMILY: "leave one family out",
    REPEATS: "systematic, repeats together",
    SYSTEMATIC: f"systematic {BLOCKS}",
    RANDOM: f"random {BLOCKS}",
}
UNSEEN = (RUN, FAMILY)  # whole motions are left out

# What a model leaves on all rows when it is identified without some runs. (n, j).
Response = Callable[[Collection[int]], Array]


@dataclass(frozen=True, eq=False, slots=True)
class Scheme:
    """One scheme.

    Attributes:
        name: Key of `WORDS`.
        folds: Which rows are held out together.
        left_out: Runs that the nominal model of each fold must not see.
    """

    name: str
    folds: Folds
    left_out: tuple[frozenset[int], ...]


def make_schemes(
    rows: Rows, rng: np.random.Generator
) -> tuple[tuple[Scheme, ...], tuple[str, ...]]:
    """Return the schemes that these rows allow, and why others are left out.

    Args:
        rows: All rows.
        rng: Source of the random blocks.

    Raises:
        InputError: If there is a single run, or fewer rows than blocks.
    """
    if len(rows.labels) < 2:
        raise InputError("One run: expected two or more to leave one out.")
    count, notes, out = len(rows.X), [], []
    alone = tuple(frozenset([i]) for i in range(len(rows.labels)))
    out.append(Scheme(RUN, leave_one_out(rows.run), alone))
    families = sorted(set(rows.families))
    if len(families) > 1 and "" not in families:
        together = tuple(
            frozenset(i for i, f in enumerate(rows.families) if f == family)
            for family in families
        )
        out.append(Scheme(FAMILY, leave_one_out(rows.family, FAMILY), together))
    else:
        notes.append(
            "no family left out: "
            + (
                "all runs are of one"
                if len(families) == 1 and families[0]
                else "the kind of motion of the logs is not known"
            )
        )
    periods = rows.periods()
    repeating = [i for i, p in periods.items() if p < (rows.run == i).sum()]
    if repeating:
        out.append(_by_rows(REPEATS, systematic_repeats(rows.run, periods)))
    else:
        notes.append("no run repeats itself: repeats cannot be kept together")
    out.append(_by_rows(SYSTEMATIC, systematic(count)))
    out.append(_by_rows(RANDOM, random_blocks(count, rng)))
    return tuple(out), tuple(notes)


def _by_rows(name: str, folds: Folds) -> Scheme:
    # A few dozen parameters from thousands of rows do not know one block of them, and
    # these schemes leave rows of the same motion in the training set anyway.
    return Scheme(name, folds, (frozenset(),) * folds.count)


@dataclass(frozen=True, eq=False, slots=True)
class Score:
    """One cell of the table.

    Attributes:
        scheme, model: Their names.
        rmsec, rmsev: Pooled over folds [%]. Shapes (j,).
        mean: RMSEV as the paper takes it, the mean over folds [%]. Shape (j,).
        components: Components A_opt, None for a model that has none.
        curve: RMSEV over components, from none on [%]. Shape (A + 1, j), or None.
        miss, power: Squared error and squared torque per fold [N^2 m^2]. (folds, j).
    """

    scheme: str
    model: str
    rmsec: Array
    rmsev: Array
    mean: Array
    components: int | None
    curve: Array | None
    miss: Array
    power: Array

    @property
    def overall(self) -> float:
        """RMSEV over all joints together [%]."""
        return float(relative_error(self.miss.sum(), self.power.sum()))


def score(
    scheme: Scheme, model: str, method: Method, rows: Training, response: Response
) -> Score:
    """Fit a model without each fold, and judge it on that fold.

    Args:
        scheme: What is held out, and which runs the nominal model must not see.
        model: Name of the model.
        method: How it is fitted.
        rows: All rows; their Y is not used.
        response: What a nominal model leaves that was identified without some runs.
    """
    fitted, unseen, power_c = [], [], []
    # Rows of every run are fitted under the other schemes: no choice is made there.
    depends = rows.without is not None and scheme.name in UNSEEN
    for fold, left_out in enumerate(scheme.left_out):
        held = scheme.folds.of_row == fold
        Y = response(left_out)
        told = replace(rows, Y=Y, without=None)
        training = told.rows(~held)
        if depends:
            without = _one_more(response, left_out, ~held)
            training = replace(training, without=without)
        forecast = method(training)
        fitted.append(_squares(training.Y, forecast(training)))
        unseen.append(_squares(Y[held], forecast(told.rows(held))))
        power_c.append((training.tau**2).sum(axis=0))
    power = fold_power(rows.tau, scheme.folds)
    sums = np.array(fitted), np.array(unseen), np.array(power_c), power
    return _score(scheme.name, model, sums)


def _one_more(response: Response, left_out: frozenset[int], kept: Array):
    return lambda run: response(left_out | {run})[kept]


def judge_responses(
    scheme: Scheme, model: str, rows: Training, response: Response
) -> Score:
    """Judge a model that is all in the response: nothing is fitted to it."""
    return score(scheme, model, _zero, rows, response)


def _zero(training: Training):
    return lambda rows: np.zeros((1, *rows.Y.shape))


def _squares(Y: Array, predicted: Array) -> Array:
    """Squared error of every choice. Shapes (m, j), (c, m, j) to (c, j)."""
    return np.stack([((Y - p) ** 2).sum(axis=0) for p in predicted])


def _score(scheme: str, model: str, sums: tuple[Array, ...]) -> Score:
    fitted, unseen, power_c, power = sums
    curve = relative_error(unseen.sum(axis=0), power.sum(axis=0))
    best, told = 0, None
    if model in (PLSR, PAPER_FORM):
        # A_opt as in the paper: at least one component, by this validation itself.
        best = 1 + int(np.nansum(curve[1:] ** 2, axis=1).argmin())
        told = best
    rmsec = relative_error(fitted[:, best].sum(axis=0), power_c.sum(axis=0))
    by_fold = relative_error(unseen[:, best], power)
    return Score(
        scheme,
        model,
        rmsec,
        curve[best],
        np.nanmean(by_fold, axis=0),
        told,
        curve if told else None,
        unseen[:, best],
        power,
    )


def find(scores: Sequence[Score], scheme: str, model: str) -> Score | None:
    """Return one cell of the table, None where it is not there."""
    for one in scores:
        if (one.scheme, one.model) == (scheme, model):
            return one
    return None
