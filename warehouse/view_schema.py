"""Every kind of record and every column of the SQL views: type, unit, meaning.

The columns are in views.toml beside this file.
"""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError

TEXT, NUMBER, WHOLE, FLAG = pa.string(), pa.float64(), pa.int64(), pa.bool_()
TIME = pa.timestamp("us")
JOINT = pa.int32()

# The view samples has columns for at least as many joints, null where there are fewer.
DEFAULT_DOF = 6
STAGING, INDEX, SEALED = "_staging", "_index", "sealed"
# Marks of runs: separate files, so that the run itself never changes.
QUARANTINE, OPENED = "quarantine", "opened"
SAMPLES_FILE = "part-0.parquet"


@dataclass(frozen=True, slots=True)
class ViewColumn:
    """One column of a view."""

    name: str
    type: pa.DataType
    about: str
    # As text; "by row" or "by metric" where another column has it, None where it is no
    # quantity.
    unit: str | None = None

    @property
    def to_arrow_field(self) -> pa.Field:
        """The Arrow field, its unit in the metadata."""
        metadata = {"unit": self.unit} if self.unit else None
        return pa.field(self.name, self.type, metadata=metadata)


@dataclass(frozen=True, slots=True)
class SampleSignal:
    """One quantity of the samples; per joint it has the columns q1, q2, ..."""

    unit: str
    per_joint: bool
    about: str


# Signals of a log: fields of its recording.
LOGGED = ("t", "q", "qd", "qdd", "tau", "q_ref", "enabled", "masked")


def _read_columns(columns: Mapping[str, Mapping[str, str]]) -> tuple[ViewColumn, ...]:
    return tuple(
        ViewColumn(name, _TYPES[each["type"]], each["about"], each.get("unit"))
        for name, each in columns.items()
    )


_TYPES = {"text": TEXT, "number": NUMBER, "whole": WHOLE, "flag": FLAG, "time": TIME}
_TYPES |= {"joint": JOINT, "joints": pa.list_(JOINT), "texts": pa.list_(TEXT)}
_FILE = Path(__file__).with_name("views.toml")
_CONTENT = tomllib.loads(_FILE.read_text(encoding="utf-8"))
SIGNALS = {name: SampleSignal(**each) for name, each in _CONTENT["signals"].items()}
VIEWS = {name: _read_columns(each) for name, each in _CONTENT["views"].items()}
# Columns that are not stored, after those of `VIEWS`.
COMPUTED = {name: _read_columns(each) for name, each in _CONTENT["computed"].items()}
# The view of `sql --truth`; no other connection has it.
TRUTH = _read_columns(_CONTENT["truth"])


def list_sample_columns(dof: int) -> tuple[ViewColumn, ...]:
    """Return the columns of the view ``samples`` for arms of up to ``dof`` joints."""
    columns = [VIEWS["runs"][1], ViewColumn("run_id", TEXT, "the run")]
    for name, signal in SIGNALS.items():
        for channel in list_channel_names(name, dof):
            columns.append(ViewColumn(channel, NUMBER, signal.about, signal.unit))
    return tuple(columns)


def list_views() -> dict[str, tuple[ViewColumn, ...]]:
    """Return every view with its columns, ``samples`` second as the most used."""
    first = {"runs": VIEWS["runs"], "samples": list_sample_columns(DEFAULT_DOF)}
    views = {**first, **VIEWS}
    return {name: (*columns, *COMPUTED.get(name, ())) for name, columns in views.items()}


def list_channel_names(signal: str, dof: int) -> tuple[str, ...]:
    """Return the columns of one signal: ("t",), or ("q1", "q2", ...)."""
    if not SIGNALS[signal].per_joint:
        return (signal,)
    return tuple(f"{signal}{joint}" for joint in range(1, dof + 1))


def build_arrow_schema(columns: tuple[ViewColumn, ...]) -> pa.Schema:
    """Return the Arrow schema of some columns."""
    return pa.schema([column.to_arrow_field for column in columns])


def build_view_table(view: str, rows: Iterable[Mapping]) -> pa.Table:
    """Return a record's own rows of a view as a table: without its own id."""
    try:
        return pa.Table.from_pylist(list(rows), schema=build_arrow_schema(VIEWS[view][1:]))
    except (pa.ArrowException, TypeError, ValueError) as error:
        raise InputError(f"The rows do not fit the view {view}: {error}") from error


_NESTED = ("errors", "lineage", "timings")


@dataclass(frozen=True, slots=True)
class RecordKind:
    """One kind of record."""

    name: str  # its name, which is that of its view
    key: str  # column with its id
    # Views whose rows are nested in its catalogue row.
    nested_views: tuple[str, ...] = _NESTED
    # That row: columns of the view, then the nested ones.
    fields: pa.Schema = field(init=False, compare=False)
    folder: str = field(init=False)  # in the store
    row: str = field(init=False)  # the file of a record with its one catalogue row

    def __post_init__(self) -> None:
        marks = ("quarantined", "opened")
        fields = [c.to_arrow_field for c in VIEWS[self.name] if c.name not in marks]
        if self.name == "runs":
            fields.append(pa.field("signals", pa.list_(TEXT)))
        # A record's own rows of a view, without its own id.
        structs = {v: [c.to_arrow_field for c in VIEWS[v][1:]] for v in self.nested_views}
        rows = (pa.field(v, pa.list_(pa.struct(columns))) for v, columns in structs.items())
        folder = "samples" if self.name == "runs" else self.name
        row = f"_{self.key.removesuffix('_id')}.parquet"
        object.__setattr__(self, "fields", pa.schema([*fields, *rows]))
        object.__setattr__(self, "folder", folder)
        object.__setattr__(self, "row", row)


KINDS = {
    kind.name: kind
    for kind in (
        RecordKind("runs", "run_id"),
        RecordKind("models", "model_id", ("parameters", *_NESTED)),
        RecordKind("diagnoses", "diagnosis_id", ("effects", *_NESTED)),
        RecordKind("validations", "validation_id", ("alarms", *_NESTED)),
        RecordKind("campaigns", "campaign_id", ("points", "lineage")),
        RecordKind("reports", "report_id"),
        # Its id is its number, which no other writer can have.
        RecordKind("adoptions", "adoption_id", ("lineage",)),
    )
}

# Nested rows that are not part of the hash that is the record's id.
NOT_HASHED = {"lineage", "timings"}
# All folders of a store.
FOLDERS = frozenset(
    {STAGING, INDEX, SEALED, QUARANTINE, OPENED, "made_with", "robots", "_prefect"}
    | {kind.folder for kind in KINDS.values()}
)
