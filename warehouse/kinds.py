"""The kinds of record, and the names of the folders of a store."""

from dataclasses import dataclass
from functools import cache

import pyarrow as pa

from warehouse.schema import TEXT, VIEWS, nested

STAGING, INDEX, SEALED, QUARANTINE = "_staging", "_index", "sealed", "quarantine"
SAMPLES_FILE = "part-0.parquet"


@dataclass(frozen=True, slots=True)
class Kind:
    """One kind of record.

    Attributes:
        name: Its name, which is that of its view.
        folder: Folder in the store.
        key: Column with its id.
        row: File with its one catalogue row.
        lists: Views whose rows lie nested in that row.
    """

    name: str
    folder: str
    key: str
    row: str
    lists: tuple[str, ...] = ("errors", "lineage")

    @property
    def fields(self) -> pa.Schema:
        """The catalogue row: columns of the view, then the nested ones."""
        return _fields(self)


@cache
def _fields(kind: Kind) -> pa.Schema:
    own = [c.field for c in VIEWS[kind.name] if c.name != "quarantined"]
    if kind.name == "runs":
        own.append(pa.field("signals", pa.list_(TEXT)))
    return pa.schema([*own, *(pa.field(v, nested(v)) for v in kind.lists)])


KINDS = {
    kind.name: kind
    for kind in (
        Kind("runs", "samples", "run_id", "_run.parquet"),
        Kind(
            "models",
            "models",
            "model_id",
            "_model.parquet",
            ("parameters", "errors", "lineage"),
        ),
        Kind(
            "diagnoses",
            "diagnoses",
            "diagnosis_id",
            "_diagnosis.parquet",
            ("effects", "errors", "lineage"),
        ),
        Kind(
            "validations",
            "validations",
            "validation_id",
            "_validation.parquet",
            ("errors", "alarms", "lineage", "blind"),
        ),
        Kind("reports", "reports", "report_id", "_report.parquet"),
        # Its id is its number: nobody else can have taken that.
        Kind(
            "adoptions", "adoptions", "adoption_id", "_adoption.parquet", ("lineage",)
        ),
        # Its id is made of its loop and its number, for the same reason.
        Kind(
            "decisions", "decisions", "decision_id", "_decision.parquet", ("lineage",)
        ),
    )
}

# All that a store has, by the names of its folders; nobody else writes there.
FOLDERS = frozenset(
    {STAGING, INDEX, SEALED, QUARANTINE, "made_with", "robots", "_prefect", "_watch"}
    | {kind.folder for kind in KINDS.values()}
)
