"""Which version of the program this is: the number of the package, and its commit.

A checkout asks git. A wheel has a file that was written when it was built (`setup.py`).
"""

from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from warehouse.origin.changes import ROOT, git, is_checkout

BUILT = Path(__file__).with_name("commit.txt")


def commit(root: Path = ROOT, built: Path = BUILT) -> str | None:
    """Return the commit of the code that runs; None where nobody knows it."""
    if is_checkout(root):
        answer = git(root, "rev-parse", "HEAD")
        return answer.decode("ascii").strip() if answer else None
    try:
        return built.read_text(encoding="ascii").strip() or None
    except OSError:
        return None


def version_text() -> str:
    """Return '0.1.0 (commit 1234567)', as `modelgap --version` prints it."""
    try:
        number = version("modelgap")
    except PackageNotFoundError:
        number = "not installed"
    known = commit()
    return f"{number} (commit {known[:12] if known else 'unknown'})"
