"""What the options of several commands have in common."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from residual.errors import InputError

# A switch without a value; there is no --no-switch.
Flag = Annotated[bool, Parameter(negative="")]
# Takes all following words up to the next option; at least one.
Words = Annotated[tuple[str, ...], Parameter(consume_multiple=(1, None), negative="")]
# One word at a time; the option may be given again.
Tags = Annotated[tuple[str, ...], Parameter(negative="")]
Log = Annotated[str, Parameter(name="LOG")]

STDOUT = "-"
# As in the files of experiments (flows/specs/experiment.py).
LONGEST, MOST_PERIODS, FASTEST, SEEDS = 600.0, 100, 20_000.0, 2**63 - 1


def check_between(option: str, value: float, low: float, high: float) -> None:
    """Refuse a number that no run ends with.

    Args:
        option: The option, as messages begin.
        value: What was given.
        low: The least that is taken.
        high: The most that is taken.

    Raises:
        InputError: If it is none of them, or no number.
    """
    if not low <= value <= high:
        raise InputError(f"{option} {value:g}: expected {low:g} to {high:g}.")


def parse_declared(text: str | None) -> tuple[str, ...] | None:
    """Return the names in "a,b", () for "none", None for no text."""
    if text is None:
        return None
    if text.strip() == "none":
        return ()
    return tuple(dict.fromkeys(name.strip() for name in text.split(",")))


def parse_numbers(option: str, text: str | None) -> tuple[int, ...] | None:
    """Return the whole numbers in "1,2,3", None for no text.

    Args:
        option: The option, as messages begin.
        text: What was given.

    Raises:
        InputError: If one is no whole number.
    """
    if text is None:
        return None
    try:
        return tuple(int(word) for word in text.split(","))
    except ValueError as error:
        raise InputError(
            f"{option} {text}: expected whole numbers, as 1,2,3."
        ) from error


def named_files(options: Mapping[str, str | None]) -> dict[str, Path]:
    """Return the files to write, by the option that names them.

    Args:
        options: What was given; "-" is standard output and no file.
    """
    return {k: Path(v) for k, v in options.items() if v not in (None, STDOUT)}


def console_beside(json: str | None) -> Console:
    """Return where people read: standard error where JSON has the output for itself.

    Args:
        json: What was given as --json.
    """
    return Console(stderr=json == STDOUT)
