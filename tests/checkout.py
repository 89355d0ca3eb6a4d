"""What lies in the checkout: no test may write into it; its sources, parsed once."""

import ast
import os
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
ROOMS = ("flows", "residual", "sim", "warehouse")
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


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """Return all nodes of a source file, its module first."""
    return tuple(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def sources(*folders: str) -> list[Path]:
    return sorted(p for f in folders for p in (ROOT / f).rglob("*.py"))


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
