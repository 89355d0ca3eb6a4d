"""Which code diagnoses and judges: what that makes is kept under its hash."""

import hashlib
from functools import cache
from pathlib import Path

_JUDGES = ("steps.py", "row.py", "score.py", "size.py")


@cache
def method_hash() -> str:
    """Return the hash of the code that diagnoses and judges, 16 hex digits."""
    root, total = Path(__file__).parents[2], hashlib.sha256()
    files = [
        *(root / "residual").rglob("*.py"),
        *(root / "flows" / "blind" / f for f in _JUDGES),
    ]
    for path in sorted(files):
        total.update(path.relative_to(root).as_posix().encode())
        total.update(path.read_bytes())
    return total.hexdigest()[:16]
