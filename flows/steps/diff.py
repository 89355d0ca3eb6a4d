"""Compare two records of a store, and verify all of them."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from flows.steps.rerun import compare_records, list_package_changes
from residual.errors import InputError, RunError
from warehouse.remote_store import check_store_folder, find_store_bucket
from warehouse.runs import read_channels, read_manifest
from warehouse.store_catalogue import StoredRecord, find_record
from warehouse.verification import (
    ChannelDifference,
    compare_channels,
    compare_values,
    is_readable_by_others,
    read_catalogue_row,
    verify_store,
)
from warehouse.view_schema import INDEX

_CODE = ("commit", "dirty", "code_hash", "program_hash", "lock_hash", "machine")
# What a manifest says of values and of how it was made: both stand by themselves.
_APART = ("provenance", "data_hash", "truth_hash", "timings", "spec", "robot_hash")


@dataclass(frozen=True, eq=False, slots=True)
class Diff:
    """Two records side by side."""

    kind: str
    ids: tuple[str, str]
    # Values that differ, (name, one, other), by heading: spec, code, environment and
    # more; an empty table says that nothing there differs.
    tables: Mapping[str, tuple[tuple[str, object, object], ...]]
    # Their data, equal or not; of models and others only what differs.
    channels: tuple[ChannelDifference, ...]

    @property
    def same(self) -> bool:
        """Whether all values are equal, bit for bit."""
        return all(channel.equal for channel in self.channels)


def diff_records(first: str, second: str, store: Path) -> Diff:
    """Compare two records of one kind."""
    pair = [find_record(store, id) for id in (first, second)]
    if pair[0].kind != pair[1].kind:
        kinds = " and ".join(f"{each.id} is in {each.kind}" for each in pair)
        raise InputError(f"{kinds}; expected two records of one kind.")
    both = _runs if pair[0].kind == "runs" else _records
    tables, channels = both(store, *pair)
    return Diff(pair[0].kind, (pair[0].id, pair[1].id), tables, channels)


def _runs(store: Path, *pair: StoredRecord) -> tuple[dict, tuple[ChannelDifference, ...]]:
    manifests = [read_manifest(store, each.id) for each in pair]
    provenances = [each["provenance"] for each in manifests]
    spec = [{**(each.get("spec") or {}), "sealed": each.get("sealed_sha256")} for each in manifests]
    others = [{k: v for k, v in each.items() if k not in _APART} for each in manifests]
    tables = {
        "spec": _pairs(*spec),
        **_provenance_tables(store, *provenances),
        "manifest": _pairs(*others),
    }
    return tables, compare_channels(*(read_channels(store, each.id) for each in pair))


def _records(store: Path, *pair: StoredRecord) -> tuple[dict, tuple[ChannelDifference, ...]]:
    rows = [read_catalogue_row(each) for each in pair]
    provenances = [json.loads(row["provenance"]) for row in rows]
    records = [json.loads(row["record"]) for row in rows]
    requests = [record.pop("request", None) or {} for record in records]
    tables = {
        "request": _pairs(*requests),
        **_provenance_tables(store, *provenances),
        "values": _pairs(*records),
    }
    channels = (c for c in compare_records(*pair) if not c.name.startswith("request"))
    return tables, tuple(channels)


def _provenance_tables(store: Path, first: Mapping, second: Mapping) -> dict:
    code = [{key: side.get(key) for key in _CODE} for side in (first, second)]
    changes = [(side.get("uncommitted") or {}).get("sha256") for side in (first, second)]
    for side, sha256 in zip(code, changes, strict=True):
        side["uncommitted"] = sha256
    packages = list_package_changes(first, second, store)
    return {
        "code": _pairs(*code),
        "environment": tuple((name, *pair) for name, pair in packages.items()),
    }


def _pairs(first: Mapping, second: Mapping) -> tuple[tuple[str, object, object], ...]:
    names = [channel.name for channel in compare_values(dict(first), dict(second))]
    return tuple((name, _at(first, name), _at(second, name)) for name in names)


def _at(record: object, name: str) -> object:
    """Return what stands at a place such as "effects[0].name"; None if nothing does."""
    for part in name.replace("[", ".[").split("."):
        if part.startswith("[") and isinstance(record, list):
            index = int(part[1:-1])
            record = record[index] if index < len(record) else None
        else:
            record = record.get(part) if isinstance(record, Mapping) else None
    return record


def find_damaged_files(place: Path) -> Iterator[str]:
    """Read a store and say what is not as it was written, a line each.

    Raises:
        InputError: If there is none.
        RunError: After the last line, if something is damaged or missing.
    """
    check_store_folder(place)
    counts: Counter = Counter()
    damaged = 0
    for each in verify_store(place):
        counts[each.kind] += 1
        damaged += bool(each.faults)
        for line in each.faults:
            yield f"DAMAGED  {each.kind} {each.id}: {line}"
    summary = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    yield f"verified {summary or 'an empty store'}"
    if find_store_bucket(place) is None and is_readable_by_others(place):
        yield f"note: other users of this machine may look into it: chmod 700 {place}"
    index = f", and {INDEX}" if find_store_bucket(place) else ""
    if damaged:
        raise RunError(
            f"{damaged} of {counts.total()} are damaged. Take their folders out of the "
            f"store{index}; what can be made again is, by the same command as before."
        )
