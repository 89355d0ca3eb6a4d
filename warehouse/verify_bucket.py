"""A whole store in a bucket, byte for byte, from the bucket and from no copy of it."""

from collections.abc import Iterator
from pathlib import Path

from residual.robot.robot import load_robot
from warehouse.files import staged
from warehouse.kinds import KINDS, QUARANTINE, SEALED
from warehouse.layout import Found
from warehouse.objects.compact import all_records
from warehouse.objects.listing import read_listing
from warehouse.objects.mirror import SUMS, bucket_of, names_in, object_key, sums_in
from warehouse.origin.made_with import MADE_WITH, check_kept
from warehouse.origin.robots import ROBOTS
from warehouse.seal import open_seal
from warehouse.sums import file_faults
from warehouse.verified import Verified, check_robot, check_tombstone, told
from warehouse.verify import faults


def verify_bucket(store: Path) -> Iterator[Verified]:
    """Verify every record, seal, robot, patch and tombstone of a store in a bucket.

    Each is fetched anew, and nothing of it is kept.
    """
    records = all_records(store)
    seals = set(names_in(store, SEALED))
    for kind, found in records.items():
        for id, folder in found.items():
            with staged(store, "verify") as scratch:
                yield _record(store, scratch, Found(kind, id, scratch / folder))
                if kind == "runs" and f"run_id={id}" in seals:
                    seals.remove(f"run_id={id}")
                    yield _seal(store, scratch, id)
    for name in sorted(seals):
        with staged(store, "verify") as scratch:
            yield _seal(store, scratch, name.removeprefix("run_id="))
    for name in names_in(store, ROBOTS):
        with staged(store, "verify") as scratch:
            place = _fetched(store, scratch, f"{ROBOTS}/{name}")
            wrong = file_faults(place) or told(check_robot, place, load_robot)
            yield Verified(ROBOTS, name, wrong)
    yield from _plain(store)
    yield from _listed(store, records)


def _record(store: Path, scratch: Path, found: Found) -> Verified:
    _fetched(store, scratch, found.folder.relative_to(scratch).as_posix())
    return Verified(found.kind, found.id, _faults(found))


def _faults(found: Found) -> tuple[str, ...]:
    return faults(found) if found.folder.is_dir() else ("its files are missing",)


def _seal(store: Path, scratch: Path, id: str) -> Verified:
    place = _fetched(store, scratch, f"{SEALED}/run_id={id}")
    # Of a run that is gone only the bytes of its seal can be verified.
    there = any(scratch.glob(f"samples/*/run_id={id}/{KINDS['runs'].row}"))
    opened = told(open_seal, scratch, id) if there else ()
    return Verified(SEALED, id, file_faults(place) or opened)


def _plain(store: Path) -> Iterator[Verified]:
    bucket = bucket_of(store)
    for name in names_in(store, MADE_WITH):
        content = bucket.get(f"{MADE_WITH}/{name}") or b""
        yield Verified(MADE_WITH, name, told(check_kept, name, content))
    for name in names_in(store, QUARANTINE):
        content = bucket.get(f"{QUARANTINE}/{name}") or b""
        yield Verified(QUARANTINE, name, told(check_tombstone, name, content))


def _listed(store: Path, records: dict) -> Iterator[Verified]:
    """Hold the catalogue against the records; what comes meanwhile is in both."""
    listed = read_listing(store).places
    for kind, found in listed.items():
        # One that was committed since the records were listed.
        more = set(found) - set(records[kind])
        gone = [id for id in more if not _is_there(store, found[id])]
        lost = set(records[kind]) - set(found)
        for id in sorted(gone):
            yield Verified(kind, id, ("it is listed and not in the bucket",))
        for id in sorted(lost):
            why = "it is in no catalogue: modelgap compact makes that again"
            yield Verified(kind, id, (why,))


def _is_there(store: Path, folder: str) -> bool:
    return bucket_of(store).get(f"{folder}/{SUMS}") is not None


def _fetched(store: Path, scratch: Path, folder: str) -> Path:
    """Write the files of a record as the bucket has them, whatever is in them."""
    bucket, place = bucket_of(store), scratch / folder
    place.mkdir(parents=True)
    sums = bucket.get(f"{folder}/{SUMS}")
    if sums is None:
        return place
    (place / SUMS).write_bytes(sums)
    for name, known in sums_in(place).items():
        data = bucket.get(object_key(folder, name, known["sha256"]))
        if data is not None:
            (place / Path(name).name).write_bytes(data)
    return place
