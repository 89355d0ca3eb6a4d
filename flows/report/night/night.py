"""The page of a night: every robot, what changed, what waits, what failed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime

from flows.report.document import Tile
from flows.report.night.look import Diagnosed, History, Look, Place, night_of, span_of
from flows.report.words.phrases import listing

# Worst first: what an engineer reads before the coffee is cold.
_ORDER = {"effects": 0, "unknown": 1, "values": 2, "other": 3, "none": 4}
STATES = {
    "effects": "something missing",
    "unknown": "unknown",
    "values": "values off",
    "none": "nothing missing",
    "other": "not diagnosed",
}
_OFF = ("effects", "unknown")
_MOST = 3  # names in a headline


@dataclass(frozen=True, slots=True)
class Card:
    """What a night says of one robot.

    Attributes:
        robot: Its name.
        title: Its name, and the number of its last diagnosis.
        state: effects, unknown, values, none, or other where it was not diagnosed.
        words: What is missing.
        errors: Held-out error before and after, in words.
        model: What became of its model.
        alarms: Alarms of its sensors, in words.
        runs: Number of runs that were stored.
        href: Address of the report of the last diagnosis, None for none.
        warned: What the flow of the last diagnosis warned of.
        earlier: The other diagnoses of the night: title, words and address.
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
    earlier: tuple[tuple[str, str, str], ...] = ()

    @property
    def word(self) -> str:
        """Its state in words."""
        return STATES[self.state]

    @property
    def pair(self) -> str:
        """Of what its two errors are."""
        values = self.state == "values"
        return "as given → refitted" if values else "refitted → with what was found"


def context(look: Look, night: date, past: History | None, place: Place) -> dict:
    """Return what the template `night.html` is filled with.

    Args:
        past: Flow runs of that time; None where no server answers.
    """
    warnings = past.warnings if past else ()
    inside = _Night(look, night, place, warnings)
    cards = sorted(inside.cards(), key=lambda c: (_ORDER[c.state], c.robot))
    failed = [run for run in past.runs if run.failed] if past else []
    refused = inside.rows(look.refused)
    waiting = _waiting(look, past, place)
    begin, end = span_of(night)
    so_far = ", not over yet" if datetime.now(UTC).replace(tzinfo=None) < end else ""
    return {
        "title": f"modelgap: night to {night:%d %B %Y}",
        "night": f"{night:%A, %d %B %Y}",
        "span": f"{begin:%d %b %H:%M} to {end:%d %b %H:%M} UTC{so_far}",
        "headline": headline(cards, len(failed), len(refused)),
        "tiles": _tiles(cards, refused, waiting, failed if past else None),
        "cards": cards,
        "refused": refused,
        "told": {card.title for card in cards},
        "waiting": waiting,
        "adopted": inside.rows(look.adoptions),
        "failed": failed,
        "history": past,
        "warnings": [w for w in warnings if not any(w[1] in c.warned for c in cards)],
        "before": next((n for n in look.nights if n < night), None),
        "after": next((n for n in reversed(look.nights) if n > night), None),
    }


def headline(cards: Sequence[Card], failed: int, refused: int = 0) -> str:
    """Return a night in one sentence, and what of its logs and flows was not taken."""
    off = [card for card in cards if card.state in _OFF]
    off = off or [card for card in cards if card.state == "values"]
    seen = [card for card in cards if card.state != "other"]
    were = "1 log was" if refused == 1 else f"{refused} logs were"
    end = f" {were} refused." if refused else ""
    end += f" {failed} flow{'s' if failed > 1 else ''} failed." if failed else ""
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
    names = [card.robot for card in off[:_MOST]]
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

    def cards(self) -> list[Card]:
        look = self.look
        found: dict[str, list[Diagnosed]] = {}
        for each in look.diagnoses:
            if night_of(each.created) == self.night:
                found.setdefault(each.robot, []).append(each)
        names = {row["robot"] for row in self.rows(look.watched)}
        names |= {row["robot"] for row in self.rows(look.runs)}
        return [self._card(name, found.get(name, [])) for name in {*found, *names}]

    def _card(self, robot: str, found: Sequence[Diagnosed]) -> Card:
        last = found[0] if found else None
        words, errors = self.look.words(last.id) if last else ("", "")
        state = self.look.state(last) if last else "other"
        return Card(
            robot=robot,
            title=last.title if last else robot,
            state=state if state in STATES else "other",
            words=words or "new runs, no diagnosis",
            errors=errors,
            model=self._model(robot, last),
            alarms=self._alarms(robot, last),
            runs=sum(row["robot"] == robot for row in self.rows(self.look.runs)),
            href=self.place.report(last.report, last.id) if last else None,
            warned=self._warned(last) if last else (),
            earlier=tuple(
                (
                    each.title,
                    ", ".join(filter(None, self.look.words(each.id))),
                    self.place.report(each.report, each.id),
                )
                for each in found[1:]
                if each.id not in self._asked()
            ),
        )

    def _asked(self) -> set[str]:
        """Diagnoses whose models wait: they stand among what waits."""
        return {row["id"] for row in self.look.proposals if row["waits"]}

    def _warned(self, last: Diagnosed) -> tuple[str, ...]:
        # The name of its flow run begins with its title.
        own = f"{last.title}: "
        return tuple(words for name, words in self.warnings if name.startswith(own))

    def _alarms(self, robot: str, last: Diagnosed | None) -> str:
        """Return the alarms of a robot in one line, whatever their number.

        Those of runs that a verdict with findings speaks of have their cause in it.
        """
        rows = [r for r in self.rows(self.look.watched) if r["robot"] == robot]
        if not any(row["alarms"] for row in rows):
            return "no alarm" if rows else "not watched"
        named = last is not None and last.verdict == "effects"
        known = self.look.runs_of(last.id) if named else frozenset()
        alarmed = {run for row in rows for run in row["alarmed"] or ()}
        told = f"alarms in {_runs(len(alarmed))}"
        if alarmed <= known:
            return f"{told}, which this verdict explains"
        open_ = [row for row in rows if not set(row["alarmed"] or ()) <= known]
        what = sorted({words for row in open_ for words in row["what"] or ()})
        more = f" and {len(what) - _MOST} more" if len(what) > _MOST else ""
        some = ", ".join(what[:_MOST]) + more if more else listing(what)
        explained = len(alarmed & known)
        rest = f" ({_runs(explained)} of them this verdict explains)"
        return f"{told}{rest if explained else ''}: {some}"

    def _model(self, robot: str, last: Diagnosed | None) -> str:
        new = [r for r in self.rows(self.look.adoptions) if r["robot"] == robot]
        if new:
            return f"{new[0]['action']} (no. {int(new[0]['id'])})"
        waits = [p for p in self.look.proposals if p["robot"] == robot and p["waits"]]
        if waits:
            own = last is not None and waits[0]["id"] == last.id
            whose = (
                "its model" if own else f"the model of {_title(self.look, waits[0])}"
            )
            return f"{whose} waits for a decision"
        if last and last.model:
            return f"judged by its adopted model (no. {last.model})"
        return "judged by the nominal model" if last else ""


def _waiting(look: Look, past: History | None, place: Place) -> list[dict]:
    """Return what waits for an answer; where Prefect asks for it, there."""
    asking = {r.name.removeprefix("propose "): r for r in past.runs} if past else {}
    out = []
    for row in look.proposals:
        run = asking.get(row["id"])
        if not row["waits"] or (run and run.state == "COMPLETED"):
            continue
        words = ", ".join(filter(None, look.words(row["id"])))
        where = place.report(row["report_id"], row["id"], "proposal.html")
        asks = place.flow_run(run.id) if run and run.state == "PAUSED" else None
        title = _title(look, row)
        about = {"title": title, "words": words, "href": where, "asks": asks}
        out.append({**row, **about})
    return out


def _title(look: Look, row: Mapping) -> str:
    """Return robot and number of the diagnosis that a proposal is of."""
    titles = (each.title for each in look.diagnoses if each.id == row["id"])
    return next(titles, row["robot"])


def _runs(count: int) -> str:
    return f"{count} run{'' if count == 1 else 's'}"


def _tiles(
    cards: Sequence[Card],
    refused: Sequence,
    waiting: Sequence,
    failed: Sequence | None,
) -> list[Tile]:
    seen = [card for card in cards if card.state != "other"]
    off = sum(card.state in _OFF for card in seen)
    alarms = [card.alarms for card in cards if card.alarms.startswith("alarms")]
    open_ = sum("verdict explains" not in words for words in alarms)
    told = "no server answers" if failed is None else "flow runs"
    many = "–" if failed is None else str(len(failed))
    return [
        Tile("Robots diagnosed", str(len(seen)), f"{off} with something missing"),
        Tile("Alarms", str(len(alarms)), f"robots; {open_} without a cause"),
        Tile("Refused", str(len(refused)), "logs of the inboxes"),
        Tile("Waiting", str(len(waiting)), "for your decision"),
        Tile("Failed", many, told),
    ]
