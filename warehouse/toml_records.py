"""Read a TOML file into a checked record, with messages that name the valid keys."""

import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from residual.errors import InputError, check_name, check_nesting, quote_value, shorten_value

Record = TypeVar("Record")

LARGEST = 16 << 20  # bytes; more than any file written by hand
_EXPECTED = {
    "float_type": "a number",
    "int_type": "a whole number",
    "string_type": "text in quotes",
    "tuple_type": "a list",
    "model_type": "a table",
    "dataclass_type": "a table",
    "too_short": "a list that is not empty",
    "finite_number": "a finite number",
}


def read_toml(path: str | Path) -> dict[str, Any]:
    """Read a TOML file."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(LARGEST + 1)
        if len(data) > LARGEST:
            raise InputError(f"{path} is larger than {LARGEST} bytes.")
        return check_nesting(tomllib.loads(data.decode()), str(path))
    except RecursionError as error:
        raise InputError(f"{path} is nested too deep.") from error
    except OSError as error:
        raise InputError(f"Cannot read {path}: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise InputError(f"{path} is not UTF-8 text, expected TOML.") from error
    except ValueError as error:  # also a number of more digits than Python reads
        raise InputError(f"{path} is not valid TOML: {error}.") from error


def build_toml_record(
    record: type[Record], content: dict[str, Any], where: str, more_tables: Sequence[str] = ()
) -> Record:
    """Check the content of a file; `more_tables` are valid ones that are not in it."""
    try:
        return TypeAdapter(record).validate_python(content)
    except ValidationError as error:
        fault = error.errors(include_url=False)[0]
        words = _words(record, fault, more_tables)
        raise InputError(f"{where}: {words}") from error


def _words(record: Any, fault: dict[str, Any], more_tables: Sequence[str]) -> str:
    *tables, key = fault["loc"] or ("",)
    if fault["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        valid = _keys(record, tables) + ([] if tables else [*more_tables])
        return _unknown(key, valid, f"key in {_place(tables)}")
    if fault["type"] == "missing":
        return f"{_place(tables)} needs the key '{key}'."
    if fault["type"] == "literal_error" and isinstance(fault["input"], str):
        valid = fault["ctx"]["expected"].replace("' or '", "', '")
        return _unknown(fault["input"], valid.strip("'").split("', '"), str(key))
    if fault["type"] == "value_error":
        return f"{_place(fault['loc'])} {fault['ctx']['error']}."
    if fault["type"] == "tuple_type" and isinstance(fault["input"], dict):
        name = ".".join(map(str, fault["loc"]))
        return f"[{name}] is one of a list: write it as [[{name}]]."
    expected = _EXPECTED.get(fault["type"])
    if expected is None:
        text = fault["msg"].removeprefix("Input should be ")
        expected = text[:1].lower() + text[1:]
    value = quote_value(fault["input"])
    return f"{_named(fault['loc'])} is {value}, expected {expected}."


def _unknown(name: object, valid: list[str], noun: str) -> str:
    try:
        check_name(str(name), valid, noun)
    except InputError as error:
        return str(error)
    return f"{noun} '{name}' is not usable here."


def _keys(record: Any, tables: list) -> list[str]:
    """Return the valid keys of the table at a place, with lists of its tables."""
    for table in tables:
        if isinstance(table, int):
            continue
        record = _inner(record.__pydantic_fields__[table].annotation)
    keys = []
    for name, field in record.__pydantic_fields__.items():
        keys.append(field.alias or name)
        inner = getattr(field.annotation, "__pydantic_fields__", {})
        lists = [k for k, f in inner.items() if _inner(f.annotation) != f.annotation]
        keys += [f"{name}.{key}" for key in lists]
    return keys


def _inner(annotation: Any) -> Any:
    """Return the record of a field: itself, or of the elements of a list."""
    for inner in getattr(annotation, "__args__", ()):
        if hasattr(inner, "__pydantic_fields__"):
            return inner
    return annotation


def _place(tables: Sequence[str | int]) -> str:
    words = [shorten_value(t) for t in tables if not isinstance(t, int)]
    counts = [t + 1 for t in tables if isinstance(t, int)]
    if not words:
        return "the file"
    name = f"[{'.'.join(words)}]"
    return f"[{name}] {counts[0]}" if counts else name


def _named(loc: tuple[str | int, ...]) -> str:
    """Return "[trajectory] duration", also for an element of a list."""
    *tables, key = loc
    if isinstance(key, int) and tables:
        return f"{_named(tuple(tables))} (entry {key + 1})"
    name = shorten_value(key)
    return f"{_place(tables)} {name}" if tables else name
