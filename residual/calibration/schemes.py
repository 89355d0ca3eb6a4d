"""The schemes of validation side by side, each with what was left of its own model."""

from collections.abc import Callable, Collection
from dataclasses import dataclass

import numpy as np

from residual.calibration.rows import Rows
from residual.errors import InputError
from residual.recording import Array
from residual.tables.crossval import (
    BLOCKS,
    Folds,
    leave_one_out,
    random_blocks,
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
