"""The list of sums of a record's files, which lies beside them as ``_sums.json``."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from residual.errors import InputError

SUMS = "_sums.json"


def sums_in(folder: Path) -> Mapping[str, Mapping]:
    """Return the sums of a record's files by name, as the list beside them has them."""
    try:
        return parse_sums(folder / SUMS, (folder / SUMS).read_bytes())
    except FileNotFoundError:
        raise
    except OSError as error:
        raise damage_error(folder / SUMS, error) from error


def parse_sums(path: Path, text: bytes) -> Mapping[str, Mapping]:
    """Return the sums in the text of a list; a name in it is of no other place."""
    try:
        sums = json.loads(text)["files"]
        if sums_text(sums) == text and all(name == Path(name).name for name in sums):
            return sums
    except (ValueError, KeyError, TypeError, RecursionError):
        pass
    raise damage_error(path, "it is not the list that was written")


def sums_text(sums: Mapping) -> bytes:
    """Return a list of sums as its file has it: it ends with its own SHA-256."""
    made = json.dumps(sums, sort_keys=True, separators=(",", ":"))
    own = hashlib.sha256(made.encode()).hexdigest()
    return f'{{"files":{made},"sha256":"{own}"}}\n'.encode()


def damage_error(path: Path, what: object) -> InputError:
    """Return the error, in one line, that names a damaged file."""
    text = " ".join(str(what).split())
    return InputError(
        f"{path} is damaged ({text[:120]}). Take its folder out of the store."
    )
