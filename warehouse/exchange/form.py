"""What may be in a bundle: kinds of files by their path, and how large."""

import hashlib
import re
from pathlib import Path

from warehouse.ids import ID_DIGITS
from warehouse.layout import KINDS, SAMPLES_FILE, SEALED
from warehouse.origin.made_with import MADE_WITH
from warehouse.origin.robots import ROBOTS
from warehouse.seal import SPEC, TRUTH

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

    Args:
        name: Its path in the bundle.

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
