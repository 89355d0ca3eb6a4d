"""What lies in the checkout: no test may write into it."""

import os
from pathlib import Path

ROOT = Path(__file__).parents[1]
# Not listed: files of the tools, caches of Python and the compiler, and the store that
# another program may use meanwhile. A test that writes into the default store is caught
# by its environment (conftest.py).
LEFT_OUT = {
    ".git",
    "store",
    ".venv",
    "__pycache__",
    ".pytest_cache",
    ".ruff_cache",
    ".import_linter_cache",
}

Listing = dict[str, tuple[int, int]]


def listing(root: Path = ROOT) -> Listing:
    found = {}
    for folder, inside, files in os.walk(root):
        inside[:] = sorted(set(inside) - LEFT_OUT)
        for path in (Path(folder) / name for name in files if name not in LEFT_OUT):
            about = path.lstat()
            found[str(path.relative_to(root))] = (about.st_size, about.st_mtime_ns)
    return found


def changed(before: Listing, after: Listing) -> list[str]:
    return sorted({path for path, _ in before.items() ^ after.items()})
