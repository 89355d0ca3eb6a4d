"""The page of a loop that closed itself: every decision, and the seal opened last."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from markupsafe import Markup

from flows.blind.score import Name, Said, matched, members
from flows.report.document import Document, Note, Section, Table, Tile, tag, words_table
from flows.report.page import render as render_page
from flows.report.words.phrases import (
    FORMS,
    effect_named,
    listing,
    phrase,
    sentence_case,
    texts,
)
from flows.steps.closing.close import Closed
from flows.steps.closing.rule import ADOPT, DIAGNOSE, DRIVE, NOTHING, STOP
from residual.diagnosis.result import Place, Verdict
from residual.quantity import MISSING, measured
from warehouse.commit import commit_record
from warehouse.ids import record_folder
from warehouse.numbered import Decision

_TEXT = texts()["close"]

RIGHT, CLASS, MISSED, FALSE = (
    "right",
    "one of its equivalents",
    "not adopted",
    "nothing of the kind was hidden",
)


class Pair(NamedTuple):
    """One effect that was hidden, or adopted, or both, in words; "–" for nothing."""

    hidden: str
    values: str
    adopted: str
    found: str
    judged: str

    @property
    def right(self) -> bool:
        """Whether what was hidden is what was adopted, or one of its class."""
        return self.judged in (RIGHT, CLASS)


def pairs(hidden: Sequence[Mapping], verdict: Verdict | None) -> list[Pair]:
    """Return what was hidden beside what was adopted, hidden ones first.

    Args:
        verdict: That of the diagnosis whose model is adopted, None for none.
    """
    findings = members(verdict) if verdict else []
    truths = [Name(h["name"], tuple(h["joints"])) for h in hidden]
    exact, near, free = matched(truths, findings)
    out = []
    for truth, own, other in zip(hidden, exact, near, strict=True):
        judged = RIGHT if own else CLASS if other else MISSED
        out.append(Pair(*_hidden(truth), *_adopted(own or other), judged))
    return out + [Pair(MISSING, MISSING, *_adopted(s), FALSE) for s in free]


def headline(done: Closed, compared: Sequence[Pair]) -> str:
    """Return in a sentence what came of a loop."""
    hidden = len(done.hidden)
    there = sum(p.right for p in compared)
    wrong = sum(p.judged == FALSE for p in compared)
    if hidden == 0:
        text = "Nothing was hidden, and nothing was adopted"
        return f"{text}." if not wrong else f"Nothing was hidden; {wrong} adopted."
    text = f"{there} of {hidden} hidden effects adopted"
    if wrong:
        text += f", and {wrong} that {'is' if wrong == 1 else 'are'} not there"
    return f"{text}."


def ended(done: Closed) -> str:
    """Return why it ended, and what that took."""
    last, runs = done.decisions[-1], len(done.known.runs)
    seconds = f"{runs} experiments, {done.seconds:.0f} s of motion"
    if last.result["why"] == NOTHING:
        return f"It stopped after {seconds}: {last.reason}."
    return f"It stopped after {seconds}, with questions left: {last.reason}."


def versions(done: Closed) -> list[tuple[str, str, str, str]]:
    """Return model, effects, error and path of each model that the arm had."""
    out = []
    for i, decision in enumerate(done.decisions):
        if decision.action != ADOPT or not decision.made:
            continue
        error = decision.outcome.partition("motion ")[2]
        after = done.decisions[i + 1 : i + 2]
        path, text = [d for d in after if d.action == DRIVE and d.made], MISSING
        if path:
            ends = path[0].result
            text = f"{ends['before']:.3g} -> {ends['after']:.3g} mrad"
        model = f"adoption {int(decision.made)}"
        out.append((model, listing(decision.result["effects"]), error, text))
    return out


def alike(verdict: Verdict | None) -> list[str]:
    """Return what no motion that was tried tells from what is adopted."""
    out = []
    for finding in verdict.effects if verdict else ():
        others = [phrase(other) for other in finding.equivalent]
        if others:
            out.append(
                f"no motion tells {phrase(finding)} from {listing(others)}: the torque "
                "is the same, and the model has the first"
            )
    return out


def _hidden(truth: Mapping) -> tuple[str, str]:
    units = effect_named(truth["name"]).parameters
    values = [
        f"{key.replace('_', ' ')} {measured(value, None, units.get(key))}"
        for key, value in truth["parameters"].items()
    ]
    return phrase(Place(truth["name"], tuple(truth["joints"]))), ", ".join(values)


def _adopted(member: Said | None) -> tuple[str, str]:
    if member is None:
        return MISSING, MISSING
    values = []
    for key, own in member.finding.parameters.items():
        value, std = own.pairs[member.place or 0]
        values.append(f"{key.replace('_', ' ')} {measured(value, std, own.unit)}")
    name = Place(member.name.effect, member.name.joints)
    text = phrase(name)
    if member.alike:
        others = [phrase(Place(a.effect, a.joints)) for a in member.alike]
        text += f" (or {listing(others)})"
    return text, ", ".join(values)


KIND = "close"
_WHAT = {DIAGNOSE: "diagnose", ADOPT: "adopt", DRIVE: "drive", STOP: "stop"}


def render(done: Closed, verdict: Verdict | None) -> str:
    """Return the page of a loop: one HTML document that needs nothing else."""
    compared = pairs(done.hidden, verdict)
    robot = f"{done.arm.robot.name} {done.arm.robot.serial}"
    return render_page(
        Document(
            title=f"modelgap close: {robot}",
            about=Markup("modelgap close, simulated arm <b>{}</b>").format(robot),
            headline=headline(done, compared),
            lead=[ended(done)],
            tiles=_tiles(done, compared),
            sections=(
                _truth(compared, verdict),
                _decisions(done),
                _models(done),
                Section("again", "Look closer", [Note(_commands(done), "lines")]),
            ),
        )
    )


def _truth(compared: Sequence[Pair], verdict: Verdict | None) -> Section:
    rows = [
        (
            sentence_case(one.hidden),
            one.values,
            sentence_case(one.adopted),
            one.found,
            tag("span", one.judged, "yes" if one.right else "no"),
        )
        for one in compared
    ]
    heads = ("Hidden", "Its values", "Adopted", "Estimated values", "Judged")
    table = words_table(heads, rows, "The seal was opened after the last decision")
    same = [Note(sentence_case(line), "callout") for line in alike(verdict)]
    heading = "What the arm hid, and what was adopted"
    forms = FORMS if verdict else ""
    return Section("truth", heading, [table, *same], below=forms)


def _decisions(done: Closed) -> Section:
    heads = ("No.", "What", "Why", "What came of it", "Motion so far", "Record")
    rows = [_row(decision) for decision in done.decisions]
    table = Table(heads, rows, left=(1, 2, 3, 5), look="steps")
    return Section("steps", "Every decision, with its reason", [_TEXT["steps"], table])


def _models(done: Closed) -> Section:
    heads = ("Model", "Its effects", "Error on held-out motion", "Off its path (rms)")
    rows = [[*map(_arrow, row)] for row in versions(done)]
    table = [Table(heads, rows, left=(0, 1)) if rows else None]
    return Section(
        "errors", "Each model that the arm had", table, below=_TEXT["models"]
    )


def keep_page(done: Closed, store: Path, page: str) -> Path:
    """Put the page of a loop into the store, and return its file."""
    robot = done.arm.robot
    about = {"robot": robot.name, "serial": robot.serial, "kind": KIND}
    about |= {"loop": done.loop, "decisions": len(done.decisions)}
    last = done.known.adopted
    parents = {"diagnosis": [last["diagnosis"]]} if last else {}
    files = {"close.html": page.encode()}
    id = commit_record(store, "reports", about, None, parents, files)
    return record_folder(store, "reports", id) / "close.html"


def _tiles(done: Closed, compared: Sequence[Pair]) -> list[Tile]:
    driven = [d.result for d in done.decisions if d.action == DRIVE and d.made]
    rows, path = versions(done), MISSING
    if driven:
        path = f"{driven[-1]['before']:.2g} → {driven[-1]['after']:.2g} mrad"
    wrong = sum(p.judged == FALSE for p in compared)
    right = f"{sum(p.right for p in compared)} of {len(done.hidden)}"
    motion = f"{done.seconds:.0f} s of motion"
    return [
        Tile("Experiments", str(len(done.known.runs)), motion),
        Tile("Found", right, f"hidden effects; {wrong} adopted that are not there"),
        Tile("Torque error", _arrow(rows[-1][2]) if rows else "–", "held-out motion"),
        Tile("Off its path", path, "nominal → adopted model"),
    ]


def _arrow(error: str) -> str:
    return error.replace("->", "→")


def _row(decision: Decision) -> tuple[str, ...]:
    what = _WHAT.get(decision.action)
    if what is None:
        held_out = decision.result["role"] != "fit"
        designed = decision.result["designed"]
        kind = "held-out" if held_out else "designed" if designed else "standard"
        what = f"{kind} experiment"
    return (
        str(decision.number),
        what,
        sentence_case(decision.reason),
        sentence_case(_arrow(decision.outcome) or MISSING),
        f"{decision.seconds:.0f} s",
        tag("kbd", decision.made[:8]) if decision.made else "",
    )


def _commands(done: Closed) -> str:
    diagnoses = [d.made for d in done.decisions if d.action == DIAGNOSE]
    return (
        f"modelgap models\nmodelgap show {diagnoses[-1][:8]}\n"
        'modelgap sql "SELECT number, action, reason, outcome FROM decisions '
        f"WHERE loop = '{done.loop}' ORDER BY number\""
    )
