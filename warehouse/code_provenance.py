"""Which code and libraries made a record: commit, hashes, versions, machine.

``made_with/packages-<sha256>.txt`` is named by the hash of its content.
The commit of the program comes from git in a checkout, and from a file written at build
time in a wheel (`setup.py`).
"""

import ast
import hashlib
import platform
import subprocess
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import cache
from importlib.metadata import PackageNotFoundError, distributions, version
from pathlib import Path

from residual.errors import InputError
from warehouse.remote_store import fetch_file
from warehouse.store_files import replace_file

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("flows", "residual", "sim", "warehouse")
# The inputs of the hash: our code, and the required versions.
WATCHED = (*PACKAGES, "pyproject.toml", "requirements.lock", "requirements-dev.lock")
_NAMED = 20  # files that are named; the others are counted

# Named in the manifest; all others are in the hash of the environment.
_TOLD = ("modelgap", "numpy", "scipy", "numba", "pin", "pybullet", "pyarrow", "duckdb")
BUILT = Path(__file__).with_name("commit.txt")
# What `setup.py` adds to a wheel.
_BUILT = ("warehouse/commit.txt", "flows/shared/")
MADE_WITH = "made_with"


def is_source_checkout(root: Path = ROOT) -> bool:
    """Whether this is our checkout, not that of a project that contains us."""
    return bool(run_git(root, "ls-files", "--", "warehouse/__init__.py"))


@cache
def describe_uncommitted_files(root: Path = ROOT) -> dict | None:
    """Return the changes of the code from its commit: files, and a hash of all changes.

    Returns:
        ``sha256`` (None where nothing differs), ``count`` and the first ``files``; None
        where this is no checkout.
    """
    paths = ("--", *WATCHED)
    diff = run_git(root, "diff", "--no-ext-diff", "--binary", "HEAD", *paths)
    changed = run_git(root, "diff", "--name-only", "--relative", "-z", "HEAD", *paths)
    new = run_git(root, "ls-files", "--others", "--exclude-standard", "-z", *paths)
    if not is_source_checkout(root) or diff is None or changed is None or new is None:
        return None
    added = [name for name in new.decode("utf-8", "replace").split("\0") if name]
    files = [*filter(None, changed.decode("utf-8", "replace").split("\0")), *added]
    content = diff + _hash_files([root / name for name in added], root).encode()
    return {
        "sha256": _sha256(content) if files else None,
        "count": len(files),
        "files": files[:_NAMED],
    }


def run_git(root: Path, *words: str) -> bytes | None:
    """Return the output of git; None if git is missing or fails."""
    try:
        done = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(root), *words], capture_output=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return None
    # 1: two files differ.
    return done.stdout if done.returncode in (0, 1) else None


@dataclass(frozen=True, slots=True)
class CodeProvenance:
    """Code and environment of this process."""

    code_hash: str  # hash of the plant's code, part of the id of every run
    commit: str | None  # commit in git, None where this is no checkout
    # Whether the code differs from that commit; None where there is none.
    dirty: bool | None
    lock_hash: str | None  # hash of requirements.lock, None where there is none
    environment_hash: str  # hash of all installed packages and their versions
    # Versions of Python, of this program and the libraries that compute.
    versions: dict[str, str]
    program_hash: str  # hash of all our code, which decides the content of derived records
    uncommitted: Mapping | None  # how the code differs from the commit
    machine: str  # kind of system and processor


@cache
def read_code_provenance() -> CodeProvenance:
    """Return code and environment as of the first call.

    They are cached: the running code is what was loaded, not later edits.
    """
    installed = _installed()
    lock = ROOT / "requirements.lock"
    versions = {name: installed[name] for name in _TOLD if name in installed}
    ours = is_source_checkout()
    changes = run_git(ROOT, "status", "--porcelain", "--", *PACKAGES) if ours else None
    # The processor too: linear algebra takes another path on another one.
    machine, lines = f"{platform.system()} {platform.machine()}", []
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    names = [line.partition(":")[2] for line in lines if line.startswith("model name")]
    return CodeProvenance(
        code_hash=hash_plant_code(),
        commit=find_code_commit() if ours else None,
        dirty=None if changes is None else bool(changes.strip()),
        lock_hash=_sha256(lock.read_bytes()) if lock.is_file() else None,
        environment_hash=_sha256(list_installed_packages()),
        versions={"python": platform.python_version(), **versions},
        program_hash=hash_program_code(),
        uncommitted=describe_uncommitted_files(),
        machine=f"{machine}, {names[0].strip()}" if names else machine,
    )


def build_origin_columns(manifest: Mapping) -> dict:
    """Return the columns of ``runs`` on code, machine and purpose."""
    origin = manifest.get("provenance") or {}
    return {
        "commit": origin.get("commit"),
        "version": (origin.get("versions") or {}).get("modelgap"),
        "machine": origin.get("machine"),
        "campaign": manifest.get("campaign"),
    }


@cache
def list_installed_packages() -> bytes:
    """Return all installed packages, one line each as in name==version."""
    versions = sorted(_installed().items())
    return "\n".join(f"{name}=={version}" for name, version in versions).encode()


@cache
def hash_program_code(root: Path = ROOT) -> str:
    """Return the hash of all our code, 64 hex digits."""
    files = (p for name in PACKAGES for p in (root / name).rglob("*"))
    return _hash_files({p for p in files if _counts(p, root)}, root)


@cache
def hash_plant_code(root: Path = ROOT) -> str:
    """Return the hash of the code that determines a simulated run, 64 hex digits.

    That is ``sim/`` and the modules of ``residual/`` that it imports, directly or
    through others. It excludes libraries: an upgrade changes no run id.
    """
    return _hash_files(list_plant_files(root), root)


def _hash_files(files: Iterable[Path], root: Path) -> str:
    total = hashlib.sha256()
    for path in sorted(files, key=lambda p: p.relative_to(root).as_posix()):
        total.update(f"{path.relative_to(root).as_posix()}\0".encode())
        total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()


def list_plant_files(root: Path = ROOT) -> tuple[Path, ...]:
    """Return the files of `hash_plant_code`, in order.

    Imports are followed into our own packages only, by the text of the files; other
    packages in a site-packages are neither read nor counted.
    """
    files = {p for p in (root / "sim").rglob("*") if _counts(p, root)}
    unread = [p for p in files if p.suffix == ".py"]
    while unread:
        new = set(_list_imports(unread.pop(), root)) - files
        files |= new
        unread += new
    return tuple(sorted(files, key=lambda p: p.relative_to(root).as_posix()))


def _list_imports(path: Path, root: Path) -> Iterator[Path]:
    """Yield the files of ours that a module imports, with those of their packages."""
    package = path.relative_to(root).parent.parts
    for node in ast.walk(ast.parse(path.read_bytes())):
        base: tuple[str, ...] = ()
        if isinstance(node, ast.ImportFrom):
            if node.level:
                base = package[: len(package) + 1 - node.level]
            base += tuple(node.module.split(".") if node.module else ())
        elif not isinstance(node, ast.Import):
            continue
        for alias in node.names:
            parts = (*base, *alias.name.split("."))
            for end in range(1, len(parts) + 1) if parts[0] in PACKAGES else ():
                place = root.joinpath(*parts[:end])
                both = (place / "__init__.py", place.with_suffix(".py"))
                yield from filter(Path.is_file, both)


def _counts(path: Path, root: Path) -> bool:
    """Whether a file counts: not those that a build adds to a wheel."""
    name = path.relative_to(root).as_posix()
    built = "/__pycache__/" in name or name.startswith(_BUILT)
    return path.is_file() and not built


@cache
def _installed() -> dict[str, str]:
    packages_found = ((d.metadata["Name"], d.version) for d in distributions())
    return {name.lower(): version for name, version in packages_found if name}


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def find_code_commit(root: Path = ROOT, built: Path = BUILT) -> str | None:
    """Return the commit of the running code; None if unknown."""
    if is_source_checkout(root):
        answer = run_git(root, "rev-parse", "HEAD")
        return answer.decode("ascii").strip() if answer else None
    try:
        return built.read_text(encoding="ascii").strip() or None
    except OSError:
        return None


def format_version() -> str:
    """Return '0.1.0 (commit 1234567)', as `modelgap --version` prints it."""
    try:
        number = version("modelgap")
    except PackageNotFoundError:
        number = "not installed"
    revision = find_code_commit()
    return f"{number} (commit {revision[:12] if revision else 'unknown'})"


def store_package_list(store: Path) -> None:
    """Store the list of installed packages, unless it is stored already."""
    target = store / MADE_WITH / _list_name(asdict(read_code_provenance()))
    if not target.is_file():
        replace_file(store, target, list_installed_packages())


def read_package_versions(store: Path, origin: Mapping) -> dict[str, str] | None:
    """Return versions by package; None if they were not stored."""
    path = store / MADE_WITH / _list_name(origin)
    fetch_file(path)
    try:
        check_package_list(path.name, path.read_bytes())
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError, InputError):
        return None
    return dict(line.split("==", 1) for line in lines if "==" in line)


def check_package_list(name: str, content: bytes) -> None:
    """Check that a list of packages has the hash in its name."""
    if name.endswith(".txt") and name != f"packages-{_sha256(content)}.txt":
        raise InputError(f"{name} is damaged: its content has another hash.")


def format_uncommitted_change(origin: Mapping) -> str:
    """Return the uncommitted changes that a record was made with, in one line."""
    changes, commit = origin.get("uncommitted"), (origin.get("commit") or "")[:12]
    if changes is None:
        return "uncommitted changes: unknown, the code was not a git checkout"
    if not changes["sha256"]:
        return f"uncommitted changes: none, the code was that of commit {commit}"
    some = ", ".join(changes["files"][:4])
    more = changes["count"] - len(changes["files"][:4])
    files = f"{some} and {more} more" if more > 0 else some
    return f"uncommitted changes: {files}, on commit {commit}"


def _list_name(origin: Mapping) -> str:
    return f"packages-{origin.get('environment_hash')}.txt"
