"""What lies in the checkout: no test may write into it."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Of the tools, and what Python and the compiler keep for the next time.
CACHES = {
    ".git",
    ".venv",
    "__pycache__",
    ".pytest_cache",
    ".ruff_cache",
    ".import_linter_cache",
}

Listing = dict[str, tuple[int, int]]


def listing(root: Path = ROOT) -> Listing:
    """Return size and time of change of every file, caches left out."""
    found = {}
    for folder, inside, files in os.walk(root):
        inside[:] = sorted(set(inside) - CACHES)
        for path in (Path(folder) / name for name in files if name not in CACHES):
            about = path.lstat()
            found[str(path.relative_to(root))] = (about.st_size, about.st_mtime_ns)
    return found


def changed(before: Listing, after: Listing) -> list[str]:
    """Return what was made, removed or written between two listings."""
    return sorted({path for path, _ in before.items() ^ after.items()})
