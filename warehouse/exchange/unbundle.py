"""The records of a bundle into a store: everything checked first, nothing believed."""

import errno
import tarfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from residual.errors import InputError, ModelgapError
from residual.robot.robot import load_robot
from warehouse.exchange.bundle import (
    CONTENTS,
    LARGEST,
    LONGEST,
    MOST,
    TOTAL,
    kind_of,
    sum_of,
)
from warehouse.files import publish, replace_file, staged
from warehouse.kinds import KINDS
from warehouse.layout import Found
from warehouse.objects.mirror import at_hand, is_there
from warehouse.origin.made_with import check_kept
from warehouse.seal import open_seal
from warehouse.verify import faults

_READERS = (ValueError, KeyError, TypeError, OSError, RecursionError)
# Of the disk and not of the bundle.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_UNFOLDED = 8 << 30  # bytes that a Parquet file may unfold to


class _Form(BaseModel):
    model_config = ConfigDict(strict=True, frozen=True)


class _Record(_Form):
    kind: str
    id: str


class _Sum(_Form):
    sha256: str
    bytes: int = Field(ge=0, le=LARGEST)


class _Contents(_Form):
    """The list of contents that a bundle begins with."""

    form: Literal[1] = Field(alias="schema")
    about: str = Field(pattern=r"^[0-9a-f]{20}$")
    records: list[_Record]
    files: dict[str, _Sum] = Field(max_length=MOST)


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
        store: The store; made where there is none.

    Raises:
        InputError: If something in it is not as it should be; nothing is added then.
    """
    if not file.is_file():
        raise InputError(f"There is no file {file}. Expected what bundle --out wrote.")
    with staged(store, "bundle") as folder:
        contents = _unpack(file, folder)
        groups = _groups(contents.files)
        for path, kind in groups.items():
            _check(folder, path, kind, file)
        added, known = [], []
        for path in _in_order(groups, contents):
            new = _put(folder, store, path)
            (added if new else known).append(path)
    return Unbundled(contents.about, tuple(added), tuple(known))


def _unpack(file: Path, folder: Path) -> _Contents:
    try:
        # "r:" takes no compressed file: a small one cannot unfold to a huge one.
        with tarfile.open(file, "r:") as tar:
            members = iter(tar)
            contents = _contents(tar, next(members, None), file)
            # The first releases of Python 3.11 have no filters.
            tar.extraction_filter = getattr(tarfile, "data_filter", None)
            tar.extractall(folder, _listed(members, contents.files, file))
    except (tarfile.TarError, OSError, EOFError) as error:
        if getattr(error, "errno", None) in _NO_ROOM:
            raise
        raise InputError(
            f"{file} is no bundle: {error}. Expected what modelgap bundle writes."
        ) from error
    for name, known in contents.files.items():
        if not (folder / name).is_file():
            raise InputError(f"{file}: {_shown(name)} is missing. It was cut off.")
        if sum_of(folder / name) != known.model_dump():
            raise InputError(f"{_shown(name)} is damaged: its hash is another one.")
    return contents


def _listed(
    members: Iterator[tarfile.TarInfo], files: Mapping[str, _Sum], file: Path
) -> Iterator[tarfile.TarInfo]:
    """Give what may be unpacked: each file of the list once, and nothing else."""
    left = dict(files)
    for member in members:
        known = left.pop(member.name, None)
        if known is None or not _is_file(member, known.bytes):
            raise InputError(
                f"{file}: {_shown(member.name)} is not a plain file of the bundle's "
                "own list, or is there twice. Nothing was added."
            )
        yield member


def _contents(
    tar: tarfile.TarFile, first: tarfile.TarInfo | None, file: Path
) -> _Contents:
    """Return the list of contents, every entry of it checked."""
    what = f"{file} is no bundle"
    if first is None or first.name != CONTENTS or not _is_file(first, first.size):
        raise InputError(f"{what}: its first file is not {CONTENTS}.")
    if first.size > LONGEST:
        raise InputError(f"{what}: its list has {first.size} bytes, at most {LONGEST}.")
    try:
        contents = _Contents.model_validate_json(tar.extractfile(first).read())
    except ValidationError as error:
        wrong = error.errors()[0]
        if wrong["loc"][:1] == ("files",) and len(wrong["loc"]) > 1:
            name = _shown(wrong["loc"][1])
            raise InputError(f"{file}: {name} has no usable size or hash.") from error
        place = _shown(".".join(map(str, wrong["loc"])))
        raise InputError(f"{what}: {CONTENTS}: {place}: {wrong['msg']}.") from error
    for name in contents.files:
        if kind_of(name) is None:
            raise InputError(f"{file}: {_shown(name)} is no path of a store's file.")
    total = sum(known.bytes for known in contents.files.values())
    if total > TOTAL:
        raise InputError(f"{file} has {total} bytes, at most {TOTAL} are taken.")
    return contents


def _is_file(member: tarfile.TarInfo, size: int) -> bool:
    """Whether a member is a plain file: no folder, link, device or sparse one."""
    return member.isreg() and not member.issparse() and member.size == size


def _groups(files: Mapping) -> dict[str, str]:
    """Return the folders of a bundle, or the files that stand by themselves."""
    kinds = ((name, kind_of(name)) for name in files)
    return {n if k == "made_with" else n.rpartition("/")[0]: k for n, k in kinds}


def _check(folder: Path, path: str, kind: str, file: Path) -> None:
    """Check that something is what its name says; nothing of it is in the store yet."""
    place, name, wrong = folder / path, path.rpartition("=")[2], ()
    try:
        for each in place.glob("*.parquet"):
            _check_unfolded(each)
        if kind == "made_with":
            check_kept(place.name, place.read_bytes())
        elif kind == "robot":
            if load_robot(place).content_hash != name:
                wrong = ("it describes another robot than its name says",)
        elif kind == "seal":
            open_seal(folder, name)
        else:
            wrong = faults(Found(kind, name, place))
    # What the readers of JSON, Parquet and URDF say to a file made to break them.
    except (*_READERS, ModelgapError, pa.ArrowException) as error:
        wrong = (str(error),)
    if wrong:
        what = wrong[0].replace(f"{folder}/", "")
        raise InputError(f"{file}: {path}: {what}. Nothing was added.")


def _check_unfolded(path: Path) -> None:
    """Refuse a file that would fill the memory, before anything of it is read."""
    known = pq.read_metadata(path)
    groups = [known.row_group(i) for i in range(known.num_row_groups)]
    size = sum(group.total_byte_size for group in groups)
    if max(size, 8 * known.num_rows * max(known.num_columns, 1)) > _UNFOLDED:
        raise InputError(f"{path.name} unfolds to more than {_UNFOLDED} bytes")


def _in_order(groups: Mapping[str, str], contents: _Contents) -> list[str]:
    """Return what a record needs before it: code, robots, seals, parents."""
    place = {(e.kind, e.id): i for i, e in enumerate(contents.records)}

    def rank(path: str) -> tuple:
        kind = groups[path]
        id = path.rpartition("=")[2]
        return (kind in KINDS, place.get((kind, id), len(place)), path)

    return sorted(groups, key=rank)


def _put(folder: Path, store: Path, path: str) -> bool:
    source, target = folder / path, store / path
    if not source.is_dir():
        at_hand(target)
    if target.exists() or is_there(target):
        return False
    if source.is_dir():
        return publish(source, target)
    replace_file(store, target, source.read_bytes())
    return True


def _shown(name: str) -> str:
    """Return a path of a stranger so that it does nothing to a terminal."""
    text = name.encode("unicode_escape").decode()
    return f"'{text if len(text) <= 80 else text[:77] + '...'}'"
