"""The page of a night: every robot, what changed, what waits, what failed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, date, datetime

from flows.report.document import Tile
from flows.report.night.look import Diagnosed, History, Look, Place, night_of, span_of
from flows.report.words.phrases import listing

# Worst first: what an engineer reads before the coffee is cold.
_ORDER = {"effects": 0, "unknown": 1, "other": 2, "none": 3}
STATES = {
    "effects": "something missing",
    "unknown": "unknown",
    "none": "nothing missing",
    "other": "not diagnosed",
}
_MOST = 3  # names in a headline


@dataclass(frozen=True, slots=True)
class Card:
    """What a night says of one robot.

    Attributes:
        robot: Its name.
        title: Its name, and the number of its last diagnosis.
        state: effects, unknown, none, or other where it was not diagnosed.
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


def context(look: Look, night: date, past: History | None, place: Place) -> dict:
    """Return what the template `night.html` is filled with.

    Args:
        past: Flow runs of that time; None where no server answers.
    """
    warnings = past.warnings if past else ()
    inside = _Night(look, night, place, warnings)
    cards = sorted(inside.cards(), key=lambda c: (_ORDER[c.state], c.robot))
    failed = [run for run in past.runs if run.failed] if past else []
    waiting = _waiting(look, past, place)
    begin, end = span_of(night)
    so_far = ", not over yet" if datetime.now(UTC).replace(tzinfo=None) < end else ""
    return {
        "title": f"modelgap: night to {night:%d %B %Y}",
        "night": f"{night:%A, %d %B %Y}",
        "span": f"{begin:%d %b %H:%M} to {end:%d %b %H:%M} UTC{so_far}",
        "headline": headline(cards, len(failed)),
        "tiles": _tiles(cards, inside, waiting, failed if past else None),
        "cards": cards,
        "waiting": waiting,
        "adopted": inside.rows(look.adoptions),
        "failed": failed,
        "history": past,
        "warnings": [w for w in warnings if not any(w[1] in c.warned for c in cards)],
        "before": next((n for n in look.nights if n < night), None),
        "after": next((n for n in reversed(look.nights) if n > night), None),
    }


def headline(cards: Sequence[Card], failed: int) -> str:
    """Return a night in one sentence."""
    off = [card for card in cards if card.state in ("effects", "unknown")]
    seen = [card for card in cards if card.state != "other"]
    end = f" {failed} flow{'s' if failed > 1 else ''} failed." if failed else ""
    if not seen:
        return f"No robot was diagnosed.{end}"
    if not off:
        who = seen[0].robot if len(seen) == 1 else f"{len(seen)} robots"
        return f"Nothing is missing on {who}.{end}"
    if len(off) == 1:
        one = off[0]
        words = ", ".join(filter(None, (one.words, one.errors)))
        rest = f" ({len(seen) - 1} others: nothing missing)" if len(seen) > 1 else ""
        return f"{one.title}: {words}{rest}.{end}"
    names = [card.robot for card in off[:_MOST]]
    names += [f"{len(off) - _MOST} more"] if len(off) > _MOST else []
    return f"{len(off)} of {len(seen)} robots lack something: {listing(names)}.{end}"


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
        known = last.verdict if last and last.verdict in STATES else "other"
        return Card(
            robot=robot,
            title=last.title if last else robot,
            state=known if last else "other",
            words=words or "new runs, no diagnosis",
            errors=errors,
            model=self._model(robot, last),
            alarms=self._alarms(robot),
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
            ),
        )

    def _warned(self, last: Diagnosed) -> tuple[str, ...]:
        # The name of its flow run begins with its title.
        own = f"{last.title}: "
        return tuple(words for name, words in self.warnings if name.startswith(own))

    def _alarms(self, robot: str) -> str:
        rows = [r for r in self.rows(self.look.watched) if r["robot"] == robot]
        count = sum(row["alarms"] for row in rows)
        what = sorted({words for row in rows for words in row["what"] or ()})
        if count:
            return f"{count} alarm{'s' if count > 1 else ''}: {listing(what[:_MOST])}"
        return "no alarm" if rows else "not watched"

    def _model(self, robot: str, last: Diagnosed | None) -> str:
        new = [r for r in self.rows(self.look.adoptions) if r["robot"] == robot]
        if new:
            return f"{new[0]['action']} (no. {int(new[0]['id'])})"
        waits = [p for p in self.look.proposals if p["robot"] == robot and p["waits"]]
        if waits:
            return "a new model waits for a decision"
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
        out.append({**row, "words": words, "href": where, "asks": asks})
    return out


def _tiles(
    cards: Sequence[Card],
    inside: _Night,
    waiting: Sequence,
    failed: Sequence | None,
) -> list[Tile]:
    seen = [card for card in cards if card.state != "other"]
    off = sum(card.state in ("effects", "unknown") for card in seen)
    alarms = sum(row["alarms"] for row in inside.rows(inside.look.watched))
    told = "no server answers" if failed is None else "flow runs"
    many = "–" if failed is None else str(len(failed))
    return [
        Tile("Robots diagnosed", str(len(seen)), f"{off} with something missing"),
        Tile("Alarms", str(alarms), "of sensors"),
        Tile("Waiting", str(len(waiting)), "for your decision"),
        Tile("Failed", many, told),
    ]
