"""What a store holds, as the rows that pages are made of."""

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from datetime import date, datetime, time, timedelta
from functools import lru_cache
from pathlib import Path

from markupsafe import Markup

from flows.report.document import tag
from flows.report.night import questions
from flows.report.words.verdict import VALUES_OFF, errors, finding
from flows.storage.diagnosis import read_verdict
from residual.errors import InputError
from warehouse.query.store import Store, open_store

_HALF_A_DAY = timedelta(hours=12)
AT_THE_END = "at the end of the logs"
Rows = Sequence[Mapping]


@dataclass(frozen=True, eq=False, slots=True)
class Look:
    """All that the pages need of a store, as the rows of `questions`, latest first."""

    opened: Store
    diagnoses: Rows
    proposals: Rows
    watched: Rows
    refused: Rows
    adoptions: Rows
    models: Rows
    runs: Rows

    @property
    def robots(self) -> tuple[str, ...]:
        """Names of all robots that anything is stored of."""
        kept = (*self.runs, *self.models, *self.adoptions, *self.watched)
        names = {row["robot"] for row in (*kept, *self.diagnoses)}
        return tuple(sorted(name for name in names if name))

    @property
    def nights(self) -> tuple[date, ...]:
        """Every night with a diagnosis, a watch or a refused log, latest first."""
        ended = (*self.diagnoses, *self.watched, *self.refused)
        return tuple(sorted({night_of(row["created"]) for row in ended}, reverse=True))

    def words(self, diagnosis: str) -> tuple[str, str]:
        """Return what a diagnosis names, and its errors, in words."""
        return _words(self.opened.path, diagnosis)

    def sentence(self, diagnosis: str) -> str:
        """Return both together."""
        return ", ".join(filter(None, self.words(diagnosis)))

    def state(self, each: Mapping) -> str:
        """Return the verdict of a diagnosis; "values" where only values were off."""
        off = each["verdict"] == "none" and self.words(each["id"])[0] == VALUES_OFF
        return "values" if off else each["verdict"]

    def runs_of(self, diagnosis: str) -> frozenset[str]:
        """Return the ids of the runs that a diagnosis speaks of."""
        rows = self.ask(questions.RUNS_OF, id=diagnosis)
        return frozenset(row["id"] for row in rows)

    def ask(self, query: str, **values: object) -> Rows:
        """Return the rows of one more query."""
        return ask(self.opened, query, **values)


def look(opened: Store) -> Look:
    """Read what a store holds; what is damaged is left out."""
    names = [field.name for field in fields(Look) if field.name != "opened"]
    rows = {name: ask(opened, getattr(questions, name.upper())) for name in names}
    return Look(opened, **rows)


def ask(opened: Store, query: str, **values: object) -> list[dict]:
    """Return the rows of a query, of what is whole."""
    table = opened.sql(query, values or None, without_damaged=True)
    return table.to_pylist()


def title_of(store: Path, diagnosis: str) -> str:
    """Return robot and number of a diagnosis, as "irb140 #2"."""
    with open_store(store) as opened:
        (row,) = ask(opened, questions.TITLE, id=diagnosis)
    return f"{row['robot']} #{row['number']}"


def night_of(when: datetime) -> date:
    """Return the night that a time belongs to, called after its morning.

    From noon to noon UTC, so that one night is one page.
    """
    return (when + _HALF_A_DAY).date()


def span_of(night: date) -> tuple[datetime, datetime]:
    """Return from when to when a night goes, UTC."""
    noon = datetime.combine(night, time(12))
    return noon - timedelta(days=1), noon


# A record never changes, and reading one takes longer than making a page of it.
@lru_cache(maxsize=4096)
def _words(store: Path, diagnosis: str) -> tuple[str, str]:
    try:
        verdict = read_verdict(store, diagnosis)
        pair = errors(verdict)
        # Of the end of a log that was fitted up to there no log was held out.
        own = f"{pair} {AT_THE_END}" if verdict.error.same_run else pair
        return finding(verdict), own if pair else ""
    except InputError:
        return "its record cannot be read", ""


@dataclass(frozen=True, slots=True)
class FlowRun:
    """A flow run.

    Attributes:
        id: Its id.
        name: Its name.
        state: Type of its state, such as COMPLETED, FAILED, CRASHED, PAUSED.
        begun: When it was begun, or was to begin; UTC without a zone.
        seconds: How long it took [s].
        message: What its state says; "" for nothing.
    """

    id: str
    name: str
    state: str
    begun: datetime
    seconds: float
    message: str = ""

    @property
    def failed(self) -> bool:
        """Whether it ended, and not as it should have."""
        return self.state in ("FAILED", "CRASHED")


@dataclass(frozen=True, slots=True)
class History:
    """The flow runs of some time.

    Attributes:
        runs: Which, latest first.
        warnings: Name of the flow run and what it warned of, the first one first.
    """

    runs: tuple[FlowRun, ...] = ()
    warnings: tuple[tuple[str, str], ...] = ()


# From when, to when [UTC]; None where no server answers.
Past = Callable[[datetime, datetime], History | None]


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
        has_report: Whether a record of reports has a file of that name.
    """

    up: str
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

    def diagnosis(self, each: Mapping) -> str:
        """Return the address of the report of a diagnosis."""
        return self.report(each["report_id"], each["id"])

    def index(self, robot: str | None = None, kind: str = "any", part: int = 1) -> str:
        """Return the address of the index of all reports, or a part of it."""
        if (robot, kind, part) == (None, "any", 1):
            return f"{self.up}index.html"
        more = f"-{part}" if part > 1 else ""
        return f"{self.up}reports/{slug(robot) if robot else ALL}/{kind}{more}.html"

    def flow_run(self, id: str) -> str:
        """Return the address of a flow run at Prefect."""
        return f"/runs/flow-run/{id}"


def coloured(state: str, words: str) -> Markup:
    """Return words in the colour of a verdict."""
    return tag("span", words, f"of {state}")
