"""Values as text and as JSON, rounded by their uncertainty; checks of arrays."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np

from residual.errors import InputError

Array = np.ndarray


MISSING = "–"
_SUPERSCRIPT = {"2": "²", "3": "³"}


def is_number(value: Any) -> TypeGuard[float]:
    """Return whether a value is a finite number."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def format_percent(value: Any) -> str:
    """Return an error that is already in per cent: 4.7 becomes '4.7 %'."""
    if not is_number(value):
        return MISSING
    return f"{format_percent_number(value)} %"


def format_percent_number(value: Any) -> str:
    """Return a percentage without its sign, for columns whose heading has it."""
    if not is_number(value):
        return MISSING
    return f"{value:.1f}" if abs(value) < 99.95 else f"{value:.0f}"


def format_fraction(value: Any) -> str:
    """Return a fraction of one as per cent: 0.04 becomes '4.0 %'."""
    return format_percent(100 * value) if is_number(value) else MISSING


def format_probability(value: Any) -> str:
    """Return a probability as per cent; never 100 %, since no data give that."""
    if not is_number(value):
        return MISSING
    if value > 0.99:
        return "> 99 %"
    return f"{100 * value:.0f} %" if value >= 0.01 else "< 1 %"


def format_number(value: Any) -> str:
    """Return a number to three significant digits, without needless zeros."""
    if not is_number(value):
        return MISSING
    if abs(value) >= 1000:
        return f"{value:.0f}" if abs(value) < 1e6 else f"{value:.2e}"
    return f"{value:.3g}"


def format_unit(unit: Any) -> str:
    """Return a unit as printed: '^2' raised, empty for a pure number."""
    if not isinstance(unit, str) or unit.strip() in ("", "-", MISSING, "1"):
        return ""
    return re.sub(r"\^([23])", lambda hit: _SUPERSCRIPT[hit[1]], unit.strip())


def convert_to_sliding_unit(unit: str) -> str:
    """Return the unit of a joint that slides for that of one that turns.

    Angles become lengths, and torques become forces: "N m s/rad" becomes "N s/m",
    "kg m^2" becomes "kg".
    """
    for turning, sliding in (("kg m^2", "kg"), ("N m", "N"), ("rad", "m")):
        unit = unit.replace(turning, sliding)
    return unit


def format_uncertain_value(value: Any, std: Any = None, unit: Any = None) -> str:
    """Return 'value ± std unit', cut at the second digit of the std.

    A std of zero, or none, gives the value alone to three digits.
    """
    if not is_number(value):
        return MISSING
    text = _with_std(value, std) if is_number(std) and std > 0 else format_number(value)
    return f"{text} {format_unit(unit)}".strip()


def _with_std(value: float, std: float) -> str:
    places = 1 - math.floor(math.log10(std))
    largest = max(abs(value), std)
    # Beyond six digits on either side plain decimals are harder to read than powers.
    if places > 6 or largest >= 1e7:
        power = math.floor(math.log10(largest))
        digits = min(max(places + power, 0), 12)
        scale = 10.0**power
        return f"({value / scale:.{digits}f} ± {std / scale:.{digits}f})e{power:+d}"
    shown = max(places, 0)
    rounded = round(value, places), round(std, places)
    return f"{rounded[0]:.{shown}f} ± {rounded[1]:.{shown}f}"


def convert_to_plain_values(value: object) -> object:
    """Return plain Python values; numbers that are not finite become None."""
    if isinstance(value, Mapping):
        return {k: convert_to_plain_values(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [convert_to_plain_values(v) for v in value]
    if isinstance(value, np.ndarray):
        return convert_to_plain_values(value.tolist())
    if isinstance(value, np.generic):
        return convert_to_plain_values(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    return value


# Relative variation of a column below which it is rounding, not signal.
CONSTANT = 1e-12


def check_block(values: Array, name: str) -> Array:
    """Return a block (n, k) as float64, finite; (n,) is one column."""
    block = np.asarray(values, dtype=float)
    block = block[:, None] if block.ndim == 1 else block
    if block.ndim != 2 or 0 in block.shape:
        raise InputError(
            f"{name} has shape {np.shape(values)}, expected (rows, columns), at least one of each."
        )
    if not np.isfinite(block).all():
        row, column = np.argwhere(~np.isfinite(block))[0]
        raise InputError(
            f"{name} is NaN or infinite in row {row}, column {column + 1}. "
            "Cut that row out or repair it."
        )
    return block


def check_rows(X: Array, names: Sequence[str], source: str) -> Array:
    """Return checked rows of the variables of a fitted object, named by `whose`."""
    X = check_block(X, "X")
    if X.shape[1] != len(names):
        raise InputError(
            f"X has {X.shape[1]} columns, {source} {len(names)}: {', '.join(names)}. "
            "Give these, in order."
        )
    return X


def check_block_pair(X: Array, Y: Array) -> tuple[Array, Array]:
    """Return both blocks, checked to have equal numbers of rows."""
    X, Y = check_block(X, "X"), check_block(Y, "Y")
    if len(X) != len(Y):
        raise InputError(f"X has {len(X)} rows and Y {len(Y)}: give one row of Y for each of X.")
    return X, Y


def check_column_names(names: Sequence[str] | None, count: int, letter: str) -> tuple[str, ...]:
    """Return one name per column, with defaults if none are given."""
    chosen = tuple(names) if names else tuple(f"{letter}{i + 1}" for i in range(count))
    if len(chosen) != count:
        raise InputError(f"{len(chosen)} names for {count} columns: give one for each.")
    return chosen


def check_varying(X: Array, names: Sequence[str], where: str = "") -> None:
    """Refuse constant columns: they carry no information and cannot be scaled.

    The message names the rows; all of them if `where` is empty.
    """
    spread = np.ptp(X, axis=0)
    constant = spread <= CONSTANT * np.abs(X).max(axis=0)
    if constant.any():
        listed = ", ".join(f"{names[i]} = {X[0, i] + 0.0:g}" for i in np.flatnonzero(constant)[:9])
        raise InputError(
            f"Every column must vary; constant over {where or 'all'} {len(X)} rows: "
            f"{listed}. Leave these variables out, or take logs in which they move."
        )


def check_count(value: int, low: int, high: int, name: str, remedy: str) -> int:
    """Return a whole number that lies within its bounds."""
    if isinstance(value, bool) or int(value) != value or not low <= value <= high:
        raise InputError(f"{name} must be {low} to {high}, got {value}. {remedy}")
    return int(value)


def make_read_only(array: Array) -> Array:
    """Return the array, read-only."""
    array.setflags(write=False)
    return array
