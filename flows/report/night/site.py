"""All pages over a store by their address, made when a server is asked for one.

An address is taken apart by patterns; nothing of it is ever joined to a path but an id
of hex digits, and a file name that a record of the store has.
"""

import re
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime
from pathlib import Path
from threading import Lock

from flows.report.document import Document, link
from flows.report.night import index, night, robot
from flows.report.night.look import (
    ALL,
    KINDS,
    LATEST,
    Look,
    Past,
    Place,
    look,
    slug,
    span_of,
)
from flows.report.page import render
from residual.errors import InputError
from warehouse.files import check_file
from warehouse.ids import ID_DIGITS, record_folder
from warehouse.layout import find
from warehouse.provenance import version_text
from warehouse.query.store import Store, open_store
from warehouse.remote import bucket_of
from warehouse.verify import other_files

_ID = f"[0-9a-f]{{6,{ID_DIGITS}}}"
_FIRST = re.compile(r"(?:index\.html)?")
_NIGHT = re.compile(rf"night/({LATEST}|\d{{4}}-\d{{2}}-\d{{2}})\.html")
_ROBOT = re.compile(r"robot/([a-z0-9_-]{1,40})\.html")
_RECORD = re.compile(rf"record/({_ID})\.html")
_INDEX = re.compile(
    rf"reports/([a-z0-9_-]{{1,40}})/({'|'.join(KINDS)})(?:-([1-9]\d{{0,5}}))?\.html"
)
_STORED = re.compile(rf"report/([0-9a-f]{{{ID_DIGITS}}})/([\w-][\w.-]{{0,60}})")
_LINKED = 8  # robots that every page leads to
_TYPES = {
    ".html": "text/html; charset=utf-8",
    ".json": "application/json",
    ".gif": "image/gif",
    ".png": "image/png",
}


@dataclass(frozen=True, slots=True)
class Answer:
    """What is at an address.

    Attributes:
        body: Its content.
        type: Its media type.
        stored: Whether it was read from a record, and not made now: it may be of
            another store and another author.
    """

    body: bytes
    type: str = _TYPES[".html"]
    stored: bool = False


@dataclass(frozen=True, eq=False, slots=True)
class Site:
    """The pages over one store.

    Attributes:
        store: Its folder.
        past: What tells of flow runs.
    """

    store: Path
    past: Past
    # Opening a store takes as long as a page of it; it sees what is stored meanwhile.
    _kept: list[Store] = field(default_factory=list, repr=False)
    _one: Lock = field(default_factory=Lock, repr=False)

    def answer(self, address: str) -> Answer | None:
        """Return what is at an address below the first folder; None for nothing.

        Args:
            address: Such as "night/latest.html".
        """
        try:
            with self._one:
                return self._stored(address) or self._page(address)
        except InputError:
            return None

    def _open(self) -> Store:
        if not self._kept:
            self._kept.append(open_store(self.store))
        return self._kept[0]

    def _stored(self, address: str) -> Answer | None:
        match = _STORED.fullmatch(address)
        if not match:
            return None
        found = find(self.store, match[1])
        path = other_files(found).get(match[2]) if found.kind == "reports" else None
        kind = _TYPES.get(Path(match[2]).suffix)
        if path is None or kind is None:
            return None
        check_file(path)
        return Answer(path.read_bytes(), kind, stored=True)

    def _page(self, address: str) -> Answer | None:
        place = Place("../" * address.count("/"), self._has_report)
        if match := _RECORD.fullmatch(address):
            return self._made(index.record(self._open(), match[1], place), place)
        seen = look(self._open())
        page = self._document(address, seen, place)
        return page and self._made(page, place, seen)

    def _document(self, address: str, seen: Look, place: Place) -> Document | None:
        if _FIRST.fullmatch(address):
            return index.document(seen, place)
        if match := _ROBOT.fullmatch(address):
            return robot.document(seen, _named(seen, match[1]), place)
        if match := _INDEX.fullmatch(address):
            name = None if match[1] == ALL else _named(seen, match[1])
            return index.document(seen, place, name, match[2], int(match[3] or 1))
        if match := _NIGHT.fullmatch(address):
            return self._night(match[1], seen, place)
        return None

    def _night(self, word: str, seen: Look, place: Place) -> Document | None:
        try:
            last = seen.nights[0] if seen.nights else datetime.now(UTC).date()
            which = last if word == LATEST else date.fromisoformat(word)
            told = self.past(*span_of(which))
        except (ValueError, OverflowError):  # no day of any calendar
            return None
        return night.document(seen, which, told, place)

    def _made(self, page: Document, place: Place, seen: Look | None = None) -> Answer:
        """Return a page with the links that all have, and where it is from."""
        robots = seen.robots[:_LINKED] if seen else ()
        links = [
            link(place.night(), "last night"),
            link(place.index(), "all reports"),
            *(link(place.robot(name), name) for name in robots),
            link("/", "flows"),
        ]
        read = f"{datetime.now(UTC):%Y-%m-%d %H:%M:%S} UTC by modelgap {version_text()}"
        foot = [("Store", self.store.name), ("Read", read)]
        page = replace(page, links=links, foot=page.foot or foot)
        return Answer(render(page).encode())

    def _has_report(self, id: str, file: str) -> bool:
        # Of a bucket no file is asked for before somebody opens it.
        if bucket_of(self.store) is not None:
            return True
        return (record_folder(self.store, "reports", id) / file).is_file()


def _named(seen: Look, word: str) -> str:
    """Return the robot whose part of an address that is."""
    for name in seen.robots:
        if slug(name) == word:
            return name
    raise InputError(f"There is no robot {word} in {seen.opened.path}.")
