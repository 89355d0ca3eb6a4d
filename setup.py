"""Build hook: a wheel remembers its commit, and has prefect.yaml and the examples.

Everything else is in pyproject.toml. `modelgap --version` reads what this writes
(`warehouse/code_provenance.py`).
"""

import shutil
import subprocess
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

HERE = Path(__file__).parent
# As `flows.settings.SHARED` looks for them.
SHARED = ("prefect.yaml", "examples/nightly.toml", "examples/weekly.toml")


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
    """Puts commit.txt beside the module that reads it, and what `up` serves."""

    def run(self) -> None:
        """Copy the packages, then the rest; an editable install has the checkout."""
        super().run()
        if not self.editable_mode:
            place = Path(self.build_lib, "warehouse", "commit.txt")
            place.write_text(commit(), encoding="ascii")
            shared = Path(self.build_lib, "flows", "shared")
            (shared / "examples").mkdir(parents=True, exist_ok=True)
            for name in SHARED:
                shutil.copyfile(HERE / name, shared / name)


setup(cmdclass={"build_py": BuildWithCommit})
