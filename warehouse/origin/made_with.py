"""What records were made with, kept once for all of them: uncommitted code, packages.

The files are named by the hash of what is in them, which the records give:
``made_with/changes-<sha256>.patch.gz`` and ``made_with/packages-<sha256>.txt``.
"""

import gzip
import hashlib
import zlib
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from residual.errors import InputError
from warehouse.files import replace_file
from warehouse.objects.mirror import at_hand
from warehouse.origin.changes import LARGEST, uncommitted
from warehouse.origin.provenance import packages, provenance

MADE_WITH = "made_with"


def keep_made_with(store: Path) -> None:
    """Put into the store what this process makes records with; costs two looks."""
    for name, content in _own().items():
        target = store / MADE_WITH / name
        if not target.is_file():
            replace_file(store, target, content)


def files_of(store: Path, known: Mapping | None) -> list[Path]:
    """Return the kept files that a record's provenance names, those that are there."""
    changes = ((known or {}).get("uncommitted") or {}).get("sha256")
    names = [
        name
        for hash, name in (
            (changes, _patch(changes)),
            ((known or {}).get("environment_hash"), _list(known)),
        )
        if hash
    ]
    paths = [store / MADE_WITH / name for name in names]
    for path in paths:
        at_hand(path)
    return [path for path in paths if path.is_file()]


def read_packages(store: Path, known: Mapping | None) -> dict[str, str] | None:
    """Return versions by package; None where they were not kept."""
    path = store / MADE_WITH / _list(known)
    at_hand(path)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    if hashlib.sha256(text.encode()).hexdigest() != (known or {})["environment_hash"]:
        return None
    return dict(line.split("==", 1) for line in text.splitlines() if "==" in line)


def check_kept(name: str, content: bytes) -> None:
    """Check that a file is what its name says.

    Raises:
        InputError: If it is not, or is larger than this program keeps.
    """
    hash = name.split("-", 1)[1].split(".", 1)[0]
    if name.endswith(".gz"):
        content = _unzipped(name, content)
    if hashlib.sha256(content).hexdigest() != hash:
        raise InputError(f"{name} is damaged: its content has another hash.")


def about_changes(store: Path, known: Mapping | None) -> str:
    """Say which uncommitted change a record was made with, in one line."""
    known = known or {}
    changes, commit = known.get("uncommitted"), (known.get("commit") or "")[:12]
    if changes is None:
        return "uncommitted changes: unknown, the code was no git checkout"
    if not changes["sha256"]:
        return f"uncommitted changes: none, the code was that of commit {commit}"
    some = ", ".join(changes["files"][:4])
    more = changes["count"] - len(changes["files"][:4])
    told = f"{some} and {more} more" if more > 0 else some
    place = store / MADE_WITH / _patch(changes["sha256"])
    at_hand(place)
    if not changes["kept"]:
        where = f"{changes['bytes']} bytes, too large to be kept"
    else:
        kept = f"{MADE_WITH}/{place.name}"
        where = kept if place.is_file() else f"{place.name} is not in this store"
    return f"uncommitted changes: {told}, on commit {commit} ({where})"


@cache
def _own() -> dict[str, bytes]:
    known, changes = provenance(), uncommitted()
    content = {f"packages-{known.environment_hash}.txt": packages()}
    if changes and changes.kept:
        # No time in it, so that all writers write the same.
        content[_patch(changes.sha256)] = gzip.compress(changes.patch, mtime=0)
    return content


def _patch(sha256: str | None) -> str:
    return f"changes-{sha256}.patch.gz"


def _list(known: Mapping | None) -> str:
    return f"packages-{(known or {}).get('environment_hash')}.txt"


def _unzipped(name: str, content: bytes) -> bytes:
    opened = zlib.decompressobj(wbits=31)
    try:
        # Never more than we would have written: a small file can unfold to a huge one.
        out = opened.decompress(content, LARGEST + 1)
    except zlib.error as error:
        raise InputError(f"{name} is damaged: {error}.") from error
    if len(out) > LARGEST:
        raise InputError(f"{name} unfolds to more than {LARGEST} bytes.")
    return out
