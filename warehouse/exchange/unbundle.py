"""The records of a bundle into a store: everything checked first, nothing believed."""

import hashlib
import json
import tarfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from residual.errors import InputError, ModelgapError
from residual.robot.robot import load_robot
from warehouse.exchange.form import (
    CONTENTS,
    LARGEST,
    LONGEST,
    MOST,
    SCHEMA,
    TOTAL,
    kind_of,
)
from warehouse.files import publish, read_parquet, staged, to_arrays
from warehouse.ids import data_hash
from warehouse.layout import KINDS, Found
from warehouse.origin.made_with import check_kept
from warehouse.seal import SPEC, TRUTH, sealed_hash
from warehouse.verify import faults, read_row

_BLOCK = 1 << 20
_READERS = (ValueError, KeyError, TypeError, OSError, RecursionError)
_UNFOLDED = 8 << 30  # bytes that a Parquet file may unfold to


@dataclass(frozen=True, slots=True)
class Unbundled:
    """What became of a bundle.

    Attributes:
        about: Id of the record that it is about.
        added: Folders that are new in the store.
        known: Folders that were there and were left as they are.
    """

    about: str
    added: tuple[str, ...]
    known: tuple[str, ...]


def read_bundle(file: Path, store: Path) -> Unbundled:
    """Add the records of a bundle to a store.

    Nothing is visible in the store before all of it has been checked: paths, sizes and
    hashes, and that every record is what its id says.

    Args:
        file: A file that ``bundle.write_bundle`` wrote, or somebody else did.
        store: The store; made where there is none.

    Returns:
        What was added.

    Raises:
        InputError: If something in it is not as it should be; nothing is added then.
    """
    if not file.is_file():
        raise InputError(f"There is no file {file}. Expected what bundle --out wrote.")
    with staged(store, "bundle") as folder:
        contents = _unpack(file, folder)
        groups = _groups(contents["files"])
        for path, kind in groups.items():
            _check(folder, path, kind, file)
        added, known = [], []
        for path in _in_order(groups, contents):
            new = _put(folder, store, path)
            (added if new else known).append(path)
    return Unbundled(contents["about"], tuple(added), tuple(known))


def _unpack(file: Path, folder: Path) -> dict:
    try:
        # "r:" takes no compressed file: a small one cannot unfold to a huge one.
        with tarfile.open(file, "r:") as tar:
            members = iter(tar)
            contents = _contents(tar, next(members, None), file)
            left = dict(contents["files"])
            for member in members:
                known = left.pop(member.name, None)
                if known is None or not _is_file(member, known["bytes"]):
                    raise InputError(
                        f"{file}: {_shown(member.name)} is not a plain file of the "
                        "bundle's own list, or is there twice. Nothing was added."
                    )
                _copy(tar, member, folder / member.name, known["sha256"])
    except (tarfile.TarError, OSError, EOFError) as error:
        raise InputError(
            f"{file} is no bundle: {error}. Expected what modelgap bundle writes."
        ) from error
    if left:
        raise InputError(f"{file}: {_shown(min(left))} is missing. It was cut off.")
    return contents


def _contents(tar: tarfile.TarFile, first: tarfile.TarInfo | None, file: Path) -> dict:
    """Return the list of contents, every entry of it checked."""
    what = f"{file} is no bundle"
    if first is None or first.name != CONTENTS or not _is_file(first, first.size):
        raise InputError(f"{what}: its first file is not {CONTENTS}.")
    if first.size > LONGEST:
        raise InputError(f"{what}: its list has {first.size} bytes, at most {LONGEST}.")
    try:
        contents = json.loads(tar.extractfile(first).read())
        schema = contents["schema"]
        about = [contents["about"], *(e["kind"] for e in contents["records"])]
        about += [e["id"] for e in contents["records"]]
        listed = [(n, k["sha256"], k["bytes"]) for n, k in contents["files"].items()]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{what}: {CONTENTS} has another form.") from error
    if schema != SCHEMA or not all(isinstance(text, str) for text in about):
        raise InputError(f"{what} that this version reads: it is not of schema 1.")
    _check_listed(listed, file)
    return contents


def _check_listed(listed: Sequence[tuple], file: Path) -> None:
    if len(listed) > MOST:
        raise InputError(f"{file} has {len(listed)} files, at most {MOST} are taken.")
    for name, sha256, size in listed:
        if kind_of(name) is None:
            raise InputError(f"{file}: {_shown(name)} is no path of a store's file.")
        if type(size) is not int or not 0 <= size <= LARGEST or type(sha256) is not str:
            raise InputError(f"{file}: {_shown(name)} has no usable size or hash.")
    total = sum(size for _, _, size in listed)
    if total > TOTAL:
        raise InputError(f"{file} has {total} bytes, at most {TOTAL} are taken.")


def _is_file(member: tarfile.TarInfo, size: int) -> bool:
    """Whether a member is a plain file: no folder, link, device or sparse one."""
    return member.isreg() and not member.issparse() and member.size == size


def _copy(
    tar: tarfile.TarFile, member: tarfile.TarInfo, target: Path, sha256: str
) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    total = hashlib.sha256()
    with tar.extractfile(member) as source, target.open("xb") as file:
        while block := source.read(_BLOCK):
            total.update(block)
            file.write(block)
    if total.hexdigest() != sha256:
        raise InputError(f"{_shown(member.name)} is damaged: its hash is another one.")


def _groups(files: Mapping) -> dict[str, str]:
    """Return the folders of a bundle, or the files that stand by themselves."""
    out = {}
    for name in files:
        kind = kind_of(name)
        out[name if kind == "made_with" else name.rpartition("/")[0]] = kind
    return out


def _check(folder: Path, path: str, kind: str, file: Path) -> None:
    """Check that something is what its name says; nothing of it is in the store yet."""
    try:
        for each in _parquets(folder / path):
            _check_unfolded(each)
        wrong = tuple(_wrong(folder, path, kind))
    # What the readers of JSON, Parquet and URDF say to a file made to break them.
    except (*_READERS, ModelgapError, pa.ArrowException) as error:
        wrong = (str(error),)
    if wrong:
        what = wrong[0].replace(f"{folder}/", "")
        raise InputError(f"{file}: {path}: {what}. Nothing was added.")


def _wrong(folder: Path, path: str, kind: str) -> Iterator[str]:
    place, name = folder / path, path.rpartition("=")[2]
    if kind == "made_with":
        check_kept(place.name, place.read_bytes())
    elif kind == "robot":
        if load_robot(place).content_hash != name:
            yield "it describes another robot than its name says"
    elif kind == "seal":
        yield from _wrong_seal(folder, place, name)
    else:
        yield from faults(Found(kind, name, place))


def _wrong_seal(folder: Path, place: Path, id: str) -> Iterator[str]:
    runs = list((folder / "samples").glob(f"robot=*/run_id={id}"))
    if len(runs) != 1:
        yield "a seal without its run"
        return
    manifest = json.loads(read_row(Found("runs", id, runs[0]))["manifest"])
    if (
        sealed_hash(json.loads((place / SPEC).read_bytes()))
        != manifest["sealed_sha256"]
    ):
        yield "it is not the seal that its run was made with"
    if data_hash(to_arrays(read_parquet(place / TRUTH))) != manifest["truth_hash"]:
        yield "its truth is not the one of its run"


def _parquets(place: Path) -> list[Path]:
    files = place.iterdir() if place.is_dir() else ()
    return [path for path in files if path.suffix == ".parquet"]


def _check_unfolded(path: Path) -> None:
    """Refuse a file that would fill the memory, before anything of it is read."""
    known = pq.read_metadata(path)
    groups = [known.row_group(i) for i in range(known.num_row_groups)]
    size = sum(group.total_byte_size for group in groups)
    if max(size, 8 * known.num_rows * max(known.num_columns, 1)) > _UNFOLDED:
        raise InputError(f"{path.name} unfolds to more than {_UNFOLDED} bytes")


def _in_order(groups: Mapping[str, str], contents: Mapping) -> list[str]:
    """Return what a record needs before it: code, robots, seals, parents."""
    place = {(e["kind"], e["id"]): i for i, e in enumerate(contents["records"])}

    def rank(path: str) -> tuple:
        kind = groups[path]
        id = path.rpartition("=")[2]
        return (kind in KINDS, place.get((kind, id), len(place)), path)

    return sorted(groups, key=rank)


def _put(folder: Path, store: Path, path: str) -> bool:
    source, target = folder / path, store / path
    if target.exists():
        return False
    if source.is_dir():
        return publish(source, target)
    with staged(store, "file") as own:
        # A folder is published whole; a file by itself in the same way.
        target.parent.mkdir(exist_ok=True)
        source.rename(own / source.name)
        (own / source.name).replace(target)
    return True


def _shown(name: str) -> str:
    """Return a path of a stranger so that it does nothing to a terminal."""
    text = name.encode("unicode_escape").decode()
    return f"'{text if len(text) <= 80 else text[:77] + '...'}'"
