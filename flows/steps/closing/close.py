"""The loop that closes itself: decide, do, write it down; from wherever it stopped."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from flows.outputs import Progress
from flows.requests import Diagnose
from flows.settings import store_folder
from flows.specs.experiment import ExperimentSpec, TrajectoryTable, derived_seed
from flows.steps import experiment
from flows.steps.adopt import Adopt, adopt, judge
from flows.steps.closing.arm import (
    MOST,
    PAUSE,
    Arm,
    Close,
    loop_id,
    make_arm,
    open_seal,
)
from flows.steps.closing.rule import (
    ADOPT,
    DIAGNOSE,
    DRIVE,
    PROOF,
    RUN,
    SLOW,
    STOP,
    Asked,
    Known,
    Step,
    next_step,
)
from flows.steps.diagnose import diagnose_runs
from flows.steps.planning.ask import Next, ask
from flows.steps.planning.design import Design, design
from flows.steps.planning.motions import Search, with_twins
from flows.steps.track import NOMINAL, Track, track
from flows.storage.diagnosis import read_verdict
from residual.diagnosis.result import Alternative, Finding, Place, Verdict
from residual.errors import InputError, joints_listed
from residual.lazy import one_blas_thread
from residual.planning.promise import sure_words
from residual.quantity import percent
from sim.engine.records import TrajectorySpec
from warehouse.numbered import Decision, commit_decision, read_decisions

_AMPLE = 1.5  # times what should be enough: how long a designed motion is run
_SHORTEST = 8.0  # s, of a designed motion: its filter has to settle


@dataclass(frozen=True, eq=False, slots=True)
class Loop:
    """A loop at work.

    Attributes:
        id: Its id.
        asked: What was wanted.
        arm: Its arm.
        store: The store.
        history: What it has done.
    """

    id: str
    asked: Close
    arm: Arm
    store: Path
    history: tuple[Decision, ...]


@dataclass(frozen=True, slots=True)
class Came:
    """What came of a step.

    Attributes:
        outcome: In a few words.
        made: Id of what it left in the store, None for nothing.
        result: What later steps go by, as JSON can hold it.
        seconds: Motion that it took [s].
    """

    outcome: str
    made: str | None
    result: Mapping
    seconds: float = 0.0


def act(loop: Loop, step: Step, tell: Progress | None = None) -> Came:
    """Do a step.

    Raises:
        InputError: If the robot has got another model meanwhile.
    """
    if step.action == STOP:
        return Came("", None, step.how)
    does = {RUN: _run, DIAGNOSE: _diagnose, ADOPT: _adopt, DRIVE: _drive}
    return does[step.action](loop, step.how, tell)


def _run(loop: Loop, how: Mapping, tell: Progress | None) -> Came:
    """Run a standard motion, or one that is designed for what is open."""
    number = sum(d.action == RUN for d in loop.history)
    made = _designed(loop, how["design"], tell) if "design" in how else None
    motion = made[0] if made else _standard(loop, how["kind"], number)
    table = {k: v for k, v in asdict(motion).items() if k != "coefficients"}
    if motion.coefficients:
        table["coefficients"] = [list(row) for row in motion.coefficients]
    start = sum(d.result["length"] + PAUSE for d in loop.history if d.action == RUN)
    spec = ExperimentSpec.model_validate(
        {
            "robot": loop.arm.word,
            "seed": loop.asked.seed,
            "start": start,
            "trajectory": TrajectoryTable.model_validate(table),
            "plant": loop.arm.plant,
            "controller": {"model": _driver(loop)},
        }
    )
    id = experiment.run(spec, loop.store)
    result = {
        "role": how["role"],
        "family": motion.kind,
        "length": motion.duration,
        "designed": made is not None,
        "rivals": list(how["rivals"]),
        "controller": _driver(loop),
    }
    told = f"{motion.duration:.3g} s of {motion.kind.replace('_', '-')} motion"
    if made:
        best = made[1].best
        words = sure_words(best.spec.duration, best.after, best.sure.chance)
        told += f" of which the question is {words}"
    if result["controller"] != NOMINAL:
        told += ", driven by the adopted model"
    return Came(told, id, result, motion.duration)


def _standard(loop: Loop, kind: str, number: int) -> TrajectorySpec:
    seed = derived_seed(loop.asked.seed, f"close/motion/{number}")
    if kind == SLOW:  # once round in twice the time, where others go round twice
        return TrajectorySpec(PROOF, 2 * loop.asked.seconds, 1, seed)
    return TrajectorySpec(kind, loop.asked.seconds, 2, seed)


def _driver(loop: Loop) -> str:
    """The model of the controller: what is adopted drives the arm."""
    given = [d for d in loop.history if d.action == ADOPT and d.result["adopted"]]
    return given[-1].result["diagnosis"] if given else NOMINAL


@one_blas_thread
def _designed(
    loop: Loop, diagnosis: str, tell: Progress | None
) -> tuple[TrajectorySpec, Design]:
    """Return the motion that settles what a diagnosis leaves open."""
    seed = derived_seed(loop.asked.seed, f"close/design/{len(loop.history)}")
    seconds = loop.asked.seconds
    wanted = Next(diagnosis, seconds=seconds, seed=seed, store=loop.store)
    asked = ask(wanted, tell)
    search = Search(asked.question, asked.robot, seconds, seed)
    made = design(with_twins(search), tell)
    best = made.best
    if best.after is None:
        return best.spec, made
    return best.cut(max(_AMPLE * best.after, _SHORTEST)), made


def _diagnose(loop: Loop, how: Mapping, tell: Progress | None) -> Came:
    request = Diagnose(
        tuple(how["fit"]),
        robot=loop.arm.word,
        held_out=tuple(how["held_out"]),
        store=loop.store,
        model=how["model"],
    )
    id, proof = diagnose_runs(request, tell)
    verdict = read_verdict(loop.store, id)
    return Came(_said(verdict), id, {"proof": proof, **summary(id, verdict, how)})


def summary(id: str, verdict: Verdict, how: Mapping) -> dict:
    """Return what a loop goes by of a verdict, as JSON can hold it."""
    plan = verdict.next_experiment
    rivals = [_where(r["name"], r["joints"]) for r in plan["rivals"]] if plan else []
    classes = [_class(finding) for finding in verdict.effects]
    # What is as good and in no question is so on every motion.
    alike = [name for own in classes for name in own[1:]]
    alike += [_swap(one, verdict) for one in verdict.alternatives]
    errors = verdict.error.overall_filtered
    return {
        "diagnosis": id,
        "model": how["model"],
        "verdict": verdict.verdict,
        "effects": [own[0] for own in classes],
        "classes": classes,
        "rivals": rivals,
        "twins": [] if rivals else list(dict.fromkeys(filter(None, alike))),
        "unexplained": list(verdict.unexplained.joints),
        "before": errors["nominal"],
        "after": errors["augmented"],
    }


def _adopt(loop: Loop, how: Mapping, _: Progress | None) -> Came:
    """Let the gate judge; what was adopted before a kill is not adopted twice."""
    diagnosis = how["diagnosis"]
    found = next(d.result for d in loop.history if d.made == diagnosis)
    before = Known.of(loop.history).adopted if found["model"] else None
    told = {
        "diagnosis": diagnosis,
        "effects": [*(before["effects"] if before else ()), *found["effects"]],
        # Diagnoses whose findings together are those of the model.
        "chain": [*(before["chain"] if before else ()), diagnosis],
    }
    judged = judge(loop.store, diagnosis)
    last = judged.parent
    if last and last[1].diagnosis_id == diagnosis:
        number, seen = last[0], last[1]
        errors = f"{percent(seen.before)} -> {percent(seen.after)}"
    elif judged.doubts:
        return Came("; ".join(judged.doubts), None, {"adopted": False, **told})
    else:
        note = f"modelgap close, loop {loop.id}"
        number, judged = adopt(Adopt(diagnosis, note, store=loop.store))
        errors = f"{percent(judged.worth.before)} -> {percent(judged.worth.after)}"
    outcome = f"adoption {int(number)}; error on held-out motion {errors}"
    return Came(outcome, number, {"adopted": True, **told})


def _drive(loop: Loop, how: Mapping, tell: Progress | None) -> Came:
    """Drive the held-out motion by the nominal model and by the adopted one."""
    diagnosis = how["diagnosis"]
    if not loop.asked.drives:
        return Came("not driven: that was asked for", None, {})
    runs = tuple(
        d.made for d in loop.history if d.action == RUN and d.result["role"] != "fit"
    )
    id, made = track(Track(runs, diagnosis, store=loop.store), tell)
    gain = made.gains[1]
    first, second = (
        1e3 * float((made.values(cell, "rms") ** 2).sum() ** 0.5)
        for cell in (gain.first, gain.second)
    )
    outcome = f"off its path by {first:.3g} -> {second:.3g} mrad (rms)"
    return Came(outcome, id, {"before": first, "after": second})


def _said(verdict: Verdict) -> str:
    if verdict.effects:
        return ", ".join(" or ".join(_class(finding)) for finding in verdict.effects)
    if verdict.verdict == "unknown":
        joints = verdict.unexplained.joints
        return f"something without a name on {joints_listed(joints)}"
    return "nothing above noise"


def _swap(one: Alternative, verdict: Verdict) -> str | None:
    """What another set has in place of what; None where that is an equivalent."""
    named = {(f.name, f.joints): _class(f) for f in verdict.effects}
    there = [(p.name, p.joints) for p in one.set]
    gone = [own for key, own in named.items() if key not in there]
    come = [_where(*key) for key in there if key not in named]
    if len(gone) == len(come) == 1 and come[0] in gone[0]:
        return None
    place = " and ".join(own[0] for own in gone)
    beside = f" in place of {place}" if gone else " beside it"
    return (" and ".join(come) or "nothing") + beside


def _class(finding: Finding) -> list[str]:
    return [finding.where, *(_place(e) for e in finding.equivalent)]


def _place(place: Place) -> str:
    return _where(place.name, place.joints)


def _where(name: str, joints) -> str:
    return f"{name} on {joints_listed(tuple(joints))}" if joints else name


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
    """Do the next step of a loop and write it down; None where it has ended."""
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
