"""What an error tells a caller from Python to do, in arguments instead of options.

Messages name options of the shell. Commands that they quote ("modelgap map ...") stay.
"""

import functools
import re
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from residual.errors import ModelgapError

P, T = ParamSpec("P"), TypeVar("T")

_ARGUMENTS = {
    "--trust-log (trust_log=True)": "trust_log=True",
    "--map COLUMNS.toml": 'columns="COLUMNS.toml"',
    "--chain a,b,c": 'load_robot(..., chain=["a", "b", "c"])',
    "--map": "COLUMNS.toml (columns=...)",
    "--chain": "load_robot(..., chain=[...])",
    "--tip": "load_robot(..., tip=...)",
    "--xacro-arg": "load_robot(..., xacro_args=[...])",
    "--package-dir": "load_robot(..., package_dirs=[...])",
    "--robot": "robot",
    "--holdout": "held_out=...",
    "--baseline": "baseline=...",
    "--declared": "declared=[...]",
    "--known": "known={...}",
    "--trust-log": "trust_log=True",
    "--consistent": "consistent=True",
    "--recorded-at": "recorded_at=...",
}
_OPTION = re.compile(
    r"(?P<command>modelgap [a-z]+ [^\n]*?(?=\.\s|[.;)]*$|\n))|"
    rf"(?P<option>{'|'.join(map(re.escape, _ARGUMENTS))})(?![\w-])"
)


def name_arguments(text: str) -> str:
    """Return a message with the argument in place of each option that has one."""
    return _OPTION.sub(lambda m: m["command"] or _ARGUMENTS[m["option"]], text)


def advise_in_python(function: Callable[P, T]) -> Callable[P, T]:
    """Let the errors of a function name its arguments."""

    @functools.wraps(function)
    def call(*arguments: P.args, **options: P.kwargs) -> T:
        try:
            return function(*arguments, **options)
        except ModelgapError as error:
            error.args = (name_arguments(str(error)), *error.args[1:])
            raise

    return call
