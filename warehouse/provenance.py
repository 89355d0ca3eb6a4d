"""Which code and which libraries made a record."""

import ast
import hashlib
import platform
import subprocess
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import distributions
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
# Named in the manifest; all others are in the hash of the environment.
_TOLD = ("numpy", "scipy", "numba", "pin", "pybullet", "pyarrow", "duckdb")


@dataclass(frozen=True, slots=True)
class Provenance:
    """Code and environment of this process.

    Attributes:
        code_hash: Hash of the plant's code, part of the id of every run.
        commit: Commit in git, None where this is no checkout.
        dirty: Whether the code differs from that commit; None where there is none.
        lock_hash: Hash of requirements.lock, None where there is none.
        environment_hash: Hash of all installed packages and their versions.
        versions: Versions of Python and the libraries that compute.
    """

    code_hash: str
    commit: str | None
    dirty: bool | None
    lock_hash: str | None
    environment_hash: str
    versions: dict[str, str]


@cache
def provenance() -> Provenance:
    """Return code and environment as they were when first asked for.

    Not again later: what runs is what was loaded, not what was edited since.
    """
    installed = _installed()
    lines = "\n".join(
        f"{name}=={version}" for name, version in sorted(installed.items())
    )
    lock = ROOT / "requirements.lock"
    told = {name: installed[name] for name in _TOLD if name in installed}
    return Provenance(
        code_hash=plant_code_hash(),
        commit=_commit(),
        dirty=_dirty(),
        lock_hash=_sha256(lock.read_bytes()) if lock.is_file() else None,
        environment_hash=_sha256(lines.encode()),
        versions={"python": platform.python_version(), **told},
    )


def as_record(known: Provenance) -> dict:
    """Return it as a part of a manifest."""
    return asdict(known)


@cache
def plant_code_hash(root: Path = ROOT) -> str:
    """Return the hash of all that decides what a simulated run is, 64 hex digits.

    That is ``sim/`` and the modules of ``residual/`` that it imports, directly or
    through others. Libraries are not in it: an upgrade makes no run a new one.

    Args:
        root: Folder with ``sim`` and ``residual``.
    """
    total = hashlib.sha256()
    for path in plant_files(root):
        total.update(f"{path.relative_to(root).as_posix()}\0".encode())
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def plant_files(root: Path = ROOT) -> tuple[Path, ...]:
    """Return the files that ``plant_code_hash`` is of, in order."""
    files = {p for p in (root / "sim").rglob("*") if _counts(p)}
    todo = [p for p in files if p.suffix == ".py"]
    while todo:
        new = _imported(todo.pop(), root) - files
        files |= new
        todo += new
    return tuple(sorted(files, key=lambda p: p.relative_to(root).as_posix()))


def _counts(path: Path) -> bool:
    return path.is_file() and "__pycache__" not in path.parts


def _imported(path: Path, root: Path) -> set[Path]:
    """Return the files of ``residual`` that one file imports anywhere in it."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            names |= _from_names(node, path, root)
    ours = {name for name in names if name.split(".")[0] == "residual"}
    return {file for name in ours for file in _files_of(name, root)}


def _from_names(node: ast.ImportFrom, path: Path, root: Path) -> set[str]:
    base = path.relative_to(root).parent.parts
    above = base[: len(base) - node.level + 1] if node.level else ()
    module = ".".join([*above, *([node.module] if node.module else [])])
    return {module, *(f"{module}.{alias.name}" for alias in node.names)}


def _files_of(name: str, root: Path) -> list[Path]:
    """Return the files that are run when a module is imported: packages first."""
    parts = name.split(".")
    packages = [
        root.joinpath(*parts[:k], "__init__.py") for k in range(1, len(parts) + 1)
    ]
    module = root.joinpath(*parts).with_suffix(".py")
    return [path for path in [*packages, module] if path.is_file()]


def _installed() -> dict[str, str]:
    found = ((d.metadata["Name"], d.version) for d in distributions())
    return {name.lower(): version for name, version in found if name}


def _commit() -> str | None:
    # A checkout of ours, not that of a project which has us in its environment.
    if not _git("ls-files", "--", "warehouse/__init__.py"):
        return None
    return _git("rev-parse", "HEAD") or None


def _dirty() -> bool | None:
    if _commit() is None:
        return None
    packages = ("flows", "residual", "sim", "warehouse")
    changes = _git("status", "--porcelain", "--", *packages)
    return None if changes is None else bool(changes)


def _git(*words: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", "-C", str(ROOT), *words],
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
