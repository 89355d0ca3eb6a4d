"""Uncommitted changes of the code: as a patch that can be put back."""

import hashlib
import re
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("flows", "residual", "sim", "warehouse")
# What decides a result: our code, and the versions that were asked for.
WATCHED = (*PACKAGES, "pyproject.toml", "requirements.lock", "requirements-dev.lock")
LARGEST = 1_000_000  # bytes of a patch that is still kept
_TOLD = 20  # files that are named; the others are counted
_PLAIN = re.compile(r"[\w./@+-]+")


@dataclass(frozen=True, slots=True)
class Changes:
    """How the code differs from its commit.

    Attributes:
        files: Files that differ, by their path in the checkout.
        patch: What `git apply` puts onto the commit; empty where nothing differs.
        sha256: Hash of the patch, 64 hex digits; None where nothing differs.
    """

    files: tuple[str, ...]
    patch: bytes
    sha256: str | None

    @property
    def kept(self) -> bool:
        """Whether the patch is small enough to be kept, not only its hash."""
        return 0 < len(self.patch) <= LARGEST

    def as_record(self) -> dict:
        """Return what a manifest says of it."""
        return {
            "sha256": self.sha256,
            "bytes": len(self.patch),
            "kept": self.kept,
            "count": len(self.files),
            "files": list(self.files[:_TOLD]),
        }


def is_checkout(root: Path = ROOT) -> bool:
    """Whether this is a checkout of ours, not one of a project that has us inside."""
    return bool(git(root, "ls-files", "--", "warehouse/__init__.py"))


@cache
def uncommitted(root: Path = ROOT) -> Changes | None:
    """Return the changes as they were when first asked for; None for no checkout."""
    if not is_checkout(root):
        return None
    plain = ("--no-ext-diff", "--no-textconv", "--no-color", "--relative")
    paths = ("--", *WATCHED)
    patch = git(root, "diff", "--binary", "--full-index", *plain, "HEAD", *paths)
    changed = git(root, "diff", "--name-only", "--relative", "-z", "HEAD", *paths)
    new = git(root, "ls-files", "--others", "--exclude-standard", "-z", *paths)
    if patch is None or changed is None or new is None:
        return None
    added = sorted(name for name in new.decode("utf-8", "replace").split("\0") if name)
    whole = patch + b"".join(_as_new(root, name) for name in added)
    files = (*filter(None, changed.decode("utf-8", "replace").split("\0")), *added)
    sha256 = hashlib.sha256(whole).hexdigest() if whole else None
    return Changes(tuple(files), whole, sha256)


def git(root: Path, *words: str) -> bytes | None:
    """Return what git says; None where there is none, or it refuses."""
    try:
        done = subprocess.run(
            ["git", "--no-optional-locks", "-C", str(root), *words],
            capture_output=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout


def _as_new(root: Path, name: str) -> bytes:
    """Return a file that git does not know, as a patch that adds it."""
    try:
        content = (root / name).read_bytes()
    except OSError:
        return b""
    if not content:
        return f"diff --git a/{name} b/{name}\nnew file mode 100644\n".encode()
    if b"\0" in content or not _PLAIN.fullmatch(name):
        # A remark between two patches, which git passes over.
        told = hashlib.sha256(content).hexdigest()
        return f"not in this patch: {name}, sha256 {told}\n".encode()
    lines = content.split(b"\n")
    whole = not lines[-1]
    lines = lines[:-1] if whole else lines
    head = (
        f"diff --git a/{name} b/{name}\nnew file mode 100644\n"
        f"--- /dev/null\n+++ b/{name}\n@@ -0,0 +1,{len(lines)} @@\n"
    )
    body = b"".join(b"+" + line + b"\n" for line in lines)
    return head.encode() + body + (b"" if whole else b"\\ No newline at end of file\n")
