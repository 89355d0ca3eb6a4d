"""A log file as named columns, and when it was recorded: what it says, and no guess.

The date of the file itself is not asked: copying changes it.
"""

import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta

from residual.errors import InputError
from residual.recording import Array

# No clock that is set says less, and no log is of after it.
_EARLIEST, _LATEST = datetime(2000, 1, 1, tzinfo=UTC), datetime(2100, 1, 1, tzinfo=UTC)
_STAMP = re.compile(
    r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d(:\d\d([.,]\d+)?)?\s?(Z|[+-]\d\d:?\d\d)?"
)
FIELD = "recorded_at"  # what the metadata of a Parquet file may say


def from_seconds(seconds: float) -> datetime | None:
    """Return the moment that a clock of seconds since 1970 shows, UTC.

    Args:
        seconds: What it shows [s].

    Returns:
        The moment; None where the clock counts from elsewhere, as from being turned on.
    """
    if not _EARLIEST.timestamp() <= seconds < _LATEST.timestamp():
        return None
    return datetime.fromtimestamp(seconds, UTC)


def from_lines(lines: Iterable[str]) -> tuple[datetime | None, str | None]:
    """Return the first moment in lines above a table, UTC; or one that says no zone."""
    for line in lines:
        if found := _STAMP.search(line):
            moment = _parsed(found[0])
            return (moment, None) if moment else (None, found[0])
    return None, None


def parse(text: str, what: str) -> datetime:
    """Return a moment that a user gave, in ISO 8601 with a zone."""
    moment = _parsed(text)
    if moment is None or not _EARLIEST <= moment < _LATEST:
        raise InputError(
            f"{what} '{text[:40]}': expected a date with time and zone, such as "
            "2026-11-20T14:03:00+01:00, or with Z for UTC."
        )
    return moment


def later(moment: datetime, seconds: float) -> datetime:
    """Return the moment some seconds later."""
    return moment + timedelta(seconds=float(seconds))


def iso(moment: datetime | None) -> str | None:
    """Return a moment as records have it: ISO 8601 in UTC, None for none."""
    if moment is None:
        return None
    return moment.astimezone(UTC).isoformat().replace("+00:00", "Z")


def _parsed(text: str) -> datetime | None:
    try:
        moment = datetime.fromisoformat(text.strip().replace(",", "."))
    except ValueError:
        return None
    return moment.astimezone(UTC) if moment.tzinfo else None


class LogFile(ABC):
    """An opened log file.

    Attributes:
        name: File name, as messages begin.
        columns: Names of all columns.
        units: Units that the file itself states, by column.
        notes: What was understood of the file, in words.
        recorded_at: When its first sample was taken, UTC; None where it does not say.
    """

    name: str
    columns: tuple[str, ...]
    units: Mapping[str, str] = {}
    notes: tuple[str, ...] = ()
    recorded_at: datetime | None = None

    @abstractmethod
    def read(self, columns: tuple[str, ...]) -> dict[str, Array]:
        """Return the values of some columns, NaN where empty."""
