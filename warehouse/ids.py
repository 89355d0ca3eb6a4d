"""Ids of records, hashes of their content and files, and the folder of each id."""

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from residual.errors import InputError, NotAnIdError, check_name
from warehouse.schema import KINDS, SEALED

Array = np.ndarray

ID_DIGITS = 20
_ID = re.compile(rf"[0-9a-f]{{1,{ID_DIGITS}}}")
_SLUG = re.compile(r"[a-z0-9_-]{1,40}")


def canonical(value: object) -> bytes:
    """Return the one JSON text of a value: keys sorted, no blanks, UTF-8.

    Raises:
        InputError: If something else is in it, or a number is not finite.
    """
    try:
        text = json.dumps(
            to_plain(value),
            sort_keys=True,
            separators=(",", ":"),
            ensure_ascii=False,
            allow_nan=False,
        )
    except ValueError as error:
        raise InputError(
            "A record holds NaN or infinity, expected finite numbers or null."
        ) from error
    return text.encode()


def to_plain(value: object) -> Any:
    """Return a value as the plain types that JSON knows."""
    if is_dataclass(value) and not isinstance(value, type):
        return to_plain(asdict(value))
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise InputError(f"A record has keys {list(value)}, expected texts.")
        return {key: to_plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [to_plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return to_plain(value.tolist())
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise InputError(
        f"A record holds a {type(value).__name__}, expected numbers, texts, lists "
        "and tables."
    )


def digest(*parts: object) -> str:
    """Return the SHA-256 of the canonical form of some values, 64 hex digits."""
    return hashlib.sha256(canonical(list(parts))).hexdigest()


def run_id(open_half: object, sealed_sha256: str | None, code_hash: str) -> str:
    """Return the id of a simulated run, known before it is simulated."""
    return digest(open_half, sealed_sha256, code_hash)[:ID_DIGITS]


def imported_id(data_sha256: str, robot_sha256: str) -> str:
    """Return the id of a measured run: of its values and its robot."""
    return digest("imported", data_sha256, robot_sha256)[:ID_DIGITS]


def data_hash(arrays: Mapping[str, Array]) -> str:
    """Return the SHA-256 of named arrays: names, shapes and values, 64 hex digits.

    A file's bytes would not do: they change with the version of its writer.

    Args:
        arrays: Numbers by name; taken as float64.
    """
    total = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name], dtype="<f8")
        total.update(canonical([name, list(array.shape)]))
        total.update(array.data)
    return total.hexdigest()


def check_id(text: str) -> str:
    """Return an id, or its beginning, if it is safe to use in a path."""
    if not _ID.fullmatch(str(text)):
        raise NotAnIdError(
            f"'{text}' is not an id: expected up to {ID_DIGITS} hex digits, as "
            "'modelgap runs' lists them.",
            str(text),
        )
    return text


def check_slug(text: str) -> str:
    """Return the name of a robot if it is safe to use in a path."""
    if not _SLUG.fullmatch(str(text)):
        raise InputError(
            f"'{text}' is not a robot's name: expected 1 to 40 of a-z, 0-9, _ and -."
        )
    return text


def record_folder(store: Path, kind: str, id: str, robot: str = "") -> Path:
    """Return the folder of a record; a run's is below its robot's."""
    spec = KINDS[check_name(kind, KINDS, "kind of record")]
    base = store / spec.folder
    if kind == "runs":
        base = base / f"robot={check_slug(robot)}"
    return base / f"{spec.key}={check_id(id)}"


def seal_folder(store: Path, run_id: str) -> Path:
    """Return the folder of the hidden half of a run."""
    return store / SEALED / f"run_id={check_id(run_id)}"


SUMS = "_sums.json"


def sums_in(folder: Path) -> Mapping[str, Mapping]:
    """Return the sums of a record's files by name, as the list beside them has them."""
    try:
        return parse_sums(folder / SUMS, (folder / SUMS).read_bytes())
    except FileNotFoundError:
        raise
    except OSError as error:
        raise damage_error(folder / SUMS, error) from error


def parse_sums(path: Path, text: bytes) -> Mapping[str, Mapping]:
    """Return the sums in the text of a list; a name in it is of no other place."""
    try:
        sums = json.loads(text)["files"]
        if sums_text(sums) == text and all(name == Path(name).name for name in sums):
            return sums
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise damage_error(path, "it is not the list that was written")


def sums_text(sums: Mapping) -> bytes:
    """Return a list of sums as its file has it: it ends with its own SHA-256."""
    text = json.dumps(sums, sort_keys=True, separators=(",", ":"))
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    return f'{{"files":{text},"sha256":"{sha256}"}}\n'.encode()


def damage_error(path: Path, reason: object) -> InputError:
    """Return the error, in one line, that names a damaged file."""
    text = " ".join(str(reason).split())
    return InputError(
        f"{path} is damaged ({text[:120]}). Take its folder out of the store."
    )
