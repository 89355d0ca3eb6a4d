"""Checks of blocks of numbers, rows by columns, before any arithmetic."""

from collections.abc import Sequence

import numpy as np

from residual.errors import InputError
from residual.recording import Array

# A column that varies by less than this share of its own size is rounding, not signal.
CONSTANT = 1e-12


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


def as_rows(X: Array, names: Sequence[str], source: str) -> Array:
    """Return rows of the variables of something that is made; whose says what."""
    X = as_block(X, "X")
    if X.shape[1] != len(names):
        raise InputError(
            f"X has {X.shape[1]} columns, {source} {len(names)}: {', '.join(names)}. "
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
        listed = ", ".join(
            f"{names[i]} = {X[0, i] + 0.0:g}" for i in np.flatnonzero(constant)[:9]
        )
        raise InputError(
            f"Every column must vary; constant over {where or 'all'} {len(X)} rows: "
            f"{listed}. Leave these variables out, or take logs in which they move."
        )


def check_count(value: int, low: int, high: int, name: str, remedy: str) -> int:
    """Return a whole number that lies within its bounds."""
    if isinstance(value, bool) or int(value) != value or not low <= value <= high:
        raise InputError(f"{name} must be {low} to {high}, got {value}. {remedy}")
    return int(value)


def frozen(array: Array) -> Array:
    """Return the array, read-only."""
    array.setflags(write=False)
    return array
