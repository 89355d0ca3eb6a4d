"""Schemes of validation, and the errors of one model under each of them.

RMSEC and RMSEV are 100 ||Y* - Yhat|| / ||Y*|| on the rows that a fold fitted and on
those that it held out (paper, eq. 29), Y* the measured torque. On measured motion a
joint has rows only where it moves (`Training.taught` says why).
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.calibration.choice import Training
from residual.calibration.methods import PAPER_FORM, PLSR, SPARSE, Method
from residual.calibration.rows import FEW, Rows
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

RUN, BLOCK, FAMILY, SYSTEMATIC = "run", "block", "family", "systematic"
REPEATS, RANDOM = "repeats", "random"
WORDS = {
    RUN: "leave one run out",
    BLOCK: "leave one block of a run out",
    FAMILY: "leave one family out",
    REPEATS: "systematic, repeats together",
    SYSTEMATIC: f"systematic {BLOCKS}",
    RANDOM: f"random {BLOCKS}",
}
_DRAWS = 2000  # of the bootstrap
# Nominal model and choices have not seen what is held out.
UNSEEN = (RUN, BLOCK, FAMILY)

# What a model leaves on all rows when it is identified without some parts. (n, j).
Response = Callable[[Collection[int]], Array]


@dataclass(frozen=True, eq=False, slots=True)
class Scheme:
    """One scheme.

    Attributes:
        name: Key of `WORDS`.
        folds: Which rows are held out together.
        left_out: Parts that the nominal model of each fold must not see.
        near: Fold that each row is too close to for being fitted when it is held out;
            None where that is no matter. Shape (n,).
    """

    name: str
    folds: Folds
    left_out: tuple[frozenset[int], ...]
    near: Array | None = None

    def fitted(self, fold: int) -> Array:
        """Rows that are fitted when a fold is held out. Shape (n,), bool."""
        kept = self.folds.of_row != fold
        return kept if self.near is None else kept & (self.near != fold)


def make_schemes(
    rows: Rows, rng: np.random.Generator
) -> tuple[tuple[Scheme, ...], tuple[str, ...]]:
    """Return the schemes that these rows allow, and why others are left out."""
    if len(rows.labels) < 2:
        raise InputError("One run: expected two or more to leave one out.")
    count, notes, out = len(rows.X), [], []
    alone = tuple(_parts(rows, [i]) for i in range(len(rows.labels)))
    out.append(Scheme(RUN, leave_one_out(rows.run), alone))
    if len(rows.labels) < FEW:
        out.append(_blocks(rows))
        notes.append(
            f"{len(rows.labels)} runs are few: blocks within them are left out too, "
            "which asks less, and the choice that is judged on an unseen run is made "
            "on blocks"
        )
    families = sorted(set(rows.families))
    if len(families) > 1 and "" not in families:
        together = tuple(
            _parts(rows, [i for i, f in enumerate(rows.families) if f == family])
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


def _parts(rows: Rows, runs: Collection[int]) -> frozenset[int]:
    return frozenset(i for i, part in enumerate(rows.parts) if part.run in runs)


def _blocks(rows: Rows) -> Scheme:
    """Leave out a block of a run at a time, and what is close to it."""
    names = [rows.labels[part.run] for part in rows.parts]
    number = [i - names.index(name) + 1 for i, name in enumerate(names)]
    labels = (f"{n}, block {i}" for n, i in zip(names, number, strict=True))
    folds = Folds(BLOCK, rows.part, tuple(labels))
    alone = tuple(frozenset([i]) for i in range(len(names)))
    return Scheme(BLOCK, folds, alone, rows.near)


def _by_rows(name: str, folds: Folds) -> Scheme:
    # A few dozen parameters from thousands of rows do not know one block of them, and
    # these schemes leave rows of the same motion in the training set anyway.
    return Scheme(name, folds, (frozenset(),) * folds.count)


@dataclass(frozen=True, slots=True)
class Interval:
    """A ratio of errors, and where it lies in 95 of 100 bootstrap draws.

    Attributes:
        value: The ratio.
        low, high: Ends of the interval.
        folds: How many runs or blocks it is from.
    """

    value: float
    low: float
    high: float
    folds: int

    def __str__(self) -> str:
        return f"{self.value:.2f} ({self.low:.2f} to {self.high:.2f})"


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
        rows: All rows; their Y is not used.
        response: What a nominal model leaves that was identified without some parts.
    """
    fitted, unseen, power_c = [], [], []
    # Rows of every run are fitted under the other schemes: no choice is made there.
    depends = rows.without is not None and scheme.name in UNSEEN
    for fold, left_out in enumerate(scheme.left_out):
        held, kept = scheme.folds.of_row == fold, scheme.fitted(fold)
        Y = response(left_out)
        told = replace(rows, Y=Y, without=None)
        training = told.rows(kept)
        if depends:
            without = _without_more(response, left_out, kept)
            training = replace(training, without=without)
        forecast, new = method(training), told.rows(held)
        fitted.append(_squares(training, forecast(training)))
        unseen.append(_squares(new, forecast(new)))
        power_c.append(training.misses(training.Y - training.tau).sum(axis=0))
    torque = rows.tau if rows.moving is None else rows.tau * rows.moving
    power = fold_power(torque, scheme.folds)
    sums = np.array(fitted), np.array(unseen), np.array(power_c), power
    return _score(scheme.name, model, sums)


def _without_more(response: Response, left_out: frozenset[int], kept: Array):
    return lambda parts: response(left_out | frozenset(parts))[kept]


def _squares(rows: Training, predicted: Array) -> Array:
    """Squared error of every choice. Shape (c, m, j) to (c, j)."""
    return np.stack([rows.misses(p).sum(axis=0) for p in predicted])


def _score(scheme: str, model: str, sums: tuple[Array, ...]) -> Score:
    fitted, unseen, power_c, power = sums
    curve = relative_error(unseen.sum(axis=0), power.sum(axis=0))
    best, told = 0, None
    if model in (PLSR, PAPER_FORM, SPARSE):
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


def ratio_interval(one: Score, other: Score, rng: np.random.Generator) -> Interval:
    """Error of one model over that of another, over all joints, with its interval.

    Both under one scheme. Folds are drawn with replacement, both models of a fold
    together: the percentile bootstrap of Efron and Tibshirani (1993, ch. 13). Blocks of
    one run are more alike than runs: an interval of blocks is of these runs only.
    """
    misses = np.stack([one.miss.sum(axis=1), other.miss.sum(axis=1)])
    folds = misses.shape[1]
    drawn = misses[:, rng.integers(folds, size=(_DRAWS, folds))].sum(axis=2)
    ratios = np.sqrt(drawn[0] / np.maximum(drawn[1], 1e-300))
    low, high = np.quantile(ratios, [0.025, 0.975])
    whole = misses.sum(axis=1)
    value = float(np.sqrt(whole[0] / max(whole[1], 1e-300)))
    return Interval(value, float(low), float(high), folds)


def find(scores: Sequence[Score], scheme: str, model: str) -> Score | None:
    """Return one cell of the table, None where it is not there."""
    for one in scores:
        if (one.scheme, one.model) == (scheme, model):
            return one
    return None
