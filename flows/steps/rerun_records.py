"""A model, diagnosis or validation once more, from its request and its ancestors.

It is made in a store of its own for the time being, in which there is nothing but what
the first one was made from: so it can depend on nothing else, and nothing is written
where the first one is.
"""

import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import pyarrow as pa

from flows.inputs.given import instead
from flows.requests import (
    Calibrate,
    Diagnose,
    Identify,
    Monitor,
    Request,
    Validate,
)
from flows.steps import calibrate, identify
from flows.steps.diagnose import diagnose_runs
from flows.steps.experiment import with_twins
from flows.steps.monitor import monitor
from flows.steps.track import KIND, Track, track
from flows.steps.validate import validate
from residual.errors import InputError
from warehouse.commit import commit_record
from warehouse.compare import Channel, compare, values_apart
from warehouse.files import read_parquet, table_hash
from warehouse.ids import ID_DIGITS
from warehouse.layout import RERUN_OF, Found, find, list_folders, needed, read_record
from warehouse.mirror import brought, is_there
from warehouse.runs import read_manifest, robot_word
from warehouse.schema import SEALED
from warehouse.verify import list_tables, other_files, read_row


@contextmanager
def again(store: Path, found: Found) -> Iterator[tuple[Path, Found]]:
    """Make a record once more.

    Yields:
        A store for the time being, and the new record in it.
    """
    request = read_record(store, found.id).get("request") or {}
    step = _STEPS.get(request.get("step"))
    if step is None:
        raise InputError(
            f"{found.id} ({found.kind}) does not say how it was made, so it cannot be "
            "made again. Records of identify, calibrate, diagnose, validate and "
            "monitor by this version do."
        )
    before = [each for each in needed(store, found.id) if each.id != found.id]
    with TemporaryDirectory(prefix="modelgap-rerun-") as folder:
        own = Path(folder).resolve()
        _link(store, own, before, _tracks(store, found))
        with instead(_robots(store, request, before)):
            verb, make = step
            make(verb.from_record(request, own))
        made = _counterpart(own, found, {each.id for each in before})
        yield own, made


def apart(found: Found, made: Found) -> tuple[Channel, ...]:
    """Return where two records of one kind differ, value by value."""
    one, two = read_row(found), read_row(made)
    out = values_apart(json.loads(one["record"]), json.loads(two["record"]), "")
    old, new = (list_tables(each) | _parquets(each) for each in (found, made))
    for name in old | new:
        out += _table_apart(name, old.get(name), new.get(name))
    old, new = _bytes(found), _bytes(made)
    out += [
        Channel(name, "", False, note="another file")
        for name in old | new
        if old.get(name) != new.get(name)
    ]
    return tuple(out)


def keep(own: Path, store: Path, old: Found, made: Found) -> str:
    """Put a record that was made again, and what was made with it, into the store.

    Returns:
        The id that the new one has in the store; the first one is its parent.
    """
    renamed: dict[str, str] = {}
    for each in needed(own, made.id):
        if is_there(store / each.folder.relative_to(own)):
            continue
        row = read_row(each)
        parents = [(p["parent"], p["role"]) for p in row["lineage"] or []]
        parents = [(renamed.get(id, id), role) for id, role in parents]
        if each.id == made.id:
            parents.append((old.id, RERUN_OF))
        text = row["record"]
        for before, after in renamed.items():
            text = text.replace(before, after)
        tables = {k: t for k, t in list_tables(each).items() if len(t)}
        tables |= _parquets(each)
        renamed[each.id] = commit_record(
            store, each.kind, json.loads(text), tables, parents, _bytes(each)
        )
    return renamed[made.id]


def _link(store: Path, own: Path, before: Sequence[Found], sealed: bool) -> None:
    """Let a store have some records of another one."""
    for each in before:
        _share(each.folder, own / each.folder.relative_to(store))
        seal = Path(SEALED) / f"run_id={each.id}"
        if sealed and is_there(store / seal):
            _share(store / seal, own / seal)


def _share(folder: Path, target: Path) -> None:
    target.mkdir(parents=True)
    brought(folder)
    for path in folder.iterdir():
        # A symbolic link would not do: SQL follows it out of the store and refuses.
        try:
            os.link(path, target / path.name)
        except OSError:
            shutil.copyfile(path, target / path.name)


def _tracks(store: Path, found: Found) -> bool:
    """Whether a record was made with the hidden half of a run: feed-forward is."""
    kind = read_record(store, found.id).get("kind") or ""
    drives = "feed_forward" in kind or kind == KIND
    return found.kind == "validations" and drives


def _counterpart(own: Path, found: Found, before: set[str]) -> Found:
    new = [id for id in list_folders(own, found.kind) if id not in before]
    if len(new) != 1:
        raise InputError(
            f"Making {found.id} again gave {len(new)} records of {found.kind}, "
            "expected 1. Its request does not fit this version of the program."
        )
    return find(own, new[0])


def _robots(store: Path, request: Mapping, before: Sequence[Found]) -> dict[str, str]:
    """Return where to load each robot from, such that it is the one that was used."""
    runs = [read_manifest(store, each.id) for each in before if each.kind == "runs"]
    known = [
        (record.get("robot"), record.get("robot_hash")) for record in (*runs, request)
    ]
    return {word: robot_word(store, word, hash) for word, hash in known if word}


def _identify(request: Identify) -> None:
    words = [*request.logs, *request.held_out]
    files = [w for w in words if len(w) < ID_DIGITS or set(w) - set("0123456789abcdef")]
    if files:
        raise InputError(
            f"It was identified from the file {files[0]}, which is not in the store. "
            "Import the log (modelgap import) and identify from the run."
        )
    identify.identify(request, identify.read_logs(request))


def _calibrate(request: Calibrate) -> None:
    logs, runs = calibrate.read_logs(request)
    if request.paper:
        runs = with_twins(logs.robot, runs)
    calibrate.calibrate(request, logs, runs)


# Of each verb its request, and what does it.
_STEPS: Mapping[str, tuple[type[Request], Callable]] = {
    "diagnose": (Diagnose, diagnose_runs),
    "identify": (Identify, _identify),
    "calibrate": (Calibrate, _calibrate),
    "validate": (Validate, validate),
    "monitor": (Monitor, monitor),
    "track": (Track, track),
}


def _parquets(found: Found) -> dict:
    paths = other_files(found).values()
    return {p.stem: read_parquet(p) for p in paths if p.suffix == ".parquet"}


def _bytes(found: Found) -> dict[str, bytes]:
    paths = other_files(found).values()
    return {p.name: p.read_bytes() for p in paths if p.suffix != ".parquet"}


def _table_apart(name: str, one: pa.Table | None, two: pa.Table | None) -> list:
    """Return where two tables differ, column by column."""
    if one is None or two is None or one.schema != two.schema or len(one) != len(two):
        hashes = [None if side is None else table_hash(side) for side in (one, two)]
        note = "another number of rows or other columns"
        same = hashes[0] == hashes[1]
        return [] if same else [Channel(name, "", False, note=note)]
    out = []
    for column, a, b in zip(one.column_names, one.columns, two.columns, strict=True):
        at, types = f"{name}.{column}", (a.type, b.type)
        if all(map(pa.types.is_floating, types)):
            sides = [c.to_numpy(zero_copy_only=False) for c in (a, b)]
            (channel,) = compare({at: sides[0]}, {at: sides[1]})
            out += [] if channel.equal else [channel]
        elif not a.equals(b):
            out.append(Channel(at, "", False, len(one), note="other values"))
    return out
