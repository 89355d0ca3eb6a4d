"""Which code and which libraries made a record."""

import ast
import hashlib
import platform
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import distributions
from pathlib import Path

from warehouse.origin.changes import PACKAGES, ROOT, git, is_checkout, uncommitted

# Named in the manifest; all others are in the hash of the environment.
_TOLD = (
    "modelgap",
    "numpy",
    "scipy",
    "numba",
    "pin",
    "pybullet",
    "pyarrow",
    "duckdb",
)


@dataclass(frozen=True, slots=True)
class Provenance:
    """Code and environment of this process.

    Attributes:
        code_hash: Hash of the plant's code, part of the id of every run.
        commit: Commit in git, None where this is no checkout.
        dirty: Whether the code differs from that commit; None where there is none.
        lock_hash: Hash of requirements.lock, None where there is none.
        environment_hash: Hash of all installed packages and their versions.
        versions: Versions of Python, of this program and the libraries that compute.
        program_hash: Hash of all our code, which decides what derived records say.
        uncommitted: How the code differs from the commit (``Changes.as_record``);
            None where that is unknown, for there is no checkout.
        machine: Kind of system and processor.
    """

    code_hash: str
    commit: str | None
    dirty: bool | None
    lock_hash: str | None
    environment_hash: str
    versions: dict[str, str]
    program_hash: str
    uncommitted: Mapping | None
    machine: str


@cache
def provenance() -> Provenance:
    """Return code and environment as they were when first asked for.

    Not again later: what runs is what was loaded, not what was edited since.
    """
    installed, changes = _installed(), uncommitted()
    lock = ROOT / "requirements.lock"
    told = {name: installed[name] for name in _TOLD if name in installed}
    return Provenance(
        code_hash=plant_code_hash(),
        commit=_commit(),
        dirty=_dirty(),
        lock_hash=_sha256(lock.read_bytes()) if lock.is_file() else None,
        environment_hash=_sha256(packages()),
        versions={"python": platform.python_version(), **told},
        program_hash=program_hash(),
        uncommitted=changes and changes.as_record(),
        machine=_machine(),
    )


def as_record(known: Provenance) -> dict:
    """Return it as a part of a manifest."""
    return asdict(known)


@cache
def packages() -> bytes:
    """Return all installed packages, one line each as in name==version."""
    found = sorted(_installed().items())
    return "\n".join(f"{name}=={version}" for name, version in found).encode()


@cache
def program_hash(root: Path = ROOT) -> str:
    """Return the hash of all our code, 64 hex digits."""
    files = {p for name in PACKAGES for p in (root / name).rglob("*") if _counts(p)}
    return _hash_files(files, root)


@cache
def plant_code_hash(root: Path = ROOT) -> str:
    """Return the hash of all that decides what a simulated run is, 64 hex digits.

    That is ``sim/`` and the modules of ``residual/`` that it imports, directly or
    through others. Libraries are not in it: an upgrade makes no run a new one.
    """
    return _hash_files(plant_files(root), root)


def _hash_files(files: Iterable[Path], root: Path) -> str:
    total = hashlib.sha256()
    for path in sorted(files, key=lambda p: p.relative_to(root).as_posix()):
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


@cache
def _installed() -> dict[str, str]:
    found = ((d.metadata["Name"], d.version) for d in distributions())
    return {name.lower(): version for name, version in found if name}


def _commit() -> str | None:
    if not is_checkout():
        return None
    return _git_answer("rev-parse", "HEAD") or None


def _dirty() -> bool | None:
    if _commit() is None:
        return None
    changes = _git_answer("status", "--porcelain", "--", *PACKAGES)
    return None if changes is None else bool(changes)


def _git_answer(*words: str) -> str | None:
    answer = git(ROOT, *words)
    return None if answer is None else answer.decode("utf-8", "replace").strip()


def _machine() -> str:
    """Say which processor: linear algebra takes another path on another one."""
    kind = f"{platform.system()} {platform.machine()}"
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return kind
    names = [line.partition(":")[2] for line in lines if line.startswith("model name")]
    return f"{kind}, {names[0].strip()}" if names else kind


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
