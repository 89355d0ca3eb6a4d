"""What a store holds, as the rows that pages are made of."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import date, datetime, time, timedelta
from functools import lru_cache
from pathlib import Path

from flows.report.night import questions
from flows.report.words import brief
from flows.storage.diagnosis import read_verdict
from residual.errors import InputError
from warehouse.query.store import Store, open_store

_HALF_A_DAY = timedelta(hours=12)
Rows = Sequence[Mapping]


@dataclass(frozen=True, slots=True)
class Diagnosed:
    """One diagnosis in a list.

    Attributes:
        id: Its id.
        robot: Name of its robot.
        number: Its number among the diagnoses of that robot, from 1.
        created: When it was stored, UTC.
        verdict: effects, none or unknown.
        before: Held-out error of the model that the robot had, all joints [%].
        after: The same with what was found [%].
        report: Id of its report; None where none was stored.
        model: Number of the adoption that it went by; None for the nominal model.
    """

    id: str
    robot: str
    number: int
    created: datetime
    verdict: str
    before: float | None
    after: float | None
    report: str | None
    model: int | None

    @property
    def title(self) -> str:
        """Robot and number, as in the names of flow runs."""
        return f"{self.robot} #{self.number}"


@dataclass(frozen=True, eq=False, slots=True)
class Look:
    """All that the pages need of a store, read when they are asked for.

    Attributes:
        opened: The store.
        diagnoses: Latest first, as all lists.
        proposals: Keys as in `questions.PROPOSALS`.
        watched: Monitorings with the number of their alarms.
        adoptions: Which robot got which model.
        studies: Reports of blind studies.
        models: Models that were identified, calibrated or adopted.
        runs: All runs.
    """

    opened: Store
    diagnoses: tuple[Diagnosed, ...]
    proposals: Rows
    watched: Rows
    adoptions: Rows
    studies: Rows
    models: Rows
    runs: Rows

    @property
    def robots(self) -> tuple[str, ...]:
        """Names of all robots that anything is stored of."""
        kept = (*self.runs, *self.models, *self.adoptions, *self.watched)
        names = {row["robot"] for row in kept} | {d.robot for d in self.diagnoses}
        return tuple(sorted(name for name in names if name))

    @property
    def nights(self) -> tuple[date, ...]:
        """Every night in which something was diagnosed or watched, latest first."""
        ended = [d.created for d in self.diagnoses]
        ended += [row["created"] for row in self.watched]
        return tuple(sorted({night_of(when) for when in ended}, reverse=True))

    def words(self, diagnosis: str) -> tuple[str, str]:
        """Return what a diagnosis names, and its errors, in words."""
        return _words(self.opened.path, diagnosis)

    def ask(self, query: str, **values: object) -> Rows:
        """Return the rows of one more query."""
        return ask(self.opened, query, **values)


def look(opened: Store) -> Look:
    """Read what a store holds; what is damaged is left out."""
    rows = {
        name: ask(opened, getattr(questions, name.upper()))
        for name in ("proposals", "watched", "adoptions", "studies", "models", "runs")
    }
    found = ask(opened, questions.DIAGNOSES)
    return Look(opened, tuple(map(_diagnosed, found)), **rows)


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


def _diagnosed(row: Mapping) -> Diagnosed:
    kept = {k: v for k, v in row.items() if k not in ("report_id", "adoption")}
    model = int(row["adoption"]) if row["adoption"] else None
    kept["robot"] = row["robot"] or "?"
    return Diagnosed(**kept, report=row["report_id"], model=model)


# A record never changes, and reading one takes longer than making a page of it.
@lru_cache(maxsize=4096)
def _words(store: Path, diagnosis: str) -> tuple[str, str]:
    try:
        verdict = read_verdict(store, diagnosis)
        return brief.finding(verdict), brief.errors(verdict)
    except InputError:
        return "its record cannot be read", ""
