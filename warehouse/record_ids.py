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
from warehouse.view_schema import KINDS, SEALED

Array = np.ndarray

ID_DIGITS = 20
_ID = re.compile(rf"[0-9a-f]{{1,{ID_DIGITS}}}")
_SLUG = re.compile(r"[a-z0-9_-]{1,40}")


def encode_canonical_json(value: object) -> bytes:
    """Return the one JSON text of a value, keys sorted, no blanks, UTF-8; InputError for NaN."""
    try:
        text = json.dumps(
            convert_to_json_types(value),
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


def convert_to_json_types(value: object) -> Any:
    """Return a value as the plain types that JSON knows."""
    if is_dataclass(value) and not isinstance(value, type):
        return convert_to_json_types(asdict(value))
    if isinstance(value, Mapping):
        if not all(isinstance(key, str) for key in value):
            raise InputError(f"A record has keys {list(value)}, expected texts.")
        return {key: convert_to_json_types(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [convert_to_json_types(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return convert_to_json_types(value.tolist())
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise InputError(
        f"A record holds a {type(value).__name__}, expected numbers, texts, lists and tables."
    )


def hash_values(*parts: object) -> str:
    """Return the SHA-256 of the canonical form of some values, 64 hex digits."""
    return hashlib.sha256(encode_canonical_json(list(parts))).hexdigest()


def compute_simulated_run_id(open_half: object, sealed_sha256: str | None, code_hash: str) -> str:
    """Return the id of a simulated run, known before it is simulated."""
    return hash_values(open_half, sealed_sha256, code_hash)[:ID_DIGITS]


def compute_measured_run_id(data_sha256: str, robot_sha256: str) -> str:
    """Return the id of a measured run: of its values and its robot."""
    return hash_values("imported", data_sha256, robot_sha256)[:ID_DIGITS]


def hash_arrays(arrays: Mapping[str, Array]) -> str:
    """Return the SHA-256 of named arrays as float64: names, shapes, values, 64 hex digits.

    A file's bytes would not do: they change with the version of its writer.
    """
    total = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name], dtype="<f8")
        total.update(encode_canonical_json([name, list(array.shape)]))
        total.update(array.data)
    return total.hexdigest()


def check_record_id(text: str) -> str:
    """Return an id, or its beginning, if it is safe to use in a path."""
    if not _ID.fullmatch(str(text)):
        raise NotAnIdError(
            f"'{text}' is not an id: expected up to {ID_DIGITS} hex digits, as "
            "'modelgap runs' lists them.",
            str(text),
        )
    return text


def check_robot_name(text: str) -> str:
    """Return the name of a robot if it is safe to use in a path."""
    if not _SLUG.fullmatch(str(text)):
        raise InputError(f"'{text}' is not a robot's name: expected 1 to 40 of a-z, 0-9, _ and -.")
    return text


def build_record_path(store: Path, kind: str, id: str, robot: str = "") -> Path:
    """Return the folder of a record; a run's is below its robot's."""
    spec = KINDS[check_name(kind, KINDS, "kind of record")]
    base = store / spec.folder
    if kind == "runs":
        base = base / f"robot={check_robot_name(robot)}"
    return base / f"{spec.key}={check_record_id(id)}"


def build_seal_path(store: Path, run_id: str) -> Path:
    """Return the folder of the hidden half of a run."""
    return store / SEALED / f"run_id={check_record_id(run_id)}"


SUMS = "_sums.json"


def read_local_sums(folder: Path) -> Mapping[str, Mapping]:
    """Return the sums of a record's files by name, from the list beside them."""
    try:
        return parse_check_sums(folder / SUMS, (folder / SUMS).read_bytes())
    except FileNotFoundError:
        raise
    except OSError as error:
        raise build_damage_error(folder / SUMS, error) from error


def parse_check_sums(path: Path, text: bytes) -> Mapping[str, Mapping]:
    """Return the sums in the text of a list; its names contain no path."""
    try:
        sums = json.loads(text)["files"]
        if format_check_sums(sums) == text and all(name == Path(name).name for name in sums):
            return sums
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise build_damage_error(path, "it is not the list that was written")


def format_check_sums(sums: Mapping) -> bytes:
    """Return the text of a list of sums, which ends with its own SHA-256."""
    text = json.dumps(sums, sort_keys=True, separators=(",", ":"))
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    return f'{{"files":{text},"sha256":"{sha256}"}}\n'.encode()


def build_damage_error(path: Path, reason: object) -> InputError:
    """Return the error, in one line, that names a damaged file."""
    text = " ".join(str(reason).split())
    return InputError(f"{path} is damaged ({text[:120]}). Remove its folder from the store.")
