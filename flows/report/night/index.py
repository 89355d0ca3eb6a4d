"""The index of all reports: nights, diagnoses, decisions, models."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import NamedTuple

from markupsafe import Markup

from flows.report.document import (
    Callout,
    Document,
    Fold,
    Note,
    Part,
    Section,
    Table,
    link,
    tag,
    when,
)
from flows.report.night.look import (
    KINDS,
    Look,
    Place,
    Rows,
    ask,
    coloured,
    night_of,
    span_of,
)
from flows.report.page import Made, made_of
from flows.report.records import record_lines
from flows.report.words.phrases import sentence_case
from residual.errors import InputError, shortened
from residual.quantity import number
from warehouse.layout import find, read_record
from warehouse.quarantine import tombstone
from warehouse.query.store import Store
from warehouse.verify import other_files

PART = 200  # entries on one page


class Entry(NamedTuple):
    """One line of the index: a diagnosis, whose words stand beside it, or another.

    Its kind is one of `look.KINDS`, of a diagnosis that of its verdict.
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


def document(
    look: Look, place: Place, robot: str | None = None, kind: str = "any", part: int = 1
) -> Document | None:
    """Return a page of the index; None where there is no such page.

    Args:
        robot: Name of the robot to which it is narrowed; None for all.
        part: Which page of it, from 1.
    """
    everything = [e for e in entries(look, place) if robot in (None, e.robot)]
    found = [e for e in everything if kind in ("any", e.kind)]
    last = max(1, -(-len(found) // PART))
    if part > last:
        return None
    shown = found[PART * (part - 1) : PART * part]
    counts = Counter(e.kind for e in everything) + Counter(any=len(everything))
    robots = {None: "all robots"} | {name: name for name in look.robots}
    kinds = {k: f"{words} ({counts[k]})" for k, words in KINDS.items() if counts[k]}
    parts: list[Part] = [
        _chips({w: place.index(r, kind) for r, w in robots.items()}, robots[robot]),
        _chips({w: place.index(robot, k) for k, w in kinds.items()}, kinds.get(kind)),
    ]
    if robot:
        parts.append(link(place.robot(robot), f"The page of {robot}"))
    parts.append(_table(look, shown) if shown else _nothing(look))
    parts.append(_turn(place, robot, kind, part, last))
    return Document(
        title=f"modelgap: {robot or 'all'} reports",
        about=Markup("Store <b>{}</b>").format(look.opened.path.name),
        headline=f"All reports of {robot}" if robot else "All reports",
        sections=(Section("all", "Reports", parts, shown=False),),
    )


def _chips(choices: Mapping[str, str], chosen: str | None) -> Note:
    """What it can be narrowed to, words and addresses; and what it is."""
    words = [tag("b", w) if w == chosen else link(to, w) for w, to in choices.items()]
    return Note(Markup(" ").join(words), "chips")


def _nothing(look: Look) -> Note:
    words = Markup("Nothing of that is in the store.")
    more = Markup(" <kbd>modelgap demo</kbd> or <kbd>modelgap up</kbd> make something.")
    return Note(words if look.robots else words + more, "calm")


def _table(look: Look, shown: Sequence[Entry]) -> Table:
    rows = []
    for e in shown:
        words = coloured(e.kind, look.sentence(e.diagnosis)) if e.diagnosis else ""
        rows.append((when(e.created), e.what, link(e.href, e.title), words))
    heads = ("When (UTC)", "What", "Report", "Verdict")
    return Table(heads, rows, left=range(4), named=2, look="list")


def _turn(
    place: Place, robot: str | None, kind: str, part: int, last: int
) -> Markup | None:
    """Where it goes on."""
    words = [f"Page {part} of {last}"]
    if part > 1:
        words.append(link(place.index(robot, kind, part - 1), "later ones"))
    if part < last:
        words.append(link(place.index(robot, kind, part + 1), "earlier ones"))
    return Markup(" · ").join(words) if last > 1 else None


def _nights(look: Look, place: Place) -> Iterator[Entry]:
    for night in look.nights:
        inside = [
            d["created"] for d in look.diagnoses if night_of(d["created"]) == night
        ]
        at = max(inside, default=span_of(night)[0])
        title = f"night to {night:%Y-%m-%d}"
        yield Entry(at, "night", None, "night", title, place.night(night))


def _diagnoses(look: Look, place: Place) -> Iterator[Entry]:
    for each in look.diagnoses:
        yield Entry(
            each["created"],
            each["verdict"],
            each["robot"],
            "diagnosis",
            each["title"],
            place.diagnosis(each),
            each["id"],
        )


def _others(look: Look, place: Place) -> Iterator[Entry]:
    titles = {each["id"]: each["title"] for each in look.diagnoses}
    for row in look.proposals:
        whose = titles.get(row["id"], row["robot"])
        title = f"{whose}: {'waits' if row['waits'] else 'answered'}"
        href = place.report(row["report_id"], row["id"], "proposal.html")
        yield Entry(row["created"], "proposal", row["robot"], "decision", title, href)
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


def record(opened: Store, id: str, place: Place) -> Document:
    """Return the page of any record.

    Raises:
        InputError: If there is no such record, or it is damaged.
    """
    made = made_of(opened.path, id)
    content = read_record(opened.path, made.id)
    what = sentence_case(made.what)
    gone = tombstone(opened.path, made.id) if made.what == "run" else None
    return Document(
        title=f"modelgap: {made.what} {made.id}",
        about=f"{what} of {made.created} UTC",
        headline=f"{what} {made.id}",
        lead=[_about(content)],
        callouts=[Callout("In quarantine", [gone])] if gone else (),
        sections=(
            Section("pages", "Pages", _pages(opened.path, made, place), shown=False),
            _errors(ask(opened, _ERRORS, id=made.id)),
            _linked("from", "Made from", _PARENTS, opened, made, place),
            _linked("to", "Made from it", _CHILDREN, opened, made, place),
            _content(content, made),
        ),
        foot=made.facts,
    )


def _pages(store: Path, made: Made, place: Place) -> list[Markup]:
    """The pages that a report has."""
    names = other_files(find(store, made.id)) if made.what == "report" else ()
    pages = [name for name in names if name.endswith(".html")]
    to = (place.report(made.id, made.id, name) for name in pages)
    return [link(address, "Open its page") for address in to]


def _about(content: Mapping) -> Markup:
    """The plain values of a record that say what it is."""
    keys = ("robot", "serial", "kind", "stage", "verdict", "source", "seed", "note")
    told = [(key, content.get(key)) for key in keys]
    words = [
        Markup("{}: <b>{}</b>").format(key, shortened(value))
        for key, value in told
        if isinstance(value, str | int)
    ]
    return Markup(", ").join(words)


def _errors(rows: Rows) -> Section:
    """Errors: a row per metric and stage, a column per joint."""
    joints = sorted({row["joint"] for row in rows if row["joint"]})
    cells: dict[tuple[str, str], dict] = {}
    for row in rows:
        cells.setdefault((row["metric"], row["stage"]), {})[row["joint"]] = row["value"]
    lines = [
        (*key, *(number(values.get(joint)) for joint in (*joints, None)))
        for key, values in cells.items()
    ]
    heads = ("Metric", "Model", *(f"J{joint}" for joint in joints), "all")
    table = [Table(heads, lines, left=(0, 1), look="") if rows else None]
    units = Markup("Units by metric: <kbd>modelgap sql --schema</kbd>")
    return Section("errors", "Errors", table, below=units)


def _linked(
    id: str, heading: str, query: str, opened: Store, made: Made, place: Place
) -> Section:
    """Relatives, and which of them this store has."""
    rows, own = ask(opened, query, id=made.id), opened.path
    lines = [_relative(row["id"], row["role"], own, place) for row in rows[:_MOST]]
    more = Markup("and {} more: <kbd>modelgap show {}</kbd>")
    below = more.format(len(rows) - _MOST, made.id) if len(rows) > _MOST else ""
    parts = [lines] if lines else [Note("nothing", "calm")]
    return Section(id, heading, parts, below=below)


def _relative(id: str, role: str, store: Path, place: Place) -> Markup:
    name, words = tag("kbd", id), Markup("{}: {}")
    here = link(place.record(id), name) if _is_here(store, id) else None
    return words.format(role.replace("_", " "), here or name + " (not in this store)")


def _is_here(store: Path, id: str) -> bool:
    try:
        return bool(find(store, id))
    except InputError:
        return False


def _content(content: Mapping, made: Made) -> Section:
    lines = record_lines(content)
    shown = [shortened(line) for line in lines[:_RECORD_LINES]]
    cut = len(lines) > len(shown)
    title = f"{len(shown)} lines" + (f", of {len(lines)}" if cut else "")
    rest = Note(Markup("All of it: <kbd>modelgap show {}</kbd>").format(made.id))
    parts = [Note("\n".join(shown), "lines"), rest if cut else None]
    return Section("all", "What it says", [Fold(title, parts)])
