"""The loop that closes itself: decide, do, write it down; from wherever it stopped."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from flows.outputs import Progress
from flows.settings import store_folder
from flows.steps.closing.act import Came, Loop, act
from flows.steps.closing.arm import MOST, Arm, Close, loop_id, make_arm, open_seal
from flows.steps.closing.known import RUN, Known
from flows.steps.closing.rule import Asked, Step, next_step
from flows.storage.diagnosis import read_verdict
from residual.diagnosis.result import Verdict
from residual.errors import InputError
from warehouse.numbered import Decision, commit_decision, read_decisions

LEAST = 3  # experiments: one to fit, one held out, one to see whether anything is left


@dataclass(frozen=True, eq=False, slots=True)
class Closed:
    """A loop that has ended.

    Attributes:
        loop: Its id.
        arm: Its arm.
        decisions: All that it did.
        hidden: What the arm hid: the seal, opened last.
    """

    loop: str
    arm: Arm
    decisions: tuple[Decision, ...]
    hidden: tuple[dict, ...]

    @property
    def known(self) -> Known:
        """What it knows in the end."""
        return Known.of(self.decisions)

    @property
    def seconds(self) -> float:
        """Motion of the arm in all [s]."""
        return self.decisions[-1].seconds


Heard = Callable[[Decision], None]


def close(
    asked: Close, heard: Heard | None = None, tell: Progress | None = None
) -> Closed:
    """Go from an arm with undeclared effects to an adopted model.

    Started again with the same request it goes on where it stopped.

    Args:
        heard: Told every decision of this call once it is in the store.
        tell: Told the stage and the share done.

    Raises:
        InputError: If the request is not usable, the arm of that seed is not the one
            of the records any more, or the robot has got another model meanwhile.
    """
    for decision in decisions(asked, tell):
        if heard:
            heard(decision)
    return closed(asked)


def decisions(asked: Close, tell: Progress | None = None) -> Iterator[Decision]:
    """Make the decisions that are still to be made, one after the other.

    Args:
        tell: Told the stage and the share done.

    Raises:
        InputError: As of `close`.
    """
    while True:
        loop = begun(asked)
        decision = decided(loop, tell)
        if decision is None:
            return
        yield decision


def begun(asked: Close) -> Loop:
    """Return a loop as it stands in the store.

    Raises:
        InputError: As of `close`.
    """
    _check(asked)
    store = store_folder(asked.store)
    arm = make_arm(asked, store)
    id = loop_id(asked, arm)
    history = read_decisions(store, id)
    if history and history[0].result["seal"] != arm.seal:
        raise InputError(
            f"The store has a loop of the arm of seed {asked.seed}, made by a version "
            "that draws another arm from that seed. Take another --store or --seed."
        )
    return Loop(id, asked, arm, store, history)


def decided(loop: Loop, tell: Progress | None = None) -> Decision | None:
    """Do the next step of a loop and write it down; None where it has ended.

    Args:
        tell: Told the stage and the share done.
    """
    asked = loop.asked
    step = next_step(loop.history, Asked(asked.budget, asked.designed))
    if step is None:
        return None
    made = _decision(loop, step, act(loop, step, tell))
    commit_decision(loop.store, made)
    return made


def closed(asked: Close) -> Closed:
    """Open the seal of a loop that has ended.

    Raises:
        InputError: As of `close`.
    """
    loop = begun(asked)
    first = next(d.made for d in loop.history if d.action == RUN)
    hidden = open_seal(loop.store, first, loop.arm.robot.dof)
    return Closed(loop.id, loop.arm, loop.history, tuple(hidden))


def adopted_verdict(store: Path, given: Mapping | None) -> Verdict | None:
    """Return the verdict of an adopted model, with all that is named in it.

    Args:
        given: What an adoption left; None for none.
    """
    if given is None:
        return None
    told = [read_verdict(store, id) for id in given["chain"]]
    return replace(told[-1], effects=tuple(f for v in told for f in v.effects))


def _decision(loop: Loop, step: Step, came: Came) -> Decision:
    history = loop.history
    before = history[-1].seconds if history else 0.0
    # The promise that it is one arm all along is made with the first decision.
    seal = {} if history else {"seal": loop.arm.seal}
    return Decision(
        loop=loop.id,
        number=len(history) + 1,
        robot=loop.arm.robot.name,
        serial=loop.arm.robot.serial,
        action=step.action,
        reason=step.reason,
        outcome=came.outcome,
        made=came.made,
        seconds=before + came.seconds,
        result={**came.result, **seal},
    )


def _check(asked: Close) -> None:
    if asked.budget < LEAST:
        raise InputError(
            f"--budget {asked.budget}: expected {LEAST} or more experiments: one to "
            "fit, one held out, and one to see whether anything is left."
        )
    if not 0 <= asked.seed < 2**63:
        raise InputError(f"--seed is {asked.seed}, expected 0 or more.")
    if asked.effects is not None and not 0 <= asked.effects <= MOST:
        raise InputError(f"--effects {asked.effects}: expected 0 to {MOST}.")
