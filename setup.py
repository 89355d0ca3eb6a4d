"""Build hook: a wheel remembers the commit that it was built from.

Everything else is in pyproject.toml. `modelgap --version` reads what this writes
(`warehouse/provenance.py`).
"""

import subprocess
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

HERE = Path(__file__).parent


def commit() -> str:
    """Return the commit of this checkout, with "+" where files differ; "" for none."""
    try:
        head = _git("rev-parse", "HEAD")
        return f"{head}+" if _git("status", "--porcelain", "-uno") else head
    except (OSError, subprocess.CalledProcessError):
        return ""


def _git(*words: str) -> str:
    asked = ["git", "--no-optional-locks", *words]
    done = subprocess.run(asked, cwd=HERE, capture_output=True, text=True, check=True)
    return done.stdout.strip()


class BuildWithCommit(build_py):
    """Puts commit.txt beside the module that reads it."""

    def run(self) -> None:
        """Copy the packages, then write the file; an editable install has git."""
        super().run()
        if not self.editable_mode:
            place = Path(self.build_lib, "warehouse", "commit.txt")
            place.write_text(commit(), encoding="ascii")


setup(cmdclass={"build_py": BuildWithCommit})
