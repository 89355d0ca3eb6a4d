"""Errors of input and of runs, and checks of names with a hint."""

import re
from collections.abc import Iterable, Sequence
from typing import TypeVar


class ModelgapError(Exception):
    """Base class of errors that a user can fix; the command line exits with 2."""


class InputError(ModelgapError):
    """A file, value or option is not usable: expected, got, remedy."""


class RobotError(InputError):
    """The robot description is not usable."""


class RecordingError(InputError):
    """The samples of a log are not usable."""


class NotAnIdError(InputError):
    """A word is not the id of a record; ``args[1]`` is the word."""

    def __str__(self) -> str:
        return str(self.args[0])


class UnknownNameError(InputError):
    """An unknown name; the message gives the nearest known one."""


class RunError(Exception):
    """A run failed, not because of its input; exit code 1."""


# Checks of names that users type, with a hint; lists of joints.


Content = TypeVar("Content")

# Nesting of tables and lists in a file; ours have less than a third, and recursive code
# fails at some hundreds.
DEEPEST = 64
# Control characters, changes of text direction, and halves of characters.
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
LINE = 120  # characters of a value in a message


def check_name(name: str, valid: Iterable[str], kind: str) -> str:
    """Return the name if it is known.

    Args:
        kind: Kind of name, for the message: "effect".

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
    """Return a value for a message, shortened to one line."""
    text = str(value)
    return text if len(text) <= LINE else f"{text[: LINE - 3]}..."


def strip_control_characters(text: str) -> str:
    """Return foreign text that is safe for a terminal and an encoder.

    Control characters are escaped, except lines and tabs.
    """
    return CONTROL.sub(lambda match: repr(match[0])[1:-1], text)


def quote_value(value: object) -> str:
    """Return a value as Python writes it, shortened: texts in quotes, others bare."""
    try:
        return shorten_value(repr(value))
    except ValueError:  # Python cannot print a number of more than 4300 digits
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
    """Return joints, from 1, for a sentence: 'joint 2', 'joints 2, 3'."""
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


# Optional packages: their purpose, and what to do without them.
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
    """Return the error for a missing optional package."""
    package, cure = LACKING[module]
    return InputError(f"This needs {package}; it is not installed here. {cure}.")
