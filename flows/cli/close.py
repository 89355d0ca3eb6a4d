"""modelgap close: from an arm with undeclared effects to an adopted model."""

import json as texts
from dataclasses import replace
from pathlib import Path

from flows.cli.app import STDOUT, Outputs, check_between
from flows.outputs import check_outside, progress_bar
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
_TOLD = ("number", "action", "reason", "outcome", "made", "seconds")  # of a decision
_PLAIN = Close()


def close(
    *,
    request: Close = _PLAIN,
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
        report: File for the page; it is kept in the store, too.
        json: File for decisions, truth and what was adopted; "-" prints it and nothing
            else.
    """
    check_between("--budget", request.budget, LEAST, _BUDGET)
    if request.effects is not None:
        check_between("--effects", request.effects, 0, MOST)
    out = Outputs({"--report": report, "--json": json}, [Path(request.robot)])
    place = store_folder(request.store)
    for option, path in out.files.items():
        check_outside(option, str(path), place)
    request = replace(request, store=place)
    _go_on(request, out)
    done = closed(request)
    verdict = adopted_verdict(place, done.known.adopted)
    page = render(done, verdict)
    kept = keep_page(done, place, page)
    found = pairs(done.hidden, verdict)
    out.say("", headline(done, found), ended(done), "", "the seal, opened now:")
    for one in found:
        out.say(f"  hidden {one.hidden} ({one.values})")
        out.say(f"    adopted {one.adopted} ({one.found}): {one.judged}")
    out.say("", f"report: {kept}")
    out.write({"--report": lambda: page}, lambda: _document(done))
    if json == STDOUT:
        out.finish()


def _go_on(request: Close, out: Outputs) -> None:
    """Tell what was decided before, then decide until there is nothing to decide."""
    loop = begun(request)
    arm = f"{loop.arm.robot.name} {request.serial}"
    out.say(f"the simulated arm {arm}, at most {request.budget} experiments")
    out.say(f"into {loop.store}, loop {loop.id}")
    for decision in loop.history:
        out.say(*lines_of(decision))
    if loop.history:
        out.say("(that far it was done before)")
    while True:
        with progress_bar() as tell:
            decision = decided(begun(request), tell)
        if decision is None:
            return
        out.say(*lines_of(decision))


def lines_of(decision: Decision) -> list[str]:
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
        "decisions": [{key: getattr(d, key) for key in _TOLD} for d in done.decisions],
    }
