"""The reference of commands, from what `--help` says of each."""

import inspect
import re
from collections.abc import Callable

from flows.cli.app import _COMMANDS, app

_ENTRY = re.compile(r"^    (\w+): (.*(?:\n        .*)*)", re.M)


def page() -> str:
    """Return every command with all of its options, as Markdown."""
    parts = [
        "# Commands",
        "What `modelgap COMMAND --help` prints, in one place. Exit codes: 0 done, "
        "whatever was found; 1 the run failed; 2 bad usage or input; 130 interrupted.",
    ]
    for heading, commands in _COMMANDS.items():
        parts.append(f"## {heading}")
        parts += [_command(name, app[name].default_command) for name in commands]
    return "\n\n".join(parts) + "\n"


def _command(name: str, function: Callable) -> str:
    text = inspect.getdoc(function) or ""
    about, _, arguments = text.partition("\n\nArgs:\n")
    entries = _ENTRY.findall(arguments.replace("|", "\\|"))
    told = {key: " ".join(says.split()) for key, says in entries}
    rows = [
        f"| {_shown(one)} | {told.get(one.name, '')} |"
        for one in inspect.signature(function).parameters.values()
    ]
    table = "\n".join(["| | |", "| --- | --- |", *rows]) if rows else ""
    return "\n\n".join(part for part in (f"### {name}", about, table) if part)


def _shown(parameter: inspect.Parameter) -> str:
    """A word by its place in capitals, an option with its dashes and default."""
    name = parameter.name.rstrip("_").replace("_", "-")
    if parameter.kind is not inspect.Parameter.KEYWORD_ONLY:
        more = "..." if parameter.kind is inspect.Parameter.VAR_POSITIONAL else ""
        return f"`{name.upper()}{more}`"
    plain = isinstance(parameter.default, int | float | str)
    usual = plain and not isinstance(parameter.default, bool)
    shown = f" (`{parameter.default}`)" if usual and parameter.default != "" else ""
    return f"`--{name}`{shown}"
