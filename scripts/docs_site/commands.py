"""The reference of commands, from what `--help` says of each; none is loaded for it."""

import ast
import re
from importlib.util import find_spec
from inspect import cleandoc
from pathlib import Path

from flows.cli.app import _COMMANDS

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
        parts += [
            _section(name, function(place[0])) for name, place in commands.items()
        ]
    return "\n\n".join(parts) + "\n"


def function(place: str) -> ast.FunctionDef:
    """Return the source of a command, given as MODULE:FUNCTION below `flows.cli`."""
    module, _, name = place.partition(":")
    source = Path(find_spec(f"flows.cli.{module}").origin).read_text(encoding="utf-8")
    (node,) = (
        node
        for node in ast.parse(source).body
        if isinstance(node, ast.FunctionDef) and node.name == name
    )
    return node


def words(node: ast.FunctionDef) -> dict[str, str]:
    """Return every word and option of a command, by its argument, as it is shown."""
    given = [*node.args.posonlyargs, *node.args.args]
    out = {one.arg: f"`{_dashed(one.arg).upper()}`" for one in given}
    if node.args.vararg:
        out[node.args.vararg.arg] = f"`{_dashed(node.args.vararg.arg).upper()}...`"
    for one, usual in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True):
        plain = isinstance(usual, ast.Constant) and not isinstance(usual.value, bool)
        shown = plain and usual.value not in (None, "")
        default = f" (`{usual.value}`)" if shown else ""
        out[one.arg] = f"`--{_dashed(one.arg)}`{default}"
    return out


def _section(name: str, node: ast.FunctionDef) -> str:
    about, _, arguments = cleandoc(ast.get_docstring(node)).partition("\n\nArgs:\n")
    entries = _ENTRY.findall(arguments.replace("|", "\\|"))
    told = {key: " ".join(says.split()) for key, says in entries}
    rows = [f"| {shown} | {told.get(key, '')} |" for key, shown in words(node).items()]
    table = "\n".join(["| word or option | what it is |", "| --- | --- |", *rows])
    return "\n\n".join([f"### {name}", about, *([table] if rows else [])])


def _dashed(name: str) -> str:
    return name.rstrip("_").replace("_", "-")
