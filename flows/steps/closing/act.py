"""Do one step of a loop: ids in, a record out; what is stored is not made again."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from flows.outputs import Progress
from flows.requests import Diagnose
from flows.specs.experiment import ExperimentSpec, TrajectoryTable, derived_seed
from flows.steps import experiment
from flows.steps.closing.arm import PAUSE, Arm, Close
from flows.steps.closing.known import RUN, Known
from flows.steps.closing.rule import ADOPT, DIAGNOSE, DRIVE, STOP, Step
from flows.steps.diagnose import diagnose_runs
from flows.steps.loop.adopt import Adopt, adopt
from flows.steps.loop.judge import judge
from flows.steps.loop.track import NOMINAL, Track, track
from flows.steps.planning.ask import ask
from flows.steps.planning.design import Design, design
from flows.steps.planning.motions import FOURIER, Search, with_twins
from flows.steps.planning.request import Next
from flows.storage.diagnosis import read_verdict
from residual.diagnosis.result import Alternative, Finding, Place, Verdict
from residual.names import joints_listed
from residual.quantity import percent
from residual.threads import one_blas_thread
from sim.records import TrajectorySpec
from warehouse.numbered import Decision

_AMPLE = 1.5  # times the expected length: how long a designed motion is run
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

    Args:
        tell: Told the stage and the share done.

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
        told += f", {made[1].best.seen.least:.0f} nats expected"
    if result["controller"] != NOMINAL:
        told += ", driven by the adopted model"
    return Came(told, id, result, motion.duration)


def _standard(loop: Loop, kind: str, number: int) -> TrajectorySpec:
    seed = derived_seed(loop.asked.seed, f"close/motion/{number}")
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
    return cut(made.best.spec, made.seconds), made


def cut(spec: TrajectorySpec, enough: float | None) -> TrajectorySpec:
    """Return as many whole periods of a Fourier motion as are ample.

    Args:
        spec: The motion; another family stays as long as it is.
        enough: After how long it is expected to have settled [s]; None where all of it
            is not enough.
    """
    if enough is None or spec.kind != FOURIER or not spec.coefficients:
        return spec
    period = spec.duration / spec.periods
    least = max(_AMPLE * enough, _SHORTEST)
    periods = min(spec.periods, -int(-least // period))
    return replace(spec, duration=periods * period, periods=periods)


def _diagnose(loop: Loop, how: Mapping, tell: Progress | None) -> Came:
    request = Diagnose(
        tuple(how["fit"]),
        loop.arm.word,
        tuple(how["held_out"]),
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
