"""A record with all that it was made from, as one file; what such a file may hold."""

import hashlib
import io
import json
import os
import re
import tarfile
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from residual.errors import InputError
from warehouse.commit import read_record
from warehouse.ids import ID_DIGITS
from warehouse.kinds import KINDS, SAMPLES_FILE, SEALED
from warehouse.layout import Found, find
from warehouse.objects.mirror import brought, is_there
from warehouse.origin.lineage import needed
from warehouse.origin.made_with import MADE_WITH, files_of
from warehouse.origin.robots import ROBOTS, robot_folder
from warehouse.runs import read_manifest
from warehouse.seal import SPEC, TRUTH
from warehouse.sums import SUMS
from warehouse.verify import faults, read_row

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
    """What was put into a bundle.

    Attributes:
        about: Id of the record that it is about.
        records: Its records, parents first: kind and id.
        seals: How many sealed halves are in it.
        left_out: How many sealed halves are not.
        changes: How many patches of uncommitted code are in it.
        size: Size of the file [bytes].
    """

    about: str
    records: tuple[tuple[str, str], ...]
    seals: int
    left_out: int
    changes: int
    size: int


def write_bundle(store: Path, id: str, out: Path, with_seal: bool = True) -> Bundle:
    """Write a record and its ancestors into a tar file; the same ones, the same bytes.

    Args:
        out: The file; replaced whole or not at all.
        with_seal: Whether to put in what simulated runs hide. Without it nobody can
            look at what was planted, nor run the experiment again.

    Raises:
        InputError: If there is no such record, one of them is damaged, or the name of
            the file is not usable.
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
    seals = {p for each in found for p in _seal(store, each)}
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
    if found.kind == "runs":
        told = read_manifest(store, found.id)
        yield from files_of(store, told["provenance"])
        hash = told.get("robot_hash")
    else:
        yield from files_of(store, json.loads(read_row(found)["provenance"] or "{}"))
        hash = (read_record(store, found.id).get("request") or {}).get("robot_hash")
    # A robot that is built in, or was not kept, has no folder.
    with suppress(InputError, FileNotFoundError):
        yield from _plain_files(robot_folder(store, hash or ""))


def _seal(store: Path, found: Found) -> Iterator[Path]:
    if found.kind == "runs":
        folder = store / SEALED / f"run_id={found.id}"
        yield from (_plain_files(folder) if is_there(folder) else ())


def _plain_files(folder: Path) -> list[Path]:
    """Files of a folder but for their sums: a bundle has its own."""
    brought(folder)
    return sorted(p for p in folder.iterdir() if p.is_file() and p.name != SUMS)


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
