"""modelgap close: from an arm with undeclared effects to an adopted model."""

import json as texts
from pathlib import Path

from rich.console import Console

from flows.cli.options import STDOUT, check_between, console_beside, named_files
from flows.outputs import (
    check_outside,
    check_writable,
    json_text,
    progress_bar,
    say,
    write_all,
)
from flows.report.closed import ended, headline, keep_page, pairs, render
from flows.settings import store_folder
from flows.steps.closing.arm import MOST, Close
from flows.steps.closing.close import (
    LEAST,
    Closed,
    adopted_verdict,
    begun,
    closed,
    decided,
)
from warehouse.numbered import Decision

_BUDGET = 100  # experiments


def close(
    *,
    robot: str = "irb140",
    budget: int = 8,
    seed: int = 7,
    effects: int | None = None,
    store: str | None = None,
    report: str | None = None,
    json: str | None = None,
) -> None:
    """Go from a simulated arm with undeclared effects to an adopted model, by itself.

    An arm is drawn that hides one to three effects from its model. The loop sees only
    what a robot logs. It runs an experiment, diagnoses, designs the next experiment
    where the logs do not tell, lets the gate judge what is named, adopts it, drives
    the arm with it, and diagnoses again beside the adopted model; until nothing is
    left above noise, nothing more can be decided, or the budget is spent. Then the
    seal is opened and the truth shown beside what was adopted.

    ```
    modelgap close --robot irb140 --budget 8
    modelgap close --seed 3 --effects 2 --report close.html
    ```

    Every decision and its reason is a record of the store. Stopped at any point, the
    same command goes on from there; with a larger --budget it goes on, too. The arm
    has a serial number of its own (modelgap models), so no other arm gets its model.

    Args:
        robot: Built-in name (irb140), URDF file, or folder; the arm is simulated.
        budget: How many experiments it may run; 3 to 100.
        seed: Seed of the arm, of what it hides, and of the motions.
        effects: How many effects to hide, 0 to 3; drawn from 1 to 3 without it.
        store: Folder of the store; else $MODELGAP_STORE, else ./store.
        report: File for the page; it is kept in the store, too.
        json: File for decisions, truth and what was adopted; "-" prints it and nothing
            else.
    """
    check_between("--budget", budget, LEAST, _BUDGET)
    if effects is not None:
        check_between("--effects", effects, 0, MOST)
    files = named_files({"--report": report, "--json": json})
    check_writable(files, [Path(robot)])
    place, console = store_folder(store), console_beside(json)
    for option, path in files.items():
        check_outside(option, str(path), place)
    asked = Close(robot, budget, seed, effects, store=place)
    _go_on(asked, console)
    done = closed(asked)
    verdict = adopted_verdict(place, done.known.adopted)
    page = render(done, verdict)
    kept = keep_page(done, place, page)
    found = pairs(done.hidden, verdict)
    say(console, "", headline(done, found), ended(done), "", "the seal, opened now:")
    for one in found:
        say(console, f"  hidden {one.hidden} ({one.values})")
        say(console, f"    adopted {one.adopted} ({one.found}): {one.judged}")
    say(console, "", f"report: {kept}")
    told = json_text(_document(done))
    make = {"--report": page, "--json": told}
    write_all({path: make[option] for option, path in files.items()})
    if json == STDOUT:
        print(told, end="")


def _go_on(asked: Close, console: Console) -> None:
    """Tell what was decided before, then decide until there is nothing to decide."""
    loop = begun(asked)
    arm = f"{loop.arm.robot.name} {asked.serial}"
    say(console, f"the simulated arm {arm}, at most {asked.budget} experiments")
    say(console, f"into {loop.store}, loop {loop.id}")
    for decision in loop.history:
        say(console, *told(decision))
    if loop.history:
        say(console, "(that far it was done before)")
    while True:
        with progress_bar() as tell:
            decision = decided(begun(asked), tell)
        if decision is None:
            return
        say(console, *told(decision))


def told(decision: Decision) -> list[str]:
    """Return a decision as lines: what and why, then what came of it."""
    lines = [f"{decision.number:3}  {decision.action}: {decision.reason}"]
    if decision.outcome:
        id = f" [{decision.made[:8]}]" if decision.made else ""
        lines.append(f"     -> {decision.outcome}{id}")
    return lines


def _document(done: Closed) -> dict:
    known = done.known
    return {
        "schema": 1,
        "loop": done.loop,
        "robot": done.arm.robot.name,
        "serial": done.arm.robot.serial,
        "seconds": done.seconds,
        "experiments": len(known.runs),
        "ended": done.decisions[-1].result["why"],
        "adopted": list(known.adopted["effects"]) if known.adopted else [],
        "hidden": texts.loads(texts.dumps(list(done.hidden))),
        "decisions": [
            {
                "number": d.number,
                "action": d.action,
                "reason": d.reason,
                "outcome": d.outcome,
                "made": d.made,
                "seconds": d.seconds,
            }
            for d in done.decisions
        ],
    }
