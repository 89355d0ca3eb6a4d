"""Which code, machine and day a result comes from, and whether the code has changed.

The hash covers what the code does: comments, docstrings and line breaks do not count.
"""

import ast
import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
RESULTS = ROOT / "benchmarks" / "results"
STORE = ROOT / "store" / "benchmarks"
# What measures: its Python files. Files that a run writes itself do not count.
_DRAWING = ("benchmarks/*.py", "tests/synthetic")
PRODUCT = ("residual", "sim", "warehouse", "flows", "modelgap.py")


def circumstances(name: str, **extra: object) -> dict:
    """Return commit, hash of the code of a results file, date and machine of a run."""
    return {
        "commit": _git("rev-parse", "HEAD"),
        "dirty": bool(_git("status", "--porcelain", "--", *PRODUCT, *_DRAWING)),
        "code": code_of(name),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "cores": os.cpu_count(),
        "machine": _machine(),
        **extra,
    }


# What a benchmark measures; the core if not listed.
_MEASURED = {
    "store": ("warehouse",),
    "pipelines": ("warehouse", "flows/workers.py", "flows/pipelines"),
}


def code_of(name: str) -> str:
    return code_hash(*_MEASURED.get(name, ("residual",)))


def is_current(name: str, content: Mapping) -> bool:
    """Whether a results file is of the present code."""
    return content.get("code") == code_of(name)


@cache
def code_hash(*places: str) -> str:
    """Return a hash of code and of data files next to it, 16 hex digits."""
    digest = hashlib.sha256()
    for place in places:
        path = ROOT / place
        for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
            if file.suffix == ".py":
                text = bare(file.read_text(encoding="utf-8")).encode()
            elif file.suffix in (".urdf", ".toml"):
                text = file.read_bytes()
            else:
                continue
            digest.update(file.relative_to(ROOT).as_posix().encode() + b"\0" + text)
    return digest.hexdigest()[:16]


def bare(source: str) -> str:
    """Return Python source without comments, docstrings and line breaks."""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        match node:
            case ast.AST(body=[ast.Expr(value=ast.Constant(value=str())), *rest]):
                node.body = rest or [ast.Pass()]
    return ast.unparse(tree)


def save(path: Path, content: Mapping) -> None:
    """Write a JSON file by a rename."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_suffix(".part")
    draft.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    draft.replace(path)


def _git(*words: str) -> str | None:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout.strip() if done.returncode == 0 else None


def _machine() -> str:
    """Return the processor's name under Linux, its family elsewhere."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    named = [line.partition(":")[2] for line in lines if line.startswith("model name")]
    return " ".join(named[0].split()) if named else platform.machine()
