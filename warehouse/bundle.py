"""A record with all that it was made from as one file, to and from another machine.

What comes from elsewhere is checked before any of it is in the store: nothing is
believed.
"""

import errno
import hashlib
import io
import json
import os
import re
import tarfile
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from residual.errors import CONTROL, InputError, ModelgapError
from warehouse.commit import SPEC, TRUTH
from warehouse.files import SUMS, publish, replace_file, staged
from warehouse.ids import ID_DIGITS, seal_folder
from warehouse.layout import Found, find, needed
from warehouse.mirror import brought, ensure_local, is_there
from warehouse.provenance import MADE_WITH, check_kept, files_of
from warehouse.runs import ROBOTS, open_seal, robot_folder
from warehouse.schema import KINDS, SAMPLES_FILE, SEALED
from warehouse.verify import check_robot, faults, read_row

SCHEMA = 1
CONTENTS = "modelgap-bundle.json"
MOST = 100_000  # files
LARGEST = 2 << 30  # bytes of one file
TOTAL = 64 << 30  # bytes of all of them
LONGEST = 64 << 20  # bytes of the list of contents

_ID = rf"[0-9a-f]{{{ID_DIGITS}}}"
_HASH = "[0-9a-f]{64}"
_SLUG = "[a-z0-9_-]{1,40}"
# Of a file beside a record's row: a page, a table, a picture.
_OTHER = (
    r"[A-Za-z0-9][A-Za-z0-9_-]{0,60}\.(parquet|json|html|gif|png|csv|py|toml|urdf|txt)"
)

_DOCUMENTS = ("manifest", "record", "provenance")  # columns that hold JSON
_READERS = (ValueError, KeyError, TypeError, OSError, RecursionError)
# Of the disk and not of the bundle.
_NO_ROOM = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)
_UNFOLDED = 8 << 30  # bytes that a Parquet file may unfold to


def _forms() -> dict[str, re.Pattern]:
    rows = {name: re.escape(kind.row) for name, kind in KINDS.items()}
    forms = {
        "runs": rf"samples/robot={_SLUG}/run_id={_ID}"
        rf"/({rows['runs']}|{re.escape(SAMPLES_FILE)})",
        "seal": rf"{SEALED}/run_id={_ID}/({re.escape(SPEC)}|{re.escape(TRUTH)})",
        "made_with": rf"{MADE_WITH}/(changes-{_HASH}\.patch\.gz|packages-{_HASH}\.txt)",
        "robot": rf"{ROBOTS}/sha256={_HASH}/({_SLUG}\.urdf|robot\.toml)",
    }
    for name, kind in KINDS.items():
        if name != "runs":
            forms[name] = rf"{kind.folder}/{kind.key}={_ID}/({rows[name]}|{_OTHER})"
    return {name: re.compile(form) for name, form in forms.items()}


_FORMS = _forms()


def kind_of(name: str) -> str | None:
    """Return what a file of a bundle is: a kind of record, seal, made_with or robot.

    Returns:
        None for a path that no bundle has: absolute ones, ones with "..", and any other
        that is not, letter by letter, where the store has such a file.
    """
    return next((k for k, form in _FORMS.items() if form.fullmatch(name)), None)


def sum_of(path: Path) -> dict:
    """Return hash and size of a file, as the list of contents has them."""
    with path.open("rb") as file:
        sha256 = hashlib.file_digest(file, "sha256").hexdigest()
    return {"sha256": sha256, "bytes": path.stat().st_size}


@dataclass(frozen=True, slots=True)
class Bundle:
    """What was put into a bundle."""

    about: str  # id of the record that it is about
    records: tuple[tuple[str, str], ...]  # its records, parents first: kind and id
    seals: int  # how many sealed halves are in it
    left_out: int  # how many sealed halves are not
    changes: int  # how many patches of uncommitted code are in it
    size: int  # size of the file [bytes]


def write_bundle(store: Path, id: str, out: Path, with_seal: bool = True) -> Bundle:
    """Write a record and its ancestors into a tar file; the same ones, the same bytes.

    Args:
        out: The file; replaced whole or not at all.
        with_seal: Whether to put in what simulated runs hide. Without it nobody can
            look at what was planted, nor run the experiment again.
    """
    _check_name(out)
    about = find(store, id)
    found = needed(store, about.id)
    for each in found:
        wrong = faults(each)
        if wrong:
            raise InputError(
                f"{each.kind} {each.id} is damaged, it goes into no bundle: {wrong[0]}."
            )
    files = {p for each in found for p in _files(store, each)}
    runs = [each.id for each in found if each.kind == "runs"]
    seals = {p for id in runs for p in _plain_files(seal_folder(store, id))}
    paths = sorted(files | (seals if with_seal else set()))
    if len(paths) >= MOST:
        raise InputError(f"{about.id} needs {len(paths)} files, at most {MOST} go in.")
    sums = {p.relative_to(store).as_posix(): sum_of(p) for p in paths}
    for name, known in sums.items():
        if kind_of(name) is None or known["bytes"] > LARGEST:
            raise InputError(f"{name} ({known['bytes']} bytes) does not go in.")
    contents = {
        "schema": SCHEMA,
        "about": about.id,
        "records": [{"kind": e.kind, "id": e.id} for e in found],
        "files": sums,
    }
    _write(store, out, contents)
    count = len({p.parent for p in seals})
    ids = tuple((e.kind, e.id) for e in found)
    patches = sum(kind_of(name) == "made_with" and ".patch" in name for name in sums)
    given = (count, 0, patches) if with_seal else (0, count, patches)
    return Bundle(about.id, ids, *given, out.stat().st_size)


def _check_name(out: Path) -> None:
    if out.suffix != ".tar":
        raise InputError(f"--out {out}: expected a name that ends in .tar.")
    if out.is_dir() or not out.resolve().parent.is_dir():
        raise InputError(f"--out {out}: expected a file in a folder that is there.")


def _files(store: Path, found: Found) -> Iterator[Path]:
    yield from _plain_files(found.folder)
    row = read_row(found)
    if found.kind == "runs":
        asked = json.loads(row["manifest"])
        made_with = asked["provenance"]
    else:
        asked = (json.loads(row["record"]) or {}).get("request") or {}
        made_with = json.loads(row["provenance"] or "{}")
    yield from files_of(store, made_with)
    # A robot that is built in, or was not kept, has no folder.
    if asked.get("robot_hash"):
        with suppress(InputError):
            yield from _plain_files(robot_folder(store, asked["robot_hash"]))


def _plain_files(folder: Path) -> list[Path]:
    """Files of a folder, if there is one, but for their sums: a bundle has its own."""
    paths = folder.iterdir() if brought(folder) else ()
    return sorted(p for p in paths if p.is_file() and p.name != SUMS)


def _write(store: Path, out: Path, contents: dict) -> None:
    part = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        with tarfile.open(part, "w", format=tarfile.PAX_FORMAT) as tar:
            text = json.dumps(contents, indent=1, sort_keys=True).encode()
            tar.addfile(_member(CONTENTS, len(text)), io.BytesIO(text))
            for name, known in contents["files"].items():
                with (store / name).open("rb") as file:
                    tar.addfile(_member(name, known["bytes"]), file)
        with part.open("rb") as file:
            os.fsync(file.fileno())
        os.replace(part, out)
    finally:
        part.unlink(missing_ok=True)


def _member(name: str, size: int) -> tarfile.TarInfo:
    # No owner and no time: whoever packs the same packs the same bytes.
    member = tarfile.TarInfo(name)
    member.size, member.mode = size, 0o644
    return member


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
    """What became of a bundle."""

    about: str  # id of the record that it is about
    added: tuple[str, ...]  # folders that are new in the store
    known: tuple[str, ...]  # folders that were there and were left as they are


def read_bundle(file: Path, store: Path) -> Unbundled:
    """Add the records of a bundle to a store.

    Nothing is visible in the store before all of it has been checked: paths, sizes and
    hashes, and that every record is what its id says.

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
            check_robot(place)
        elif kind == "seal":
            open_seal(folder, name)
        else:
            found = Found(kind, name, place)
            wrong = faults(found) or _strange(read_row(found))
    # What the readers of JSON, Parquet and URDF say to a file made to break them.
    except (*_READERS, ModelgapError, pa.ArrowException) as error:
        wrong = (str(error),)
    if wrong:
        what = wrong[0].replace(f"{folder}/", "")
        raise InputError(f"{file}: {path}: {what}. Nothing was added.")


def _strange(row: Mapping) -> tuple[str, ...]:
    """Return what of a record would do something to the terminal that prints it."""
    level: list = [
        json.loads(value) if name in _DOCUMENTS and value else value
        for name, value in row.items()
    ]
    while level:
        value = level.pop()
        if isinstance(value, Mapping):
            level += [*value, *value.values()]
        elif isinstance(value, list):
            level += value
        elif isinstance(value, str) and (found := CONTROL.search(value)):
            text = _shown(value[max(found.start() - 20, 0) : found.end() + 20])
            return (f"{text} has a control character, expected text",)
    return ()


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
        ensure_local(target)
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
