"""The sealed study: ids in, ids out; what is stored is not done again.

An arm hides what was drawn, is run, and its runs are stored with the truth sealed. The
diagnosis gets their ids and no more. Only what is judged from a committed verdict opens
the seal. First comes an arm with nothing to hide in every excitation, which says how
small an effect would still be seen there; the sizes of the cases are told in that unit.
"""

import hashlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from time import perf_counter

import numpy as np

from flows.blind.draw import Draft, Excitation, StudyRequest, arm_of, drafts, motions
from flows.blind.row import Hidden, case_row, draw_sized, measured, true_parameters
from flows.blind.score import UNKNOWN, summary
from flows.inputs.given import load
from flows.outputs import Progress
from flows.settings import cores
from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from flows.steps.diagnose import diagnose_runs, request_of
from flows.steps.edit import sealed_edits
from flows.storage.diagnosis import read_outcome, read_verdict
from flows.workers.pool import Pool, Runs, outcomes
from residual.diagnosis.oracle import oracle
from residual.diagnosis.result import Detectable
from residual.diagnosis.verdict import to_json
from residual.effects import registry, reported_joints
from residual.errors import RunError
from residual.lazy import one_blas_thread
from residual.quantity import plain
from sim.engine.records import CLEAN, PlantEffect, stream
from warehouse import runs as stored
from warehouse.commit import commit_record
from warehouse.layout import read_record
from warehouse.query.store import ask
from warehouse.runs import read_run
from warehouse.schema import rows_table

CASE, NULL, STUDY = "blind", "blind_null", "blind_study"  # kinds of validations
_TRIES = 20  # to draw a second effect that is not the first again

Minimum = Sequence[Detectable]


@dataclass(frozen=True, slots=True)
class Case:
    """One case, complete: what is hidden, in experiments whose ids are known."""

    draft: Draft  # what was drawn
    specs: tuple[ExperimentSpec, ...]  # the experiments, those to fit first
    minimum: Minimum  # minimum detectable sizes of its motions
    key: str  # hash of the experiments and of the code that diagnoses and judges


@dataclass(frozen=True, slots=True)
class Study:
    """What a study left in the store."""

    id: str  # id of its own validation
    # One per case, as in the view ``blind``, with ``validation_id``.
    rows: tuple[Mapping, ...]
    summary: Mapping
    known: int  # how many cases were in the store already
    failed: tuple[str, ...]  # what did not come to its end, in words


def run_study(
    request: StudyRequest,
    store: Path,
    tell: Progress | None = None,
    pool: Runs | None = None,
    workers: int | None = None,
) -> Study:
    """Run what is not in the store, and conclude."""
    if pool is None:
        with Pool(workers or cores()) as own:
            return run_study(request, store, tell, own)
    every = drafts(request)
    excitations = {d.excitation.index: (request, d.excitation) for d in every}
    minima, lost = null_sizes(list(excitations.values()), store, tell, pool)
    cases = [
        make_case(request, draft, minima[draft.excitation.index])
        for draft in every
        if draft.excitation.index in minima
    ]
    jobs = {
        case.key: (f"case {case.draft.index}", partial(run_case, request, case, store))
        for case in cases
    }
    known = len(jobs.keys() & finished(store, CASE).keys())
    ids, failed = _completed(jobs, CASE, store, tell, pool)
    return conclude(request, store, list(ids.values()), known, [*lost, *failed])


def null_sizes(
    excitations: Sequence[tuple[StudyRequest, Excitation]],
    store: Path,
    tell: Progress | None,
    pool: Runs,
) -> tuple[dict[int, Minimum], list[str]]:
    """Return the minimum detectable sizes of some excitations, each of a study.

    Returns:
        The sizes, and what failed: without sizes an excitation has no cases.
    """
    keys = {e.index: key_of(null_specs(own, e)) for own, e in excitations}
    jobs = {
        keys[e.index]: (
            f"excitation {e.index} and its cases",
            partial(run_null, own, e, keys[e.index], store),
        )
        for own, e in excitations
    }
    ids, failed = _completed(jobs, NULL, store, tell, pool)
    minima = {
        number: read_verdict(store, ids[key]).minimum_detectable
        for number, key in keys.items()
        if key in ids
    }
    return minima, failed


def _completed(
    jobs: Mapping[str, tuple[str, Callable[[], str]]],
    kind: str,
    store: Path,
    tell: Progress | None,
    pool: Runs,
) -> tuple[dict[str, str], list[str]]:
    """Do what is not in the store; returns ids by key, and what failed.

    Args:
        jobs: What each is called and how it is done, by its key.
    """
    ids, failed = finished(store, kind), []
    todo = [key for key in jobs if key not in ids]
    done = outcomes(pool, [jobs[key][1] for key in todo])
    for count, (at, id, why) in enumerate(done, start=1):
        name = jobs[todo[at]][0]
        if why:
            failed.append(f"{name}: {why}")
        else:
            ids[todo[at]] = id
        if tell:
            share = (count + len(jobs) - len(todo)) / len(jobs)
            tell(f"{name}, {count} of {len(todo)}", share)
    return {key: ids[key] for key in jobs if key in ids}, failed


def conclude(
    request: StudyRequest,
    store: Path,
    done: Sequence[str],
    known: int,
    failed: Sequence[str],
) -> Study:
    """Sum up the cases and store that.

    Args:
        done: Ids of the validations of its cases, in order.
    """
    if not done:
        raise RunError(f"No case came to its end: {failed[0] if failed else 'none'}")
    cases = {id: read_record(store, id) for id in done}
    rows = [{"validation_id": id, **case["row"]} for id, case in cases.items()]
    figures = summary(rows)
    record = {
        "robot": request.robot,
        "kind": STUDY,
        "key": f"{request.seed}/{request.n}{_of(request.background)}",
        "seed": request.seed,
        "n": request.n,
        "duration": request.duration,
        "background": request.background,
        "summary": figures,
        # Cases of earlier versions have no edit test.
        "edits": [edit for case in cases.values() for edit in case.get("edits", ())],
        "failed": list(failed),
    }
    parents = {"case": list(done)}
    id = commit_record(store, "validations", record, None, parents)
    return Study(id, tuple(rows), figures, known, tuple(failed))


def _of(background: str) -> str:
    """Return what tells a study from one of clean arms, as they all were once."""
    return "" if background == CLEAN else f"/{background}"


def finished(store: Path, kind: str) -> dict[str, str]:
    """Return the ids of all validations of a kind in the store, by their key."""
    if not store.is_dir():
        return {}
    query = "SELECT validation_id AS id FROM validations WHERE kind = $kind"
    ids = [row["id"] for row in ask(store, query, kind=kind)]
    return {read_record(store, id)["key"]: id for id in ids}


def null_specs(
    request: StudyRequest, excitation: Excitation
) -> tuple[ExperimentSpec, ...]:
    """Return the experiments of an arm with nothing to hide, in that excitation."""
    return _specs(request, excitation, f"null/{excitation.index}", ())


def key_of(specs: Sequence[ExperimentSpec]) -> str:
    """Return the key of a case: of its runs and of all code that decides its row."""
    ids = [experiment.run_id_of(spec) for spec in specs]
    return hashlib.sha256("\n".join([*ids, method_hash()]).encode()).hexdigest()[:20]


@cache
def method_hash() -> str:
    """Return the hash of the code that diagnoses and judges, 16 hex digits."""
    root, total = Path(__file__).parents[2], hashlib.sha256()
    diagnosing, judging = (root / "residual").rglob, (root / "flows" / "blind").glob
    for path in sorted([*diagnosing("*.py"), *judging("*.py")]):
        total.update(path.relative_to(root).as_posix().encode())
        total.update(path.read_bytes())
    return total.hexdigest()[:16]


def make_case(request: StudyRequest, draft: Draft, minimum: Minimum) -> Case:
    """Draw joints and sizes of a case, now that the detectable sizes are known."""
    effects = hidden_effects(request, draft, minimum)
    specs = _specs(request, draft.excitation, f"case/{draft.index}", effects)
    return Case(draft, specs, minimum, key_of(specs))


def hidden_effects(
    request: StudyRequest, draft: Draft, minimum: Minimum
) -> tuple[PlantEffect, ...]:
    """Draw joints and sizes of what a case hides."""
    robot = load(request.robot)
    made: list[PlantEffect] = []
    for place, wish in enumerate(draft.wishes):
        rng = stream(request.seed, f"hidden/{draft.index}/{place}")
        for _ in range(_TRIES):
            one = draw_sized(robot, rng, wish.effect, wish.multiple, minimum)
            if not any(_same_thing(one, other) for other in made):
                break
        made.append(one)
    return tuple(made)


def run_experiments(
    specs: Sequence[ExperimentSpec], held_out: int, store: Path
) -> dict[str, list[str]]:
    """Run the experiments that are not in the store."""
    ids = [experiment.run(spec, store) for spec in specs]
    return {"fit": ids[:-held_out], "held_out": ids[-held_out:]}


def run_null(
    request: StudyRequest, excitation: Excitation, key: str, store: Path
) -> str:
    """Run and diagnose an arm that hides nothing; store what it would have shown."""
    specs = null_specs(request, excitation)
    runs = run_experiments(specs, len(excitation.held_out), store)
    ids = diagnose_runs(request_of(runs, store))
    verdict = read_outcome(store, ids[1]).verdict
    record = {
        "robot": request.robot,
        "kind": NULL,
        "key": key,
        "document": to_json(verdict),
    }
    return commit_record(store, "validations", record, None, {"diagnosis": [ids[0]]})


def run_case(request: StudyRequest, case: Case, store: Path) -> str:
    """Run, diagnose and judge one case; what is stored of it is not made again."""
    if key_of(case.specs) != case.key:
        # A process loads the code anew: its rows would be under the key of another.
        raise RunError(
            "The code was changed since the study began. Give the command again."
        )
    excitation = case.draft.excitation
    runs = run_experiments(case.specs, len(excitation.held_out), store)
    begun = perf_counter()
    ids = diagnose_runs(request_of(runs, store))
    seconds = perf_counter() - begun
    return judge(request, case, runs, ids, seconds, store)


def judge(
    request: StudyRequest,
    case: Case,
    runs: Mapping[str, Sequence[str]],
    ids: tuple[str, str],
    seconds: float,
    store: Path,
) -> str:
    """Open the seal of a case whose verdict is in the store, and score it.

    Returns:
        The id of the validation: one row of the view ``blind``.
    """
    # The verdict as it was committed: without one there is nothing to judge.
    verdict = read_outcome(store, ids[1]).verdict
    robot, draft = load(request.robot), case.draft
    sealed = stored.open_seal(store, runs["fit"][0]).spec
    plant = experiment.plant_of(sealed)
    hidden = [measured(e, case.minimum, robot, _unit(e)) for e in plant.effects]
    oracle = None if draft.drawn == UNKNOWN else _oracle(request, runs, hidden, store)
    row = case_row(draft.drawn, hidden, true_parameters(robot, plant), verdict, oracle)
    row |= {
        "study_seed": request.seed,
        "case_index": draft.index,
        "experiments": len(runs["fit"]),
        "torque_noise": plant.noise.torque,
        "seconds": round(seconds, 2),
        "method_hash": method_hash(),
        "diagnosis_id": ids[0],
    }
    edits = sealed_edits(runs, ids[0], plant, store)
    record = {
        "robot": request.robot,
        "kind": CASE,
        "key": case.key,
        "row": row,
        "edits": plain([asdict(edit) for edit in edits]),
    }
    table = rows_table("blind", [row])
    parents = {"diagnosis": [ids[0]], "proof": [ids[1]]}
    return commit_record(store, "validations", record, {"blind": table}, parents)


def _specs(
    request: StudyRequest,
    excitation: Excitation,
    label: str,
    effects: Sequence[PlantEffect],
) -> tuple[ExperimentSpec, ...]:
    plant = arm_of(request, label, excitation)
    plant["effect"] = [in_spec(effect) for effect in effects]
    return tuple(
        ExperimentSpec.model_validate({**motion, "plant": plant})
        for motion in motions(request, excitation)
    )


def in_spec(effect: PlantEffect) -> dict:
    """Return an effect as [[plant.effect]] of a spec has it."""
    values = dict(effect.parameters)
    return {"name": effect.name, "joints": list(effect.joints), **values}


def _same_thing(one: PlantEffect, other: PlantEffect) -> bool:
    """Whether two effects are one: of one name or one family, on a common joint."""

    def family(effect: PlantEffect) -> str:
        known = registry().get(effect.name)
        return (known and known.family) or effect.name

    apart = one.joints and other.joints and not set(one.joints) & set(other.joints)
    return family(one) == family(other) and not apart


def _unit(effect: PlantEffect) -> str | None:
    known = registry().get(effect.name)
    return next(iter(known.parameters.values())) if known else None


@one_blas_thread
def _oracle(
    request: StudyRequest, runs: Mapping, hidden: Sequence[Hidden], store: Path
) -> float | None:
    """Return the held-out error of the true effects, fitted [%]."""
    robot = load(request.robot)
    fit, held_out = ([read_run(store, i) for i in runs[k]] for k in ("fit", "held_out"))
    names = [
        (h.effect.name, reported_joints(h.effect.name, h.joints, robot.dof))
        for h in hidden
    ]
    error = oracle(robot, fit, held_out, names).overall("filtered")
    return float(error) if np.isfinite(error) else None
