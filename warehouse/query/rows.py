"""The catalogue of a store at one moment, and rows that are read from its records."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError
from warehouse.files import read_parquet
from warehouse.kinds import Kind
from warehouse.runs import about_origin


@dataclass(frozen=True, eq=False, slots=True)
class Catalogue:
    """All records of a store at one moment.

    Attributes:
        folders: Folder of every record, by kind and id.
        rows: Catalogue rows by kind, oldest first.
        damaged: Messages about records whose row cannot be read, by kind; these are
            left out.
    """

    folders: Mapping[str, Mapping[str, str]]
    rows: Mapping[str, pa.Table]
    damaged: Mapping[str, Sequence[str]]


def read_new(
    ids: Sequence[str], kind: Kind, folders: Mapping[str, str]
) -> tuple[list[pa.Table], list[str]]:
    """Return rows that are read from the records, and what is damaged of them.

    Args:
        folders: Their folders, by id.
    """
    new, damaged = [], []
    for id in ids:
        try:
            new.append(_read_row(Path(folders[id]) / kind.row, kind))
        except InputError as error:
            damaged.append(str(error))
    return new, damaged


def _read_row(path: Path, kind: Kind) -> pa.Table:
    """Read one catalogue row; columns of another version are left out or null."""
    table = (
        _with_origin(read_parquet(path))
        if kind.name == "runs"
        else (read_parquet(path))
    )
    columns = [
        table.column(field.name).cast(field.type)
        if field.name in table.column_names
        else pa.nulls(len(table), field.type)
        for field in kind.fields
    ]
    return pa.table(columns, schema=kind.fields)


def _with_origin(table: pa.Table) -> pa.Table:
    """Add what rows of an earlier version say of the code in their manifest alone."""
    if "commit" in table.column_names or "manifest" not in table.column_names:
        return table
    made = [about_origin(json.loads(m)) for m in table.column("manifest").to_pylist()]
    for name in made[0] if made else ():
        table = table.append_column(
            name, pa.array([m[name] for m in made], pa.string())
        )
    return table
