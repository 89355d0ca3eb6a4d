"""Sums of a record's files: a flipped bit anywhere in them is found by who reads them.

The checksums of Parquet cover its pages and not what lies around them, and DuckDB
looks at none of them. So every record has ``_sums.json`` beside its files: of each file
the SHA-256, which ``verify`` takes again, and the CRC-32 of every 64 KB, which a reader
of a part takes again for that part. It ends with its own SHA-256. A record of an
earlier version has none.
"""

import hashlib
import json
import os
import zlib
from collections.abc import Collection, Mapping
from pathlib import Path

from residual.errors import InputError
from warehouse.objects.mirror import SUMS, at_hand

BLOCK = 1 << 16
_CRC = 8  # hex digits


def write_sums(folder: Path) -> None:
    """Write the sums of all files of a folder into it."""
    paths = sorted(p for p in folder.iterdir() if p.is_file() and p.name != SUMS)
    text = _text({path.name: sums_of(path) for path in paths})
    (folder / SUMS).write_bytes(text)


def sums_of(path: Path) -> dict:
    """Return size, SHA-256 and CRC-32 of every block of a file, as JSON has them."""
    total, blocks = hashlib.sha256(), []
    with path.open("rb") as file:
        while block := file.read(BLOCK):
            total.update(block)
            blocks.append(crc(block))
        size = file.tell()
    return {"bytes": size, "sha256": total.hexdigest(), "blocks": "".join(blocks)}


def read_sums(folder: Path) -> Mapping[str, Mapping] | None:
    """Return the sums of a folder's files by name; None where it has none.

    Raises:
        InputError: If the list itself is damaged.
    """
    at_hand(folder / SUMS)
    try:
        text = (folder / SUMS).read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise _damaged(folder / SUMS, str(error)) from error
    try:
        sums = json.loads(text)["files"]
        whole = _text(sums) == text
    except (ValueError, KeyError, TypeError, RecursionError):
        whole = False
    if not whole:
        raise _damaged(folder / SUMS, "it is not the list that was written")
    return sums


def check_file(path: Path, blocks: Collection[int] | None = None) -> bool:
    """Check a file, or some of its blocks, against the sums beside it.

    Args:
        blocks: Numbers of the blocks; None for all.

    Returns:
        Whether there are sums; without any nothing was checked.

    Raises:
        InputError: If it is damaged; the message names it.
    """
    sums = read_sums(path.parent)
    if sums is None:
        return False
    at_hand(path)
    if path.name not in sums:
        raise _damaged(path, f"it is not in {SUMS}")
    check_blocks(path, sums[path.name], blocks)
    return True


def check_blocks(path: Path, known: Mapping, blocks: Collection[int] | None) -> None:
    """Check blocks of a file against its sums (`sums_of`).

    Raises:
        InputError: If one of them is damaged.
    """
    size, sums = known["bytes"], known["blocks"]
    count = len(sums) // _CRC
    try:
        handle = os.open(path, os.O_RDONLY)
        try:
            if os.fstat(handle).st_size != size:
                raise _damaged(path, f"it had {size} bytes when it was written")
            for number in range(count) if blocks is None else blocks:
                given = crc(os.pread(handle, BLOCK, number * BLOCK))
                if (
                    number < count
                    and given != sums[number * _CRC : (number + 1) * _CRC]
                ):
                    raise _damaged(path, "its bytes are not those that were written")
        finally:
            os.close(handle)
    except OSError as error:
        raise _damaged(path, error.strerror or str(error)) from error


def block_sums(known: Mapping) -> list[str]:
    """Return the CRC-32 of every block of a file from its sums (`sums_of`)."""
    sums = known["blocks"]
    return [sums[at : at + _CRC] for at in range(0, len(sums), _CRC)]


def file_faults(folder: Path) -> tuple[str, ...]:
    """Return what of a folder's files is not as it was written, byte for byte.

    Args:
        folder: Folder of a record; without sums nothing is said.
    """
    try:
        sums = read_sums(folder)
    except InputError as error:
        return (str(error),)
    if sums is None:
        return ()
    there = {p.name for p in folder.iterdir()} - {SUMS}
    told = [f"{name} is missing" for name in sorted(set(sums) - there)]
    told += [f"{name} is not in {SUMS}" for name in sorted(there - set(sums))]
    for name in sorted(there & set(sums)):
        if not (folder / name).is_file() or sums_of(folder / name) != sums[name]:
            told.append(f"{name}: its bytes are not those that were written")
    return tuple(told)


def _text(sums: Mapping) -> bytes:
    made = json.dumps(sums, sort_keys=True, separators=(",", ":"))
    own = hashlib.sha256(made.encode()).hexdigest()
    return f'{{"files":{made},"sha256":"{own}"}}\n'.encode()


def crc(block: bytes) -> str:
    """Return the CRC-32 of a block as sums have it."""
    return f"{zlib.crc32(block):08x}"


def _damaged(path: Path, what: str) -> InputError:
    return InputError(damaged(path, what))


def damaged(path: Path, what: object) -> str:
    """Return one line that names a damaged file."""
    text = " ".join(str(what).split())
    return f"{path} is damaged ({text[:120]}). Take its folder out of the store."
