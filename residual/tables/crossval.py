"""Schemes of cross-validation side by side, and the errors they give (paper, 2.5).

The paper's systematic and random schemes hold out rows whose neighbours, or whose
repetition a period later, stay in the training set: they measure memory of the path.
Runs and families held out measure what the model knows of motion that it never saw.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.recording import Array

# Checks of the blocks X and Y of a regression, before any arithmetic.

# A column that varies by less than this share of its own size is rounding, not signal.
CONSTANT = 1e-12
# Covariance below this share of the first one is rounding: nothing is left to explain.
EXHAUSTED = 1e-12


def as_block(values: Array, name: str) -> Array:
    """Return a block (n, k) as float64, finite; (n,) is one column."""
    block = np.asarray(values, dtype=float)
    block = block[:, None] if block.ndim == 1 else block
    if block.ndim != 2 or 0 in block.shape:
        raise InputError(
            f"{name} has shape {np.shape(values)}, expected (rows, columns), "
            "at least one of each."
        )
    if not np.isfinite(block).all():
        row, column = np.argwhere(~np.isfinite(block))[0]
        raise InputError(
            f"{name} is NaN or infinite in row {row}, column {column + 1}. "
            "Cut that row out or repair it."
        )
    return block


def as_rows(X: Array, names: Sequence[str], whose: str) -> Array:
    """Return rows of the variables of something that is made; whose says what."""
    X = as_block(X, "X")
    if X.shape[1] != len(names):
        raise InputError(
            f"X has {X.shape[1]} columns, {whose} {len(names)}: {', '.join(names)}. "
            "Give these, in order."
        )
    return X


def as_pair(X: Array, Y: Array) -> tuple[Array, Array]:
    """Return both blocks, checked, of equally many rows."""
    X, Y = as_block(X, "X"), as_block(Y, "Y")
    if len(X) != len(Y):
        raise InputError(
            f"X has {len(X)} rows and Y {len(Y)}: give one row of Y for each of X."
        )
    return X, Y


def as_names(names: Sequence[str] | None, count: int, letter: str) -> tuple[str, ...]:
    """Return one name per column, made up where none are given."""
    chosen = tuple(names) if names else tuple(f"{letter}{i + 1}" for i in range(count))
    if len(chosen) != count:
        raise InputError(f"{len(chosen)} names for {count} columns: give one for each.")
    return chosen


def check_varying(X: Array, names: Sequence[str], where: str = "") -> None:
    """Refuse constant columns: they carry no information and cannot be scaled.

    The message says which rows these are; all of them if `where` is empty.
    """
    spread = np.ptp(X, axis=0)
    constant = spread <= CONSTANT * np.abs(X).max(axis=0)
    if constant.any():
        told = ", ".join(
            f"{names[i]} = {X[0, i] + 0.0:g}" for i in np.flatnonzero(constant)[:9]
        )
        raise InputError(
            f"Every column must vary; constant over {where or 'all'} {len(X)} rows: "
            f"{told}. Leave these variables out, or take logs in which they move."
        )


def check_count(value: int, low: int, high: int, what: str, remedy: str) -> int:
    """Return a whole number that lies within its bounds."""
    if isinstance(value, bool) or int(value) != value or not low <= value <= high:
        raise InputError(f"{what} must be {low} to {high}, got {value}. {remedy}")
    return int(value)


def frozen(array: Array) -> Array:
    """Return the array, read-only."""
    array.setflags(write=False)
    return array


BLOCKS = 20  # paper, section 2.5.2
TRIFLE = 0.02  # of the squared error: 1 % of the error is no reason for more tables


@dataclass(frozen=True, eq=False, slots=True)
class Folds:
    """One scheme: which rows are held out together."""

    scheme: str  # name of the scheme
    of_row: Array  # fold of each row, (n,)
    names: tuple[str, ...]  # name of each fold, such as the run left out

    @property
    def count(self) -> int:
        """Number of folds."""
        return len(self.names)


@dataclass(frozen=True, eq=False, slots=True)
class HeldOut:
    """Squared errors on held-out rows, of every choice in every fold."""

    scheme: str  # name of the scheme
    miss: Array  # squared errors, summed [N^2 m^2], (choices, folds, j)
    power: Array  # squared measured torque of each fold [N^2 m^2], (folds, j)

    def pooled(self) -> Array:
        """RMSEV ||Y* - Yhat|| / ||Y*|| over all held-out rows [%]. (choices, j).

        Paper, eq. 29, with Y* the measured torque.
        """
        return relative_error(self.miss.sum(axis=1), self.power.sum(axis=0))


def relative_error(miss: Array, power: Array) -> Array:
    """Return 100 ||Y* - Yhat|| / ||Y*|| (paper, eq. 29) [%]; NaN without torque."""
    some = np.where(power > 0, power, np.nan)
    return 100 * np.sqrt(np.maximum(miss, 0) / some)


def leave_one_out(labels: Array, scheme: str = "run") -> Folds:
    """Hold out all rows of one label at a time: of one run, or of one family."""
    labels = np.asarray(labels)
    names, of_row = np.unique(labels, return_inverse=True)
    remedy = "Take more logs, or cut a long one into parts with `systematic`."
    check_count(len(names), 2, len(labels), f"number of different {scheme}s", remedy)
    return Folds(scheme, frozen(of_row.reshape(-1)), tuple(map(str, names)))


def systematic(rows: int, blocks: int = BLOCKS) -> Folds:
    """Hold out sequential blocks of rows (paper, section 2.5.2)."""
    _check_blocks(rows, blocks)
    return _in_blocks("systematic", np.arange(rows) * blocks // rows, blocks)


def systematic_repeats(
    run: Array, period: int | Mapping[object, int], blocks: int = BLOCKS
) -> Folds:
    """Hold out sequential blocks of a period in all of a run's repetitions together.

    A period has so many rows, of all runs or by run; each run gets an equal number of
    the blocks, rounded up.
    """
    run = np.asarray(run)
    _check_blocks(len(run), blocks)
    labels = np.unique(run)
    each = -(-blocks // len(labels))
    of_row = np.zeros(len(run), int)
    for i, label in enumerate(labels):
        rows = np.flatnonzero(run == label)
        length = period[label.item()] if isinstance(period, Mapping) else period
        check_count(length, each, 2**62, "rows of a period", "Ask for fewer blocks.")
        phase = np.arange(len(rows)) % length
        of_row[rows] = i * each + phase * each // length
    kept, of_row = np.unique(of_row, return_inverse=True)
    return _in_blocks("systematic, repeats together", of_row, len(kept))


def random_blocks(rows: int, rng: np.random.Generator, blocks: int = BLOCKS) -> Folds:
    """Hold out randomly drawn rows, equally many each time (paper, section 2.5.3)."""
    _check_blocks(rows, blocks)
    return _in_blocks("random", rng.permutation(rows) % blocks, blocks)


def fold_power(torque: Array, folds: Folds) -> Array:
    """Squared torque of each fold [N^2 m^2]. Shape (folds, j)."""
    torque = as_block(torque, "torque")
    check_folds(folds, len(torque))
    columns = [np.bincount(folds.of_row, t * t, folds.count) for t in torque.T]
    return np.stack(columns, axis=1)


def check_folds(folds: Folds, rows: int) -> None:
    """Refuse folds made for other rows."""
    if len(folds.of_row) != rows:
        raise InputError(
            f"The folds are of {len(folds.of_row)} rows, the data of {rows}: "
            "make the folds of the rows that are fitted."
        )


def simplest(errors: HeldOut, joint: int) -> int:
    """The first choice that is as good as the best, within one standard error.

    Choices are ordered from simple to involved. The standard error is that of the
    difference to the best over the folds: runs differ in how hard they are, which says
    nothing about the choice (Breiman et al. 1984 take that of the best itself). A
    difference under 2 % of the squared error is none.
    """
    miss = errors.miss[:, :, joint] / max(errors.power[:, joint].sum(), 1e-300)
    best = int(np.argmin(miss.sum(axis=1)))
    excess = miss - miss[best]
    folds = miss.shape[1]
    error = np.sqrt(folds) * excess.std(axis=1, ddof=1) if folds > 1 else 0.0
    allowed = np.maximum(error, TRIFLE * miss[best].sum())
    return int(np.argmax(excess.sum(axis=1) <= allowed))


def _check_blocks(rows: int, blocks: int) -> None:
    remedy = f"There are {rows} rows: take longer logs or fewer blocks."
    check_count(blocks, 2, rows, "blocks", remedy)


def _in_blocks(scheme: str, of_row: Array, blocks: int) -> Folds:
    names = tuple(f"block {i + 1}" for i in range(blocks))
    return Folds(scheme, frozen(of_row), names)
