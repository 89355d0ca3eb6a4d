"""Records of a store: two side by side, and all of them verified."""

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from flows.steps.rerun import apart, environment_apart
from residual.errors import InputError, RunError
from warehouse.compare import Channel, compare_channels, compare_values
from warehouse.layout import StoredRecord, find
from warehouse.remote import bucket_of, store_name
from warehouse.runs import read_channels, read_manifest
from warehouse.schema import INDEX
from warehouse.verify import open_to_others, read_row, verify_all

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
    channels: tuple[Channel, ...]

    @property
    def same(self) -> bool:
        """Whether all values are equal, bit for bit."""
        return all(channel.equal for channel in self.channels)


def diff(one: str, two: str, store: Path) -> Diff:
    """Compare two records of one kind."""
    found = [find(store, id) for id in (one, two)]
    if found[0].kind != found[1].kind:
        kinds = " and ".join(f"{each.id} is in {each.kind}" for each in found)
        raise InputError(f"{kinds}; expected two records of one kind.")
    both = _runs if found[0].kind == "runs" else _records
    tables, channels = both(store, *found)
    return Diff(found[0].kind, (found[0].id, found[1].id), tables, channels)


def _runs(store: Path, *found: StoredRecord) -> tuple[dict, tuple[Channel, ...]]:
    manifests = [read_manifest(store, each.id) for each in found]
    known = [each["provenance"] for each in manifests]
    spec = [
        {**(each.get("spec") or {}), "sealed": each.get("sealed_sha256")}
        for each in manifests
    ]
    rest = [{k: v for k, v in each.items() if k not in _APART} for each in manifests]
    tables = {
        "spec": _pairs(*spec),
        **_made_with(store, *known),
        "manifest": _pairs(*rest),
    }
    return tables, compare_channels(*(read_channels(store, each.id) for each in found))


def _records(store: Path, *found: StoredRecord) -> tuple[dict, tuple[Channel, ...]]:
    rows = [read_row(each) for each in found]
    known = [json.loads(row["provenance"]) for row in rows]
    records = [json.loads(row["record"]) for row in rows]
    asked = [record.pop("request", None) or {} for record in records]
    tables = {
        "request": _pairs(*asked),
        **_made_with(store, *known),
        "values": _pairs(*records),
    }
    channels = (c for c in apart(*found) if not c.name.startswith("request"))
    return tables, tuple(channels)


def _made_with(store: Path, one: Mapping, two: Mapping) -> dict:
    code = [{key: side.get(key) for key in _CODE} for side in (one, two)]
    changes = [(side.get("uncommitted") or {}).get("sha256") for side in (one, two)]
    for side, sha256 in zip(code, changes, strict=True):
        side["uncommitted"] = sha256
    packages = environment_apart(one, two, store)
    return {
        "code": _pairs(*code),
        "environment": tuple((name, *pair) for name, pair in packages.items()),
    }


def _pairs(one: Mapping, two: Mapping) -> tuple[tuple[str, object, object], ...]:
    """Return the values that differ, by their place, both as they are."""
    names = [channel.name for channel in compare_values(dict(one), dict(two))]
    return tuple((name, _at(one, name), _at(two, name)) for name in names)


def _at(record: object, name: str) -> object:
    """Return what stands at a place such as "effects[0].name"; None if nothing does."""
    for part in name.replace("[", ".[").split("."):
        if part.startswith("[") and isinstance(record, list):
            index = int(part[1:-1])
            record = record[index] if index < len(record) else None
        else:
            record = record.get(part) if isinstance(record, Mapping) else None
    return record


def verify(place: Path) -> Iterator[str]:
    """Read a store and say what is not as it was written, a line each.

    Raises:
        InputError: If there is none.
        RunError: After the last line, if something is damaged or missing.
    """
    if not place.is_dir():
        raise InputError(
            f"There is no store at {store_name(place)}. Say where: --store FOLDER."
        )
    counts: Counter = Counter()
    damaged = 0
    for each in verify_all(place):
        counts[each.kind] += 1
        damaged += bool(each.faults)
        for line in each.faults:
            yield f"DAMAGED  {each.kind} {each.id}: {line}"
    summary = ", ".join(f"{count} {kind}" for kind, count in counts.items())
    yield f"verified {summary or 'an empty store'}"
    if bucket_of(place) is None and open_to_others(place):
        yield f"note: other users of this machine may look into it: chmod 700 {place}"
    index = f", and {INDEX}" if bucket_of(place) else ""
    if damaged:
        raise RunError(
            f"{damaged} of {counts.total()} are damaged. Take their folders out of the "
            f"store{index}; what can be made again is, by the same command as before."
        )
