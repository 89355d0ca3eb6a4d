"""Addresses of the pages: the same with and without a server, and nothing else."""

import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date

LATEST = "latest"
ALL = "all"
# What the index can be narrowed to, and what is said of it.
KINDS = {
    "any": "everything",
    "night": "nights",
    "effects": "something missing",
    "none": "nothing missing",
    "unknown": "unknown",
    "proposal": "decisions",
    "study": "studies",
    "model": "models",
}
_PLAIN = re.compile(r"[a-z0-9_][a-z0-9_-]{0,39}")


def slug(robot: str) -> str:
    """Return a robot as a part of an address; a strange name with its hash, no more."""
    if _PLAIN.fullmatch(robot) and robot != ALL:
        return robot
    plain = re.sub(r"[^a-z0-9]+", "-", robot.lower()).strip("-")[:24]
    return f"{plain}--{hashlib.sha256(robot.encode()).hexdigest()[:12]}".lstrip("-")


@dataclass(frozen=True, slots=True)
class Place:
    """Where a page is, from which all links on it go out.

    Attributes:
        up: What leads to the first folder: "", "../" or "../../".
        prefect: Address of Prefect's pages, None where no server runs.
        has_report: Whether a record of reports has a file of that name.
    """

    up: str
    prefect: str | None
    has_report: Callable[[str, str], bool]

    def night(self, night: date | str = LATEST) -> str:
        """Return the address of a night."""
        return f"{self.up}night/{night}.html"

    def robot(self, name: str) -> str:
        """Return the address of a robot."""
        return f"{self.up}robot/{slug(name)}.html"

    def record(self, id: str) -> str:
        """Return the address of any record."""
        return f"{self.up}record/{id}.html"

    def report(self, id: str | None, otherwise: str, file: str = "report.html") -> str:
        """Return the address of a stored page, or where there is none of a record."""
        if id and self.has_report(id, file):
            return f"{self.up}report/{id}/{file}"
        return self.record(otherwise)

    def index(self, robot: str | None = None, kind: str = "any", part: int = 1) -> str:
        """Return the address of the index of all reports, or a part of it."""
        if (robot, kind, part) == (None, "any", 1):
            return f"{self.up}index.html"
        more = f"-{part}" if part > 1 else ""
        return f"{self.up}reports/{slug(robot) if robot else ALL}/{kind}{more}.html"

    def flow_run(self, id: str) -> str | None:
        """Return the address of a flow run at Prefect; None without a server."""
        return f"{self.prefect}runs/flow-run/{id}" if self.prefect else None
