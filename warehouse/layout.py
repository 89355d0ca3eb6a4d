"""Where things are in a store, and how an id is found there without any index."""

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pyarrow as pa

from residual.errors import InputError
from residual.names import check_name
from warehouse.ids import ID_DIGITS, check_id, check_slug
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
    {STAGING, INDEX, SEALED, QUARANTINE, "made_with", "robots", "_prefect"}
    | {kind.folder for kind in KINDS.values()}
)


@dataclass(frozen=True, slots=True)
class Found:
    """A record that is in the store.

    Attributes:
        kind: Name of its kind, such as "runs".
        id: Its whole id.
        folder: Its folder.
    """

    kind: str
    id: str
    folder: Path

    @property
    def row(self) -> Path:
        """The file with its catalogue row."""
        return self.folder / KINDS[self.kind].row


def record_folder(store: Path, kind: str, id: str, robot: str = "") -> Path:
    """Return the folder of a record; a run's is below its robot's.

    Raises:
        InputError: If the id or the name of the robot is not safe in a path.
    """
    known = KINDS[check_name(kind, KINDS, "kind of record")]
    base = store / known.folder
    if kind == "runs":
        base = base / f"robot={check_slug(robot)}"
    return base / f"{known.key}={check_id(id)}"


def list_folders(store: Path, kind: str) -> dict[str, str]:
    """Return the folder of every record of one kind, by id, in the order of ids."""
    known = KINDS[kind]
    base = str(store / known.folder)
    bases = [base]
    if kind == "runs":
        bases = [entry for _, entry in _entries(base, "robot=")]
    return dict(sorted(e for b in bases for e in _entries(b, f"{known.key}=")))


def find(store: Path, id: str) -> Found:
    """Find a record of any kind by its id or the beginning of it.

    Args:
        store: The store.
        id: Up to 20 hex digits.

    Returns:
        The record.

    Raises:
        InputError: If it is not an id, or none or several records begin with it.
    """
    check_id(id)
    found = []
    for kind in KINDS:
        found += [
            Found(kind, known, Path(folder))
            for known, folder in _matches(store, kind, id)
        ]
    if len(found) == 1:
        return found[0]
    if not found:
        raise InputError(f"Nothing in {store} has an id that begins with '{id}'.")
    some = ", ".join(f"{f.id} ({f.kind})" for f in found[:4])
    more = f" and {len(found) - 4} more" if len(found) > 4 else ""
    raise InputError(f"'{id}' is the beginning of {some}{more}. Give more digits.")


def find_run(store: Path, id: str) -> Found:
    """Find a run by its id or the beginning of it.

    Raises:
        InputError: If there is no such run.
    """
    found = find(store, id)
    if found.kind != "runs":
        raise InputError(f"{found.id} is in {found.kind}, expected the id of a run.")
    return found


def _matches(store: Path, kind: str, id: str) -> list[tuple[str, str]]:
    if len(id) < ID_DIGITS:
        return [e for e in list_folders(store, kind).items() if e[0].startswith(id)]
    # A whole id needs no listing: its path is known but for the robot.
    known = KINDS[kind]
    bases = [str(store / known.folder)]
    if kind == "runs":
        bases = [entry for _, entry in _entries(bases[0], "robot=")]
    paths = [os.path.join(base, f"{known.key}={id}") for base in bases]
    return [(id, path) for path in paths if os.path.isdir(path)]


def _entries(folder: str, prefix: str) -> list[tuple[str, str]]:
    """What follows the prefix, and the path, of every such entry of a folder."""
    try:
        with os.scandir(folder) as entries:
            return [
                (entry.name[len(prefix) :], entry.path)
                for entry in entries
                if entry.name.startswith(prefix)
            ]
    except FileNotFoundError:
        return []
