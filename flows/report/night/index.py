"""The index of all reports: nights, diagnoses, decisions, studies, models."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from flows.report.night.look import KINDS, Look, Place, ask, span_of
from flows.report.page import Made, made_of
from flows.report.records import record_lines
from residual.errors import InputError, shortened
from warehouse.layout import find, read_record
from warehouse.query.store import Store
from warehouse.runs import tombstone
from warehouse.verify import other_files

PART = 200  # entries on one page
# What reports of several diagnoses are called, and their page.
_STUDIES = {
    "blind": ("blind study", "report.html"),
    "close": ("loop closed by itself", "close.html"),
}


@dataclass(frozen=True, slots=True)
class Entry:
    """One line of the index.

    Attributes:
        created: When, UTC.
        kind: One of `place.KINDS`; a diagnosis is of the kind of its verdict.
        robot: Name of the robot; None where it is of several.
        what: What it is, such as "diagnosis".
        title: What the link says.
        href: Its address.
        diagnosis: Id of the diagnosis whose words stand beside it, None for none.
    """

    created: datetime
    kind: str
    robot: str | None
    what: str
    title: str
    href: str
    diagnosis: str | None = None


def entries(look: Look, place: Place) -> list[Entry]:
    """Return all entries, the latest first."""
    found = [*_nights(look, place), *_diagnoses(look, place), *_others(look, place)]
    return sorted(found, key=lambda e: (e.created, e.title), reverse=True)


def narrowed(found: list[Entry], robot: str | None, kind: str) -> list[Entry]:
    """Return the entries of one robot and one kind; None and "any" are all."""
    return [
        e
        for e in found
        if (robot is None or e.robot == robot) and kind in ("any", e.kind)
    ]


def parts(count: int) -> int:
    """Return on how many pages so many entries are."""
    return max(1, -(-count // PART))


def context(
    look: Look, place: Place, robot: str | None = None, kind: str = "any", part: int = 1
) -> dict:
    """Return what the template `index.html` is filled with.

    Args:
        robot: Name of the robot to which it is narrowed; None for all.
        part: Which page of it, from 1.
    """
    everything = entries(look, place)
    of_robot = narrowed(everything, robot, "any")
    found = narrowed(of_robot, None, kind)
    shown = found[PART * (part - 1) : PART * part]
    counts = {k: len(narrowed(of_robot, None, k)) for k in KINDS}
    return {
        "title": f"modelgap: {robot or 'all'} reports",
        "robot": robot,
        "kind": kind,
        "kinds": [(k, words, counts[k]) for k, words in KINDS.items() if counts[k]],
        "count": len(found),
        "part": part,
        "last": parts(len(found)),
        "rows": [(e, _words(look, e)) for e in shown],
    }


def _words(look: Look, entry: Entry) -> str:
    if entry.diagnosis is None:
        return ""
    return ", ".join(filter(None, look.words(entry.diagnosis)))


def _nights(look: Look, place: Place) -> Iterator[Entry]:
    for night in look.nights:
        inside = [d for d in look.diagnoses if _inside(d.created, night)]
        at = max((d.created for d in inside), default=span_of(night)[0])
        title = f"night to {night:%Y-%m-%d}"
        yield Entry(at, "night", None, "night", title, place.night(night))


def _inside(when: datetime, night) -> bool:
    begin, end = span_of(night)
    return begin <= when < end


def _diagnoses(look: Look, place: Place) -> Iterator[Entry]:
    for each in look.diagnoses:
        yield Entry(
            each.created,
            each.verdict,
            each.robot,
            "diagnosis",
            each.title,
            place.report(each.report, each.id),
            each.id,
        )


def _others(look: Look, place: Place) -> Iterator[Entry]:
    titles = {each.id: each.title for each in look.diagnoses}
    for row in look.proposals:
        whose = titles.get(row["id"], row["robot"])
        title = f"{whose}: {'waits' if row['waits'] else 'answered'}"
        href = place.report(row["report_id"], row["id"], "proposal.html")
        yield Entry(row["created"], "proposal", row["robot"], "decision", title, href)
    for row in look.studies:
        title, file = _STUDIES[row["kind"]]
        href = place.report(row["id"], row["id"], file)
        title = f"{row['robot']}: {title}"
        yield Entry(row["created"], "study", row["robot"], "study", title, href)
    for row in look.models:
        title = f"{row['robot']}: {row['stage']} model {row['id'][:8]}"
        href = place.record(row["id"])
        yield Entry(row["created"], "model", row["robot"], "model", title, href)


_RECORD_LINES = 150  # of what it says; the whole is `modelgap show`
_MOST = 60  # relatives that are listed

_PARENTS = "SELECT parent AS id, role FROM lineage WHERE child = $id ORDER BY role, id"
_CHILDREN = "SELECT child AS id, role FROM lineage WHERE parent = $id ORDER BY role, id"
_ERRORS = """
    SELECT stage, metric, joint, value FROM errors
    WHERE source_id = $id AND run_id IS NULL ORDER BY metric, stage, joint
"""


def record_context(opened: Store, id: str, place: Place) -> dict:
    """Return what the template `record.html` is filled with.

    Raises:
        InputError: If there is no such record, or it is damaged.
    """
    made = made_of(opened.path, id)
    content = read_record(opened.path, made.id)
    lines = record_lines(content)
    return {
        "title": f"modelgap: {made.what} {made.id}",
        "made": made,
        "about": _about(content),
        "lines": [shortened(line) for line in lines[:_RECORD_LINES]],
        "lines_left": len(lines) - _RECORD_LINES,
        "errors": _table(ask(opened, _ERRORS, id=made.id)),
        "parents": _linked(ask(opened, _PARENTS, id=made.id), opened.path),
        "children": _linked(ask(opened, _CHILDREN, id=made.id), opened.path),
        "pages": _pages(opened.path, made, place),
        "quarantined": tombstone(opened.path, made.id) if made.what == "run" else None,
    }


def _pages(store: Path, made: Made, place: Place) -> list[str]:
    """Return the addresses of the pages that a report has."""
    if made.what != "report":
        return []
    names = other_files(find(store, made.id))
    return [
        place.report(made.id, made.id, name) for name in names if name.endswith(".html")
    ]


def _about(content: Mapping) -> list[tuple[str, str]]:
    """Return the plain values of a record that say what it is."""
    keys = ("robot", "serial", "kind", "stage", "verdict", "source", "seed", "note")
    told = [(key, content.get(key)) for key in keys]
    return [(key, shortened(v)) for key, v in told if isinstance(v, str | int)]


def _table(rows: Sequence[Mapping]) -> dict | None:
    """Return errors as a table: a row per metric and stage, a column per joint."""
    joints = sorted({row["joint"] for row in rows if row["joint"]})
    if not rows:
        return None
    cells: dict[tuple[str, str], dict] = {}
    for row in rows:
        cells.setdefault((row["metric"], row["stage"]), {})[row["joint"]] = row["value"]
    lines = [
        (*key, [values.get(joint) for joint in (*joints, None)])
        for key, values in cells.items()
    ]
    return {"joints": joints, "lines": lines}


def _linked(rows: Sequence[Mapping], store: Path) -> dict:
    """Return relatives, and which of them this store has."""
    shown = [(row["id"], row["role"], _is_here(store, row["id"])) for row in rows]
    return {"rows": shown[:_MOST], "left": len(shown) - _MOST}


def _is_here(store: Path, id: str) -> bool:
    try:
        return bool(find(store, id))
    except InputError:
        return False
