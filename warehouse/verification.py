"""Verify a store, and compare two runs or records bit for bit.

Files are verified by their check sums, records by their ids.
"""

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, combinations
from pathlib import Path

import numpy as np
import pyarrow as pa

from residual.errors import InputError, ModelgapError
from residual.robot.robot import load_robot
from warehouse import record_ids
from warehouse.code_provenance import MADE_WITH, check_package_list
from warehouse.record_commit import compute_manifest_id
from warehouse.record_ids import SUMS
from warehouse.remote_store import fetch_file, fetch_record, list_folder_names, open_fresh_copy
from warehouse.robots import ROBOTS
from warehouse.store_catalogue import ADOPTIONS, StoredRecord, list_record_folders, open_seal
from warehouse.store_files import (
    find_damaged_record_files,
    hash_table,
    read_parquet,
    table_to_arrays,
)
from warehouse.view_schema import (
    KINDS,
    NOT_HASHED,
    OPENED,
    QUARANTINE,
    SAMPLES_FILE,
    SEALED,
    SIGNALS,
    VIEWS,
    build_arrow_schema,
)

Array = np.ndarray

GONE = object()


@dataclass(frozen=True, slots=True)
class ChannelDifference:
    """One channel of two runs, or one value of two records."""

    name: str  # its name, such as tau3
    unit: str  # its unit, "" where it has none
    equal: bool  # whether all bits are equal
    rows: int = 0  # number of compared samples
    differing: int = 0  # number of different samples
    # Time of the first different sample [s]; None for none.
    first: float | None = None
    largest: float | None = None  # largest difference, in the unit
    rms: float | None = None  # root mean square of the differences, in the unit
    note: str = ""  # a remark, such as that only one of the two has it

    @property
    def words(self) -> str:
        """Text on where and how far it differs."""
        if self.equal:
            return f"{self.name}: equal"
        parts = []
        if self.first is not None:
            parts.append(f"from {self.first:g} s on")
        if self.largest is not None:
            parts.append(f"by at most {self.largest:.3g} {self.unit}".strip())
        return f"{self.name}: differs {', '.join([*parts, *filter(None, [self.note])])}"


def compare_channels(
    before: Mapping[str, Array], after: Mapping[str, Array]
) -> tuple[ChannelDifference, ...]:
    """Compare the channels of two runs, by the times of the first."""
    time = np.asarray(before["t"], dtype=float) if "t" in before else None
    names = [n for n in SIGNALS if n in before or n in after]
    channels = []
    for name in [*names, *sorted((set(before) | set(after)) - set(SIGNALS))]:
        unit = SIGNALS[name].unit if name in SIGNALS else ""
        columns_before, columns_after = (_columns(name, side.get(name)) for side in (before, after))
        for channel in dict.fromkeys([*columns_before, *columns_after]):
            both = columns_before.get(channel), columns_after.get(channel)
            channels.append(_channel(channel, unit, *both, time))
    return tuple(channels)


def select_differing_channels(
    channels: Sequence[ChannelDifference],
) -> tuple[ChannelDifference, ...]:
    """Return the channels that differ, the earliest first."""
    late = float("inf")
    bad = [c for c in channels if not c.equal]
    return tuple(sorted(bad, key=lambda c: late if c.first is None else c.first))


def find_differing_values(
    a: object, b: object, path: str = ""
) -> Iterator[tuple[str, object, object]]:
    """Yield name and both values of each difference of two records as JSON.

    A value of only one of them is GONE in the other.
    """
    if isinstance(a, Mapping) and isinstance(b, Mapping):
        for key in dict.fromkeys([*a, *b]):
            name = f"{path}.{key}".lstrip(".")
            yield from find_differing_values(a.get(key, GONE), b.get(key, GONE), name)
    elif isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        for i, pair in enumerate(zip(a, b, strict=True)):
            yield from find_differing_values(*pair, f"{path}[{i}]")
    # -0.0 == 0.0 and 1 == 1.0, yet they are not the same record.
    elif repr(a) != repr(b):
        yield path, a, b


def compare_values(a: object, b: object) -> list[ChannelDifference]:
    """Compare two records: one entry for each value that differs."""
    out = []
    for name, *pair in find_differing_values(a, b):
        apart, note = None, f"{_short(pair[0])} and {_short(pair[1])}"
        if all(isinstance(value, int | float) for value in pair):
            apart, note = abs(float(pair[0]) - float(pair[1])), ""
        out.append(ChannelDifference(name, "", False, 1, 1, None, apart, apart, note))
    return out


def _short(value: object) -> str:
    text = "nothing" if value is GONE else repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _columns(name: str, values: Array | None) -> dict[str, Array]:
    if values is None:
        return {}
    values = np.asarray(values, dtype=float)
    if values.ndim == 1:
        return {name: values}
    return {f"{name}{k}": column for k, column in enumerate(values.T, 1)}


def _channel(
    name: str, unit: str, before: Array | None, after: Array | None, time: Array | None
) -> ChannelDifference:
    if before is None or after is None:
        owner = "second" if before is None else "first"
        return ChannelDifference(name, unit, False, note=f"only the {owner} has it")
    rows = min(len(before), len(after))
    note = "" if len(before) == len(after) else f"{len(before)} and {len(after)} samples"
    a, b = (np.ascontiguousarray(side[:rows], dtype="<f8") for side in (before, after))
    apart = a.view("<i8") != b.view("<i8")
    count = int(apart.sum())
    if count == 0:
        return ChannelDifference(name, unit, not note, rows, note=note)
    at = int(apart.argmax())
    first = float(time[at]) if time is not None and at < len(time) else None
    with np.errstate(invalid="ignore", over="ignore"):
        gap = np.abs(a - b)
    if not np.isfinite(gap).all():
        note = ", ".join(filter(None, [note, "not finite in one of them"]))
        gap = gap[np.isfinite(gap)]
    largest = float(gap.max()) if len(gap) else None
    rms = float(np.sqrt(np.mean(np.square(gap)))) if len(gap) else None
    return ChannelDifference(name, unit, False, rows, count, first, largest, rms, note)


# Errors of a row of another form.
_UNEXPECTED = (LookupError, TypeError, ValueError, AttributeError, RecursionError)


def find_record_faults(record: StoredRecord) -> tuple[str, ...]:
    """Return the faults of a record, a line each; empty for an intact record.

    Checks the SHA-256 of the files, then that the hash of the content is the id (of a
    run, that its values have the hash in its manifest).
    """
    if wrong := find_damaged_record_files(record.folder):
        return wrong
    try:
        row = read_catalogue_row(record)
        key = KINDS[record.kind].key
        if row.get(key) != record.id:
            return (f"its row says {row.get(key)}, its folder {record.id}",)
        if record.kind == ADOPTIONS:  # its id is a number and no hash
            return ()
        check = _run_fault if record.kind == "runs" else _record_fault
        fault = check(record, row)
    except InputError as error:
        return (str(error),)
    except _UNEXPECTED as error:
        return (f"{record.row.name} has another form than expected: {error}",)
    return (fault,) if fault else ()


def read_catalogue_row(record: StoredRecord) -> dict:
    """Return the full row of a record."""
    table = read_parquet(record.row)
    if len(table) != 1:
        raise InputError(f"{record.row} has {len(table)} rows, expected 1.")
    return table.to_pylist()[0]


def read_nested_tables(record: StoredRecord) -> dict[str, pa.Table]:
    """Return the rows of views nested in a record's own row, such as its errors."""
    lists = sorted(set(KINDS[record.kind].nested_views) - NOT_HASHED)
    row = read_parquet(record.row, lists).to_pylist()[0]
    schemas = {view: build_arrow_schema(VIEWS[view][1:]) for view in lists}
    return {
        view: pa.Table.from_pylist(row.get(view) or [], schema=schema)
        for view, schema in schemas.items()
    }


def list_extra_files(record: StoredRecord) -> dict[str, Path]:
    """Return the files of a record beside its row, by their names."""
    fetch_record(record.folder)
    paths = sorted(p for p in record.folder.iterdir() if p.is_file())
    return {p.name: p for p in paths if p.name not in (KINDS[record.kind].row, SUMS)}


def _run_fault(record: StoredRecord, row: Mapping) -> str | None:
    manifest = json.loads(row["manifest"])
    arrays = table_to_arrays(read_parquet(record.folder / SAMPLES_FILE))
    if record_ids.hash_arrays(arrays) != manifest["data_hash"]:
        return f"{SAMPLES_FILE}: its values are not those that were committed"
    if compute_manifest_id(manifest) != record.id:
        return f"{record.row.name}: its spec is not the one that its id is the hash of"
    return None


def _record_fault(record: StoredRecord, row: Mapping) -> str | None:
    content, lineage = json.loads(row["record"]), row["lineage"] or []
    sums = {}
    for path in list_extra_files(record).values():
        if path.suffix == ".parquet":
            sums[path.stem] = hash_table(read_parquet(path))
        else:
            sums[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    # An empty list was either not given or given as a table without rows.
    empty = {}
    for view, table in read_nested_tables(record).items():
        (sums if len(table) else empty)[view] = hash_table(table)
    sizes = range(len(empty), -1, -1)
    for names in chain.from_iterable(combinations(empty, size) for size in sizes):
        hashes = sums | {name: empty[name] for name in names}
        digest = record_ids.hash_values(record.kind, content, lineage, hashes)
        if digest[: record_ids.ID_DIGITS] == record.id:
            return None
    return f"{record.folder.name}: its content is not the one that its id is the hash of"


@dataclass(frozen=True, slots=True)
class IntegrityResult:
    """The result for one record or file of a store."""

    kind: str  # kind of record, or the folder of the store that it is in
    id: str  # its id, or the name of its file
    faults: tuple[str, ...]  # deviations from the committed record, a line each


def verify_store(store: Path) -> Iterator[IntegrityResult]:
    """Verify every record, seal, robot, list of packages and tombstone, one by one.

    Those of a bucket are fetched again, and not kept.
    """
    with open_fresh_copy(store) as place:
        intact_runs = set()
        for kind in KINDS:
            for id, folder in list_record_folders(place, kind).items():
                bad = find_record_faults(StoredRecord(kind, id, Path(folder)))
                yield IntegrityResult(kind, id, bad)
                if place != store:
                    shutil.rmtree(folder, ignore_errors=True)
                if kind == "runs" and not bad:
                    intact_runs.add(id)
        for name in list_folder_names(place, SEALED):
            id, folder = name.removeprefix("run_id="), place / SEALED / name
            # If the run is damaged or missing, only the bytes of its seal are verified.
            seal = _complaint(open_seal, place, id) if id in intact_runs else ()
            yield IntegrityResult(SEALED, id, find_damaged_record_files(folder) or seal)
        for name in list_folder_names(place, ROBOTS):
            folder = place / ROBOTS / name
            bad = find_damaged_record_files(folder) or _complaint(_check_robot, folder)
            yield IntegrityResult(ROBOTS, name, bad)
        for top in (MADE_WITH, QUARANTINE, OPENED):
            for name in list_folder_names(place, top):
                yield IntegrityResult(top, name, _complaint(_check_file, place / top / name))


def _check_robot(folder: Path) -> None:
    if load_robot(folder).content_hash != folder.name.removeprefix("sha256="):
        raise ValueError(f"{folder.name} describes another robot than its name says")


def _check_file(path: Path) -> None:
    """Check a list of packages, or that a mark is for the run in its name."""
    fetch_file(path)
    content = path.read_bytes()
    if path.parent.name == MADE_WITH:
        check_package_list(path.name, content)
    elif f"run_id={json.loads(content)['run_id']}.json" != path.name:
        raise ValueError(f"{path.name} is about another run than its name says")


def _complaint(check: Callable, *about: object) -> tuple[str, ...]:
    """Return the complaint of a check, whatever error it raises."""
    try:
        check(*about)
    except (ModelgapError, OSError, ValueError, KeyError, RecursionError) as error:
        return (" ".join(str(error).split()),)
    return ()
