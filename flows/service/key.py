"""The key of a store's server: made once, for the eyes of its owner only."""

import os
import secrets
from contextlib import suppress
from pathlib import Path
from tempfile import mkstemp

from residual.errors import InputError

KEY = "key"  # in Prefect's folder of the store
# Under these names Prefect's clients and its server take it.
CLIENT, SERVER = "PREFECT_API_AUTH_STRING", "PREFECT_SERVER_API_AUTH_STRING"
_SHORTEST = 32


def store_key(home: Path) -> str:
    """Return the key of a store's server, made if there is none yet.

    Raises:
        InputError: If others may read it, or it is none.
    """
    path = home / KEY
    if not path.exists():
        _make(path)
    if path.stat().st_mode & 0o077:
        raise InputError(
            f"{path} can be read by others, expected by its owner only. Delete it, "
            "then modelgap down and modelgap up: a new one is made."
        )
    key = path.read_text(encoding="ascii", errors="replace").strip()
    if len(key) < _SHORTEST or not key.isprintable():
        raise InputError(
            f"{path} is no key. Delete it, then modelgap down and modelgap up: a new "
            "one is made."
        )
    return key


def _make(path: Path) -> None:
    """Write a new key, whole or not at all; of two at once the first one counts."""
    handle, draft = mkstemp(dir=path.parent, prefix=f"{path.name}.")  # 0600
    try:
        with os.fdopen(handle, "w", encoding="ascii") as file:
            file.write(f"modelgap:{secrets.token_urlsafe(32)}\n")
            file.flush()
            os.fsync(file.fileno())
        with suppress(FileExistsError):
            os.link(draft, path)
    finally:
        os.unlink(draft)
