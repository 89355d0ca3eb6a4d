"""What others rely on: options, keys of documents, columns of views, forms of exports.

`python -m tests.contract.surface` records the surface of this tree in surface.json, on
purpose; the test beside it holds every later tree against that.
"""

import inspect
import json
import re
import types
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from cyclopts import App, Argument

import modelgap as mg
from flows.cli import app
from flows.report.records import describe_query_values
from flows.steps.export import TARGETS
from residual.check.result import Fault, LogCheck
from residual.verdict.document import from_json, to_json
from residual.verdict.result import Verdict
from tests.checkout import ROOT
from warehouse.sql_guard import NAMED
from warehouse.view_schema import list_views

RECORD = Path(__file__).with_name("surface.json")
FROZEN = ROOT / "tests" / "frozen"
# Objects whose keys are names of parameters, models, variables: data, no contract.
_BY_NAME = {"parameters", "combinations", "loadings", "acceleration_error"}
_BY_NAME |= {"paper_form.levels", "least_mass_matrix"}


def surface() -> dict:
    return {
        "commands": {name: _command(name) for name in _names(app) if not _inner(name)},
        "groups": {name: _inner(name) for name in _names(app) if _inner(name)},
        "documents": {
            **{path.stem: _frozen(path) for path in sorted(FROZEN.glob("*.json"))},
            "check": sorted(_keys(_check())),
        },
        "verdict": sorted(_members(Verdict)),
        "views": {
            view: {c.name: [str(c.type), c.unit] for c in columns}
            for view, columns in list_views().items()
        },
        "named_queries": {name: sorted(describe_query_values(name)) for name in NAMED},
        "exports": sorted(TARGETS),
        "door": {name: _door(getattr(mg, name)) for name in mg.__all__},
    }


def differences(was: Any, now: Any, where: str = "") -> Iterator[str]:
    """Yield a line for each place where two surfaces differ."""
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for key in [*was, *(key for key in now if key not in was)]:
            yield from differences(was.get(key), now.get(key), f"{where}/{key}")
    elif isinstance(was, list) and isinstance(now, list) and _simple(was + now):
        yield from (f"{where}: {each} is gone" for each in was if each not in now)
        yield from (f"{where}: {each} is new" for each in now if each not in was)
    elif was != now:
        yield f"{where}: was {json.dumps(was)}, is {json.dumps(now)}"


def _simple(values: list) -> bool:
    return all(isinstance(value, str) for value in values)


def _names(of: App) -> list[str]:
    return [name for name in of if not name.startswith("-")]


def _inner(name: str) -> list[str]:
    return _names(app[name])


def _command(name: str) -> dict:
    command = app[name]
    options = command.assemble_argument_collection(parse_docstring=True)
    return {
        "group": next(group.name for group in command.group),
        "options": {one.name: _option(one) for one in options if one.show},
        "meaning": {
            one.name: " ".join((one.parameter.help or "").split()) for one in options if one.show
        },
    }


def _option(one: Argument) -> str:
    """Return an option in a line: its other names, its type, what it is without."""
    words = [" ".join([*one.names[1:], *one.negatives, _type(one.hint)])]
    if one.required:
        words.append("required")
    elif (default := one.field_info.default) is not one.field_info.empty:
        words.append(f"default {json.dumps(default)}")
    if one.index is not None:
        words.append("by place")
    if one.parameter.consume_multiple:
        words.append("takes the words that follow")
    return ", ".join(words)


def _type(hint: Any) -> str:
    """Return a type as a user thinks of it: `str | None` is a text."""
    if isinstance(hint, types.UnionType) or get_origin(hint) is Union:
        parts = [a for a in get_args(hint) if a not in (type(None), Path)]
        return " or ".join(map(_type, parts))
    if get_origin(hint) is Literal:
        return "|".join(map(str, get_args(hint)))
    if get_origin(hint) is tuple:
        return f"{_type(get_args(hint)[0])}..."
    return getattr(hint, "__name__", str(hint))


def _frozen(path: Path) -> list[str]:
    """Return the keys of a frozen document; of a verdict, as it is written today."""
    document = json.loads(path.read_text(encoding="utf-8"))
    if "verdict" in document:
        document = to_json(from_json(document))
    return sorted(_keys(document))


def _check() -> dict:
    return LogCheck((Fault("clock", (1,), True, "why", repair="line"),)).to_json()


def _keys(value: Any, where: str = "") -> set[str]:
    if isinstance(value, list):
        return set().union(*(_keys(each, f"{where}[]") for each in value), set())
    if not isinstance(value, dict):
        return set()
    if any(f".{where}".endswith(f".{name}") for name in _BY_NAME) and value:
        return set().union(*(_keys(each, f"{where}.*") for each in value.values()))
    places = {key: f"{where}.{key}" if where else key for key in value}
    inside = (_keys(value[key], place) for key, place in places.items())
    return set(places.values()).union(*inside)


def _members(record: type, where: str = "") -> set[str]:
    places = set()
    hints = get_type_hints(record)
    for each in fields(record):
        place = f"{where}.{each.name}" if where else each.name
        places.add(place)
        for inner in _records(hints[each.name]):
            places |= _members(inner, place)
    return places


def _records(hint: Any) -> Iterator[type]:
    if is_dataclass(hint):
        yield hint
    for part in get_args(hint):
        yield from _records(part)


def _door(found: Any) -> list[str]:
    """Return the arguments of a public function, or what the page shows of a class."""
    if inspect.isfunction(found):
        return [str(each) for each in _arguments(found)]
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    named = {*vars(found), *getattr(found, "__slots__", ())}
    return sorted(n for n in named if n[0] != "_" and re.search(rf"\.{n}\b", page))


def _arguments(function: Any) -> Iterator[str]:
    for each in inspect.signature(function).parameters.values():
        default = "" if each.default is each.empty else f" = {each.default!r}"
        yield f"{each.name}{default}"


if __name__ == "__main__":
    text = json.dumps(surface(), indent=1, sort_keys=True, ensure_ascii=False)
    RECORD.write_text(text + "\n", encoding="utf-8")
    print(f"wrote {RECORD}")
