"""The page of a loop that closed itself: every decision, and the seal opened last."""

from collections.abc import Sequence
from pathlib import Path

from flows.report.page.base import Tile, environment
from flows.report.words import closed as words
from flows.report.words.staged import FORMS
from flows.steps.closing.close import Closed
from flows.steps.closing.rule import ADOPT, DIAGNOSE, DRIVE, STOP
from residual.diagnosis.result import Verdict
from residual.quantity import MISSING
from warehouse.commit import commit_record
from warehouse.ids import record_folder
from warehouse.numbered import Decision

KIND = "close"
_COLUMNS = ("model", "effects", "error", "path")  # of the table of models
_WHAT = {DIAGNOSE: "diagnose", ADOPT: "adopt", DRIVE: "drive", STOP: "stop"}


def render(done: Closed, verdict: Verdict | None) -> str:
    """Return the page of a loop: one HTML document that needs nothing else."""
    found = words.pairs(done.hidden, verdict)
    robot = done.arm.robot
    return (
        environment()
        .get_template("close.html")
        .render(
            robot=f"{robot.name} {robot.serial}",
            headline=words.headline(done, found),
            lead=words.ended(done),
            tiles=_tiles(done, found),
            truth=found,
            alike=words.alike(verdict),
            forms=FORMS if verdict else "",
            steps=[_row(d) for d in done.decisions],
            errors=[
                dict(zip(_COLUMNS, map(_arrow, row), strict=True))
                for row in words.versions(done)
            ],
            commands=_commands(done),
        )
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


def _tiles(done: Closed, found: Sequence[words.Pair]) -> list[Tile]:
    driven, rows = words.driven(done), words.versions(done)
    wrong = sum(p.judged == words.FALSE for p in found)
    path = "–" if driven is None else f"{driven[0]:.2g} → {driven[1]:.2g} mrad"
    right = f"{sum(p.right for p in found)} of {len(done.hidden)}"
    motion = f"{done.seconds:.0f} s of motion"
    return [
        Tile("Experiments", str(len(done.known.runs)), motion),
        Tile("Found", right, f"hidden effects; {wrong} adopted that are not there"),
        Tile("Torque error", _arrow(rows[-1][2]) if rows else "–", "held-out motion"),
        Tile("Off its path", path, "nominal → adopted model"),
    ]


def _arrow(error: str) -> str:
    return error.replace("->", "→")


def _row(decision: Decision) -> dict:
    what = _WHAT.get(decision.action)
    if what is None:
        held_out = decision.result["role"] != "fit"
        designed = decision.result["designed"]
        kind = "held-out" if held_out else "designed" if designed else "standard"
        what = f"{kind} experiment"
    return {
        "number": decision.number,
        "what": what,
        "why": decision.reason,
        "outcome": _arrow(decision.outcome) or MISSING,
        "seconds": f"{decision.seconds:.0f} s",
        "made": decision.made and decision.made[:8],
    }


def _commands(done: Closed) -> list[str]:
    made = [d.made for d in done.decisions if d.action == DIAGNOSE]
    return [
        "modelgap models",
        f"modelgap show {made[-1][:8]}",
        'modelgap sql "SELECT number, action, reason, outcome FROM decisions '
        f"WHERE loop = '{done.loop}' ORDER BY number\"",
    ]
