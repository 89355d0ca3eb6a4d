"""Compiled code, kept on disk until any file of the plant changes.

Numba keeps a function until its own file changes, and would go on with what the
function calls in other files as that was. So the folder is named after all of them.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path

import numba

_PLANT = Path(__file__).parent
_BESIDE = tuple(
    _PLANT.parent / f for f in ("laws.py", "kinds.py", "background/laws.py")
)
_SOURCES = (*sorted(_PLANT.glob("*.py")), *_BESIDE)
_CODE = hashlib.sha256(b"".join(path.read_bytes() for path in _SOURCES)).hexdigest()
_FOLDER = _PLANT / "__pycache__" / f"compiled-{_CODE[:12]}"


def compiled(function: Callable) -> Callable:
    """Compile a function on its first call; later processes load it."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_FOLDER)
    try:
        return numba.njit(cache=True)(function)
    finally:
        numba.config.CACHE_DIR = before
