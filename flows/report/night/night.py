"""The page of a night: every robot, what changed, what waits, what failed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime

from markupsafe import Markup

from flows.report.document import (
    Callout,
    Card,
    Document,
    Fold,
    Note,
    Part,
    Section,
    Table,
    Tile,
    link,
    tag,
    when,
)
from flows.report.night.look import (
    AT_THE_END,
    FlowRun,
    History,
    Look,
    Place,
    coloured,
    night_of,
    span_of,
)
from flows.report.words.phrases import listing, many, sentence_case, texts
from residual.quantity import MISSING, bare_percent, percent

_TEXT = texts()["night"]

# Worst first: what an engineer reads before the coffee is cold.
STATES = {
    "effects": "something missing",
    "unknown": "unknown",
    "values": "values off",
    "other": "not diagnosed",
    "none": "nothing missing",
}
_OFF = ("effects", "unknown")
_MOST = 3  # names in a headline
_CARDS = 8  # robots; more stand in a table
_EARLIER = 20  # diagnoses of one robot in one night


@dataclass(frozen=True, slots=True)
class Report:
    """What a night says of one robot, in words.

    Attributes:
        title: Its name, and the number of its last diagnosis.
        state: One of STATES.
        errors: Held-out error before and after.
        model: What became of its model.
        runs: Number of runs that were stored.
        href: Address of the report of the last diagnosis, None for none.
        warned: What the flow of the last diagnosis warned of.
        earlier: The other diagnoses of the night.
    """

    robot: str
    title: str
    state: str
    words: str
    errors: str
    model: str
    alarms: str
    runs: int
    href: str | None
    warned: tuple[str, ...] = ()
    earlier: tuple[Mapping, ...] = ()


def document(look: Look, night: date, past: History | None, place: Place) -> Document:
    """Return the page of a night.

    Args:
        past: Flow runs of that time; None where no server answers.
    """
    inside = _Night(look, night, place, past.warnings if past else ())
    reports = inside.reports()
    failed = [run for run in past.runs if run.failed] if past else []
    refused, waiting = inside.rows(look.refused), _waiting(look, past)
    warned = {words for each in reports for words in each.warned}
    return Document(
        title=f"modelgap: night to {night:%d %B %Y}",
        about=_span(look, night, place),
        headline=headline(reports, len(failed), len(refused)),
        tiles=_tiles(reports, len(refused), len(waiting), failed if past else None),
        callouts=(
            Callout("What failed", [_failed(run, place) for run in failed]),
            Callout(
                "Logs that were refused",
                [
                    Markup("{}: {}").format(
                        row["robot"], link(place.record(row["id"]), row["why"])
                    )
                    for row in refused
                ],
            ),
            Callout(
                "Waits for your decision",
                [_question(row, run, reports, inside) for row, run in waiting],
                warn=False,
            ),
        ),
        sections=(
            Section("robots", "Robots", _robots(reports, look, place), shown=False),
            _adopted(inside),
            _flows(past, warned, place),
        ),
    )


def _span(look: Look, night: date, place: Place) -> Markup:
    begin, end = span_of(night)
    so_far = ", not over yet" if datetime.now(UTC).replace(tzinfo=None) < end else ""
    span = f"({begin:%d %b %H:%M} to {end:%d %b %H:%M} UTC{so_far})"
    words = [Markup("The night to <b>{}</b> {}").format(f"{night:%A, %d %B %Y}", span)]
    before = next((n for n in look.nights if n < night), None)
    after = next((n for n in reversed(look.nights) if n > night), None)
    words += [link(place.night(before), "night before")] if before else []
    words += [link(place.night(after), "night after")] if after else []
    return Markup(" · ").join(words)


def headline(reports: Sequence[Report], failed: int, refused: int = 0) -> str:
    """Return a night in one sentence, and what of its logs and flows was not taken."""
    off = [each for each in reports if each.state in _OFF]
    off = off or [each for each in reports if each.state == "values"]
    seen = [each for each in reports if each.state != "other"]
    end = f" {many(refused, 'log')} {'was' if refused == 1 else 'were'} refused."
    end = (end if refused else "") + (
        f" {many(failed, 'flow')} failed." if failed else ""
    )
    if not seen:
        return f"No robot was diagnosed.{end}"
    if not off:
        who = seen[0].robot if len(seen) == 1 else f"{len(seen)} robots"
        return f"Nothing is missing on {who}.{end}"
    if len(off) == 1:
        one = off[0]
        words = ", ".join(filter(None, (one.words, one.errors)))
        rest = f" ({len(seen) - 1} others: no effect missing)" if len(seen) > 1 else ""
        return f"{one.title}: {words}{rest}.{end}"
    names = [each.robot for each in off[:_MOST]]
    names += [f"{len(off) - _MOST} more"] if len(off) > _MOST else []
    what = "have values off" if off[0].state == "values" else "lack something"
    return f"{len(off)} of {len(seen)} robots {what}: {listing(names)}.{end}"


@dataclass(frozen=True, eq=False, slots=True)
class _Night:
    look: Look
    night: date
    place: Place
    warnings: Sequence[tuple[str, str]]

    def rows(self, rows: Sequence[Mapping]) -> list[Mapping]:
        """Return those of some rows that are of the night."""
        return [row for row in rows if night_of(row["created"]) == self.night]

    def reports(self) -> list[Report]:
        """Return what is said of each robot, worst first."""
        found: dict[str, list[Mapping]] = {}
        for each in self.look.diagnoses:
            if night_of(each["created"]) == self.night:
                found.setdefault(each["robot"], []).append(each)
        names = {row["robot"] for row in self.rows(self.look.watched)}
        names |= {row["robot"] for row in self.rows(self.look.runs)}
        every = [self._report(name, found.get(name, [])) for name in {*found, *names}]
        order = [*STATES]
        return sorted(every, key=lambda one: (order.index(one.state), one.robot))

    def _report(self, robot: str, found: Sequence[Mapping]) -> Report:
        last = found[0] if found else None
        words, errors = self.look.words(last["id"]) if last else ("", "")
        state = self.look.state(last) if last else "other"
        # Those whose models wait stand among what waits.
        asked = {row["id"] for row in self.look.proposals if row["waits"]}
        return Report(
            robot=robot,
            title=last["title"] if last else robot,
            state=state if state in STATES else "other",
            words=words or "new runs, no diagnosis",
            errors=errors,
            model=self._model(robot, last),
            alarms=self._alarms(robot, last),
            runs=sum(row["robot"] == robot for row in self.rows(self.look.runs)),
            href=self.place.diagnosis(last) if last else None,
            warned=self._warned(last) if last else (),
            earlier=tuple(each for each in found[1:] if each["id"] not in asked),
        )

    def _warned(self, last: Mapping) -> tuple[str, ...]:
        # The name of its flow run begins with its title.
        own = f"{last['title']}: "
        return tuple(words for name, words in self.warnings if name.startswith(own))

    def _alarms(self, robot: str, last: Mapping | None) -> str:
        """Return the alarms of a robot in one line, whatever their number.

        Those of runs that a verdict with findings speaks of have their cause in it.
        """
        rows = [r for r in self.rows(self.look.watched) if r["robot"] == robot]
        if not any(row["alarms"] for row in rows):
            return "no alarm" if rows else "not watched"
        named = last is not None and last["verdict"] == "effects"
        known = self.look.runs_of(last["id"]) if named else frozenset()
        alarmed = {run for row in rows for run in row["alarmed"] or ()}
        told = f"alarms in {many(len(alarmed), 'run')}"
        if alarmed <= known:
            return f"{told}, which this verdict explains"
        open_ = [row for row in rows if not set(row["alarmed"] or ()) <= known]
        what = sorted({words for row in open_ for words in row["what"] or ()})
        more = f" and {len(what) - _MOST} more" if len(what) > _MOST else ""
        some = ", ".join(what[:_MOST]) + more if more else listing(what)
        explained = many(len(alarmed & known), "run")
        rest = f" ({explained} of them this verdict explains)"
        return f"{told}{rest if alarmed & known else ''}: {some}"

    def _model(self, robot: str, last: Mapping | None) -> str:
        new = [r for r in self.rows(self.look.adoptions) if r["robot"] == robot]
        if new:
            return f"{new[0]['action']} (no. {int(new[0]['id'])})"
        waits = [p for p in self.look.proposals if p["robot"] == robot and p["waits"]]
        if waits:
            own = last is not None and waits[0]["id"] == last["id"]
            other = f"the model of {_title(self.look, waits[0])}"
            return f"{'its model' if own else other} waits for a decision"
        if last and last["model"]:
            return f"judged by its adopted model (no. {last['model']})"
        return "judged by the nominal model" if last else ""


def _waiting(look: Look, past: History | None) -> list[tuple[Mapping, FlowRun | None]]:
    """Return what waits for an answer, and the flow run that asks for it."""
    asking = {r.name.removeprefix("propose "): r for r in past.runs} if past else {}
    waiting = [(p, asking.get(p["id"])) for p in look.proposals if p["waits"]]
    return [(p, run) for p, run in waiting if not run or run.state != "COMPLETED"]


def _question(
    row: Mapping, run: FlowRun | None, reports: Sequence[Report], inside: _Night
) -> Markup:
    """What waits, and how it is answered; where Prefect asks for it, there."""
    title, place = _title(inside.look, row), inside.place
    page = place.report(row["report_id"], row["id"], "proposal.html")
    told = title in {each.title for each in reports}
    words = "" if told else f", {inside.look.sentence(row['id'])}"
    asks = place.flow_run(run.id) if run and run.state == "PAUSED" else None
    there = link(asks, "answer in Prefect") + " (Resume), or " if asks else ""
    return Markup("{}{}: {}{}").format(
        link(page, f"{title}, side by side"),
        words,
        there,
        tag("kbd", f"modelgap adopt {row['id'][:8]}"),
    )


def _title(look: Look, row: Mapping) -> str:
    """Return robot and number of the diagnosis that a proposal is of."""
    titles = (d["title"] for d in look.diagnoses if d["id"] == row["id"])
    return next(titles, row["robot"])


def _failed(run: FlowRun, place: Place) -> Markup:
    why = run.message or "without a word"
    return Markup("{}, {:%H:%M} UTC, {}: {}").format(
        _flow(run, place), run.begun, run.state.lower(), why
    )


def _flow(run: FlowRun, place: Place) -> Markup:
    return link(place.flow_run(run.id), run.name)


def _tiles(
    reports: Sequence[Report],
    refused: int,
    waiting: int,
    failed: Sequence | None,
) -> list[Tile]:
    seen = [each for each in reports if each.state != "other"]
    off = sum(each.state in _OFF for each in seen)
    alarms = [each.alarms for each in reports if each.alarms.startswith("alarms")]
    open_ = sum("verdict explains" not in words for words in alarms)
    told = "no server answers" if failed is None else "flow runs"
    count = MISSING if failed is None else str(len(failed))
    return [
        Tile("Robots diagnosed", str(len(seen)), f"{off} with something missing"),
        Tile("Alarms", str(len(alarms)), f"robots; {open_} without a cause"),
        Tile("Refused", str(refused), "logs of the inboxes"),
        Tile("Waiting", str(waiting), "for your decision"),
        Tile("Failed", count, told),
    ]


def _robots(reports: Sequence[Report], look: Look, place: Place) -> list[Part]:
    if len(reports) > _CARDS:
        heads = ("Robot", "Verdict", "Held-out error", "Alarms", "Model", "New runs")
        rows = [_row(each, place) for each in reports]
        return [
            Table(heads, rows, left=(0, 1, 3, 4), look="list"),
            Note(_TEXT["errors"]),
        ]
    if not reports:
        return [Note("Nothing was stored in this night.", "calm")]
    return [[_card(each, look, place) for each in reports]]


def _row(each: Report, place: Place) -> tuple[str, ...]:
    words = each.words
    if each.href:
        words = link(each.href, coloured(each.state, words))
    if each.earlier:
        words += tag("span", f" ({len(each.earlier)} earlier)", "soft")
    name = link(place.robot(each.robot), each.title)
    rest = (each.errors or MISSING, each.alarms, each.model or MISSING, str(each.runs))
    return (name, words, *rest)


def _card(each: Report, look: Look, place: Place) -> Card:
    parts: list[Part] = []
    if each.errors:
        pair = "refitted → with what was found"
        pair = "as given → refitted" if each.state == "values" else pair
        about = f"error: {pair}" if "→" in each.errors else "error"
        about = about if each.errors.endswith(AT_THE_END) else f"held-out {about}"
        parts += [Note(each.errors, "figure"), Note(about, "calm")]
    parts.append(f"{sentence_case(each.alarms)}. {many(each.runs, 'new run')}.")
    parts.append(f"{sentence_case(each.model)}." if each.model else None)
    parts += [Note(sentence_case(words)) for words in each.warned]
    links = [link(each.href, "Report")] if each.href else []
    links.append(link(place.robot(each.robot), f"All of {each.robot}"))
    parts.append(Markup(" · ").join(links))
    if each.earlier:
        lines = [
            link(place.diagnosis(one), one["title"]) + f": {look.sentence(one['id'])}"
            for one in each.earlier[:_EARLIER]
        ]
        rest = len(each.earlier) - _EARLIER
        more = [link(place.index(each.robot), f"and {rest} more")] if rest > 0 else []
        parts.append(Fold(f"{len(each.earlier)} earlier this night", [lines, *more]))
    heading = f"{each.title}: {each.words}"
    return Card(each.state, STATES[each.state], heading, parts)


def _adopted(inside: _Night) -> Section:
    lines = []
    for row in inside.rows(inside.look.adoptions):
        number = link(inside.place.record(row["id"]), f"No. {int(row['id'])}")
        words = f": {row['robot']}, {row['action']} by {row['who']}"
        if row["before"] is not None and row["after"] is not None:
            words += f", {bare_percent(row['before'])} → {percent(row['after'])}"
        lines.append(number + words + (f": {row['note']}" if row["note"] else ""))
    return Section("adopted", "Models that changed", [lines])


def _flows(past: History | None, warned: set[str], place: Place) -> Section:
    if past is None:
        return Section("flows", "Flow runs", [Note(_TEXT["not_shown"], "calm")])
    # What was warned of on a card is not said again.
    lines = [f"{name}: {words}" for name, words in past.warnings if words not in warned]
    parts: list[Part] = []
    if lines:
        parts.append(Fold(many(len(lines), "warning"), [lines], open=True))
    rows = [
        (_flow(run, place), run.state.lower(), when(run.begun), f"{run.seconds:.1f}")
        for run in past.runs
    ]
    heads = ("Flow run", "State", "Begun (UTC)", "Time [s]")
    table = Table(heads, rows or [("none", "", "", "")], left=(0, 1, 2))
    return Section("flows", "Flow runs", [*parts, table])
