"""What can go wrong with input and in runs, in words that help; names, with a hint."""

import re
from collections.abc import Iterable, Sequence
from typing import TypeVar


class ModelgapError(Exception):
    """Root of the errors that a user can mend; the command line exits with 2."""


class InputError(ModelgapError):
    """A file, value or option is not usable: expected this, got that, do so."""


class RobotError(InputError):
    """The robot description is not usable."""


class RecordingError(InputError):
    """The samples of a log are not usable."""


class NotAnIdError(InputError):
    """A word is not the id of a record; ``args[1]`` is the word."""

    def __str__(self) -> str:
        return str(self.args[0])


class UnknownNameError(InputError):
    """A name is not known; the message gives the nearest one that is."""


class RunError(Exception):
    """A run did not come to its end, through no fault of its input; exit code 1."""


# Names that users type, checked with a hint, and joints as they are listed.


Content = TypeVar("Content")

# Levels of tables and lists in a file; none of ours has a third of it, and what walks
# through them by calling itself ends at some hundreds.
DEEPEST = 64
# What steers a terminal, turns the order of what is read, or is half a character.
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
LINE = 120  # characters of a value in a message


def check_name(name: str, valid: Iterable[str], kind: str) -> str:
    """Return the name if it is known.

    Args:
        kind: What the name stands for, as the message begins: "effect".

    Raises:
        UnknownNameError: If it is not one of them; the message has the nearest.
    """
    valid = sorted(valid)
    if name in valid:
        return name
    from difflib import get_close_matches  # for `modelgap --help` a slow import

    shown = shorten_value(name)
    near = get_close_matches(str(name).lower(), valid, n=1, cutoff=0.5)
    hint = f"did you mean '{near[0]}'? " if near else ""
    raise UnknownNameError(f"Unknown {kind} '{shown}': {hint}Valid: {', '.join(valid) or 'none'}.")


def shorten_value(value: object) -> str:
    """Return a value as a message has it: a line of it says enough."""
    text = str(value)
    return text if len(text) <= LINE else f"{text[: LINE - 3]}..."


def strip_control_characters(text: str) -> str:
    """Return a stranger's text so that it does nothing to a terminal or an encoder.

    What steers a terminal stands as its escape; lines and tabs stay.
    """
    return CONTROL.sub(lambda match: repr(match[0])[1:-1], text)


def quote_value(value: object) -> str:
    """Return a value as Python writes it, shortened: texts in quotes, others bare."""
    try:
        return shorten_value(repr(value))
    except ValueError:  # Python writes no number of more than 4300 digits
        return "a number of thousands of digits"


def check_keys(table: Iterable[str], valid: Iterable[str], where: str) -> None:
    """Check every key of one table of a TOML file."""
    valid = tuple(valid)
    for key in table:
        check_name(key, valid, f"key in {where}")


def join_with_commas(values: Iterable, format_spec: str = "") -> str:
    """Return values as a list: '1, 2, 5'."""
    return ", ".join(format(value, format_spec) for value in values)


def format_joint_numbers(numbers: Sequence[int]) -> str:
    """Return joints, from 1, as a sentence has them: 'joint 2', 'joints 2, 3'."""
    return f"joint{'s' if len(numbers) > 1 else ''} {join_with_commas(numbers)}"


def check_nesting(content: Content, where: str) -> Content:
    """Return the content of a TOML or JSON file if it is not nested too deep."""
    level: list = [content]
    for _ in range(DEEPEST + 1):
        inside = (part for part in level if isinstance(part, dict | list))
        level = [
            item
            for part in inside
            for item in (part.values() if isinstance(part, dict) else part)
            if isinstance(item, dict | list)
        ]
        if not level:
            return content
    raise InputError(f"{where} is nested too deep, expected up to {DEEPEST} levels.")


# Packages that not every machine has: what each is, and what to do without it.
LACKING = {
    "pybullet": (
        "PyBullet, the engine of simulated arms, which is there for Python 3.11 on Linux (x86_64)",
        "Simulate with such a Python; logs are diagnosed without",
    ),
    "prefect": (
        "Prefect, the scheduler, which is there for Python 3.11 to 3.13 on Linux and macOS",
        "Schedule with such a Python; logs are diagnosed without",
    ),
    "xacrodoc": (
        "xacrodoc, which expands a xacro",
        "Install the extra: pip install '.[xacro]' in the checkout",
    ),
    "mujoco": (
        "MuJoCo, whose compiler reads an MJCF",
        "Install the extra: pip install '.[mjcf]' in the checkout",
    ),
    "fcntl": ("locks of files as Linux and macOS have them", "Use one of these"),
    "pinocchio": (
        "Pinocchio, the dynamics of arms, which pip has for Linux and macOS and "
        "conda-forge for Windows too",
        "Install it: pip install pin, or conda install -c conda-forge pinocchio",
    ),
}


def build_missing_package_error(module: str) -> InputError:
    """Return the error for a package that not every machine has."""
    package, cure = LACKING[module]
    return InputError(f"This needs {package}; it is not installed here. {cure}.")
