"""Copies of the samples of many small runs in a few files, for SQL.

Opening a file costs more than reading a small run. The runs stay where they are; the
copies lie in ``_index`` and can be deleted at any time.
"""

import json
import uuid
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from residual.errors import InputError
from warehouse.files import (
    check_file,
    parquet_options,
    read_parquet,
    replace_file,
    staged,
    sums_of,
    sync,
)
from warehouse.query.views import Held
from warehouse.runs import check_samples
from warehouse.schema import INDEX, SIGNALS

LIST = "packed.json"
# Samples in one row group: the part of a file that is read for one run.
GROUP = 65_536
# Samples in one file, so that two cores have something each.
MOST = 4_000_000


@dataclass(frozen=True, slots=True)
class Pack:
    """One file with the samples of many runs."""

    file: str  # its path
    held: Held  # signals and number of joints of its runs
    runs: frozenset[str]  # ids of its runs
    sums: Mapping  # sums of the file (``files.sums_of``)


@dataclass(frozen=True, slots=True)
class Packed:
    """What a compaction did."""

    runs: int  # how many runs are in packs now
    files: int  # how many files these are
    size: int  # their size [bytes]
    left: int  # how many runs are not, being large or damaged


def read_packs(store: Path, folders: Mapping[str, str]) -> tuple[Pack, ...]:
    """Return the packs that hold nothing but runs of the store, given by their id."""
    try:
        listed = json.loads((store / INDEX / LIST).read_bytes())
        packs = [_pack(store, name, told) for name, told in listed.items()]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return ()
    return tuple(
        pack
        for pack in packs
        if Path(pack.file).is_file() and pack.runs <= folders.keys()
    )


def write_packs(
    store: Path, groups: Mapping[Held, Sequence[str]], largest: int
) -> Packed:
    """Copy small runs into packs; those of before are replaced.

    Args:
        largest: Size of a file that still counts as small [bytes].
    """
    folder = store / INDEX
    with staged(store, "compact"):  # told at once where nothing may be written
        folder.mkdir(parents=True, exist_ok=True)
    before = {path.name for path in folder.glob("packed-*.parquet")}
    listed: dict[str, dict] = {}
    total = 0
    for held, files in groups.items():
        total += len(files)
        small = [f for f in sorted(files, key=_run_of) if _size(f) <= largest]
        tables = _readable(small)
        while made := _write_one(folder, held, tables):
            listed |= made
    # First the list, then the files that it no longer names: a reader that still has
    # one of these goes back to the runs themselves.
    replace_file(store, folder / LIST, json.dumps(listed).encode())
    for name in before:
        with suppress(OSError):
            (folder / name).unlink()
    runs = sum(len(told["runs"]) for told in listed.values())
    size = sum((folder / name).stat().st_size for name in listed)
    return Packed(runs, len(listed), size, total - runs)


def _write_one(folder: Path, held: Held, tables: Iterator[pa.Table]) -> dict | None:
    """Write one file from as many runs as fit; None where there are none left."""
    name = f"packed-{uuid.uuid4().hex[:12]}.parquet"
    draft, writer = folder / f".{name}.part", None
    runs: list[str] = []
    waiting: list[pa.Table] = []
    rows = 0
    try:
        for table in tables:
            if writer is None:
                options = parquet_options(table.schema)
                writer = pq.ParquetWriter(draft, table.schema, **options)
            runs.append(table.column("run_id")[0].as_py())
            waiting.append(table)
            rows += len(table)
            if sum(map(len, waiting)) >= GROUP:
                writer.write_table(pa.concat_tables(waiting), GROUP)
                waiting = []
            if rows >= MOST:
                break
        if writer is None:
            return None
        if waiting:
            writer.write_table(pa.concat_tables(waiting), GROUP)
        writer.close()
        sync(draft)
        draft.rename(folder / name)
    finally:
        draft.unlink(missing_ok=True)
    told = {"signals": list(held.signals), "dof": held.dof, "runs": runs}
    return {name: {**told, "sums": sums_of(folder / name)}}


def _readable(files: Sequence[str]) -> Iterator[pa.Table]:
    """Give the samples of each run with its robot and id; damaged ones are left out."""
    for file in files:
        with suppress(InputError):
            if not check_file(Path(file)):
                check_samples(Path(file).parent)
            table = read_parquet(Path(file)).replace_schema_metadata(None)
            if not len(table):
                continue
            robot = Path(file).parents[1].name.removeprefix("robot=")
            for column, value in (("run_id", _run_of(file)), ("robot", robot)):
                same = pa.array([value] * len(table), pa.string())
                table = table.add_column(0, column, same)
            yield table


def _run_of(file: str) -> str:
    return Path(file).parent.name.removeprefix("run_id=")


def _size(file: str) -> int:
    try:
        return Path(file).stat().st_size
    except OSError:
        return 1 << 62


def _pack(store: Path, name: str, told: Mapping) -> Pack:
    # Names, not paths: nothing outside of the folder is read for a pack.
    if Path(name).name != name or not set(told["signals"]) <= set(SIGNALS):
        raise ValueError(name)
    held = Held(tuple(told["signals"]), int(told["dof"]))
    sums = {key: told["sums"][key] for key in ("bytes", "blocks")}
    return Pack(str(store / INDEX / name), held, frozenset(told["runs"]), sums)
