"""Nulls of the store and of files: what chance alone showed, of one kind of logs."""

import hashlib
import json
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from residual.errors import InputError
from residual.lazy import Lazy
from residual.method.null_record import Null, from_record, to_record
from residual.robot.robot import Robot

sql = Lazy("warehouse.query.store")
layout = Lazy("warehouse.layout")

KIND = "null"  # of validations

_Number = Annotated[float, Field(allow_inf_nan=False)]
_Size = Annotated[float, Field(allow_inf_nan=False, ge=0)]


class _Key(BaseModel):
    """Of what kinds the values of a key are; what they mean is with `Key`."""

    model_config = ConfigDict(strict=True)

    robot: str
    declared: list[str]
    candidates: list[str]
    clock: bool
    cutoff: _Size
    duration: _Size
    noise: list[_Size]
    speed: list[_Size]
    moving: list[_Size]

    @model_validator(mode="after")
    def _joints(self) -> Self:
        if not len(self.noise) == len(self.speed) == len(self.moving) > 0:
            raise ValueError("noise, speed and moving are not of the same joints")
        return self


class _Record(BaseModel):
    """The same of the whole record."""

    model_config = ConfigDict(strict=True)

    key: _Key
    nats: list[_Number]
    net: list[_Number]
    named: list[bool]
    block: list[int]
    seed: int
    scale: _Size | None
    method: str = ""


def read_null(path: str) -> Null:
    """Read a null from a JSON file."""
    try:
        record = json.loads(Path(path).read_text(encoding="utf-8"))
        # Half a character can stand in JSON, and be written nowhere else.
        json.dumps(record, ensure_ascii=False).encode()
    except OSError as error:
        raise InputError(f"--null {path}: cannot be read, {error.strerror}.") from error
    except RecursionError as error:
        raise InputError(f"--null {path} is nested too deep.") from error
    except ValueError as error:
        raise InputError(
            f"--null {path} is no JSON, expected what modelgap calibrate-null --out "
            "wrote."
        ) from error
    if not isinstance(record, Mapping):
        raise InputError(f"--null {path} is no null, expected a JSON object.")
    return _checked(record, str(record.get("id") or Path(path).name))


def _checked(record: Mapping, id: str) -> Null:
    """Return the null of a record whose values are numbers where they must be."""
    try:
        return from_record(_Record.model_validate(record).model_dump(), id)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(
            f"{id} is no null: {place}: {first['msg']}. Make one with modelgap "
            "calibrate-null."
        ) from error


def null_json(null: Null) -> str:
    """Return a null as JSON text."""
    record = {"schema": 1, "kind": KIND, "id": null.id, **to_record(null)}
    return json.dumps(record, ensure_ascii=False, allow_nan=False) + "\n"


def nulls_in(store: Path) -> tuple[Null, ...]:
    """Return all nulls of a store, those with most draws and the latest first."""
    found = [_checked(record, id) for id, record in null_records(store)]
    return tuple(sorted(found, key=lambda n: -len(n.net)))


def null_records(store: Path) -> list[tuple[str, Mapping]]:
    """Return ids and records of all nulls, the latest first."""
    if not layout.list_folders(store, "validations"):
        return []
    query = (
        "SELECT validation_id AS id FROM validations "
        "WHERE kind = $kind ORDER BY created DESC"
    )
    ids = [row["id"] for row in sql.ask(store, query, kind=KIND)]
    return [(id, layout.read_record(store, id)) for id in ids]


def of_this_version(
    nulls: Sequence[Null], robot: Robot
) -> tuple[tuple[Null, ...], tuple[str, ...]]:
    """Return the nulls that this version of the method made, and what to say of others.

    What chance gives is what the search makes of it: another search, another null.

    Args:
        robot: The arm to be diagnosed; nothing is said of nulls of others.
    """
    if not nulls:
        return (), ()
    now = method_hash()
    old = [n for n in nulls if n.method != now and n.key.robot == robot.content_hash]
    good = tuple(n for n in nulls if n.method == now)
    if not old or any(n.key.robot == robot.content_hash for n in good):
        return good, ()
    other = old[0].method or "which it does not name"
    return good, (
        f"null {old[0].id} is not used: it was calibrated with another version of the "
        f"method ({other}, this is {now}); make it again with modelgap calibrate-null",
    )


@cache
def method_hash() -> str:
    """Return the hash of the code that diagnoses and judges, 16 hex digits."""
    root, total = Path(__file__).parents[2], hashlib.sha256()
    diagnosing, judging = (root / "residual").rglob, (root / "flows" / "blind").glob
    for path in sorted([*diagnosing("*.py"), *judging("*.py")]):
        total.update(path.relative_to(root).as_posix().encode())
        total.update(path.read_bytes())
    return total.hexdigest()[:16]
