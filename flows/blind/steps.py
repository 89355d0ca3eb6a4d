"""The sealed study as plain steps: ids in, ids out.

An arm hides what was drawn, is run, and its runs are stored with the truth sealed. The
diagnosis gets their ids and no more. Only what is judged from a committed verdict opens
the seal.
"""

import hashlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from time import perf_counter

import numpy as np

from flows.blind.draw import Asked, Draft, Excitation, arm_of, motions
from flows.blind.row import Hidden, case_row, draw_sized, measured, true_parameters
from flows.blind.score import UNKNOWN
from flows.inputs.given import load
from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from flows.steps.diagnose import diagnose_runs, request_of
from flows.steps.edit import sealed_edits
from flows.storage.diagnosis import read_outcome
from flows.storage.null import method_hash
from residual.diagnosis.oracle import oracle
from residual.diagnosis.result import Detectable
from residual.diagnosis.verdict import to_json
from residual.effects import registry, reported_joints
from residual.errors import RunError
from residual.lazy import one_blas_thread
from residual.quantity import plain
from sim.engine.records import PlantEffect, stream
from warehouse import runs as stored
from warehouse.commit import commit_record
from warehouse.layout import read_record
from warehouse.query.store import ask
from warehouse.runs import read_run
from warehouse.schema import rows_table

CASE, NULL, STUDY = "blind", "blind_null", "blind_study"  # kinds of validations
_TRIES = 20  # to draw a second effect that is not the first again

Runs = dict[str, list[str]]
Minimum = Sequence[Detectable]


@dataclass(frozen=True, slots=True)
class Case:
    """One case, complete: what is hidden, in experiments whose ids are known.

    Attributes:
        draft: What was drawn.
        specs: The experiments, those to fit first.
        minimum: Minimum detectable sizes of its motions.
        key: Hash of the experiments and of the code that diagnoses and judges.
    """

    draft: Draft
    specs: tuple[ExperimentSpec, ...]
    minimum: Minimum
    key: str


def null_specs(asked: Asked, excitation: Excitation) -> tuple[ExperimentSpec, ...]:
    """Return the experiments of an arm with nothing to hide, in that excitation."""
    return _specs(asked, excitation, f"null/{excitation.index}", ())


def key_of(specs: Sequence[ExperimentSpec]) -> str:
    """Return the key of a case: of its runs and of all code that decides its row."""
    ids = [experiment.run_id_of(spec) for spec in specs]
    return hashlib.sha256("\n".join([*ids, method_hash()]).encode()).hexdigest()[:20]


def make_case(asked: Asked, draft: Draft, minimum: Minimum) -> Case:
    """Draw joints and sizes of a case, now that the detectable sizes are known."""
    effects = hidden_effects(asked, draft, minimum)
    specs = _specs(asked, draft.excitation, f"case/{draft.index}", effects)
    return Case(draft, specs, minimum, key_of(specs))


def hidden_effects(
    asked: Asked, draft: Draft, minimum: Minimum
) -> tuple[PlantEffect, ...]:
    """Draw joints and sizes of what a case hides."""
    robot = load(asked.robot)
    made: list[PlantEffect] = []
    for place, wish in enumerate(draft.wishes):
        rng = stream(asked.seed, f"hidden/{draft.index}/{place}")
        for _ in range(_TRIES):
            one = draw_sized(robot, rng, wish.effect, wish.multiple, minimum)
            if not any(_same_thing(one, other) for other in made):
                break
        made.append(one)
    return tuple(made)


def run_experiments(
    specs: Sequence[ExperimentSpec], held_out: int, store: Path
) -> Runs:
    """Run the experiments that are not in the store."""
    ids = [experiment.run(spec, store) for spec in specs]
    return {"fit": ids[:-held_out], "held_out": ids[-held_out:]}


def run_null(asked: Asked, excitation: Excitation, key: str, store: Path) -> str:
    """Run and diagnose an arm that hides nothing; store what it would have shown."""
    specs = null_specs(asked, excitation)
    runs = run_experiments(specs, len(excitation.held_out), store)
    ids = diagnose_runs(request_of(runs, store))
    verdict = read_outcome(store, ids[1]).verdict
    record = {
        "robot": asked.robot,
        "kind": NULL,
        "key": key,
        "document": to_json(verdict),
    }
    return commit_record(store, "validations", record, None, {"diagnosis": [ids[0]]})


def run_case(asked: Asked, case: Case, store: Path) -> str:
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
    return judge(asked, case, runs, ids, seconds, store)


def judge(
    asked: Asked,
    case: Case,
    runs: Runs,
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
    robot, draft = load(asked.robot), case.draft
    sealed = stored.open_seal(store, runs["fit"][0]).spec
    plant = experiment.plant_of(sealed)
    hidden = [measured(e, case.minimum, robot, _unit(e)) for e in plant.effects]
    oracle = None if draft.drawn == UNKNOWN else _oracle(asked, runs, hidden, store)
    row = case_row(draft.drawn, hidden, true_parameters(robot, plant), verdict, oracle)
    row |= {
        "study_seed": asked.seed,
        "case_index": draft.index,
        "experiments": len(runs["fit"]),
        "torque_noise": plant.noise.torque,
        "seconds": round(seconds, 2),
        "method_hash": method_hash(),
        "diagnosis_id": ids[0],
    }
    edits = sealed_edits(runs, ids[0], plant, store)
    record = {
        "robot": asked.robot,
        "kind": CASE,
        "key": case.key,
        "row": row,
        "edits": plain([asdict(edit) for edit in edits]),
    }
    table = rows_table("blind", [row])
    parents = {"diagnosis": [ids[0]], "proof": [ids[1]]}
    return commit_record(store, "validations", record, {"blind": table}, parents)


def finished(store: Path, kind: str) -> dict[str, str]:
    """Return the ids of all validations of a kind in the store, by their key."""
    if not store.is_dir():
        return {}
    query = "SELECT validation_id AS id FROM validations WHERE kind = $kind"
    ids = [row["id"] for row in ask(store, query, kind=kind)]
    return {read_record(store, id)["key"]: id for id in ids}


def _specs(
    asked: Asked, excitation: Excitation, label: str, effects: Sequence[PlantEffect]
) -> tuple[ExperimentSpec, ...]:
    plant = arm_of(asked, label, excitation)
    plant["effect"] = [in_spec(effect) for effect in effects]
    return tuple(
        ExperimentSpec.model_validate({**motion, "plant": plant})
        for motion in motions(asked, excitation)
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
    asked: Asked, runs: Runs, hidden: Sequence[Hidden], store: Path
) -> float | None:
    """Return the held-out error of the true effects, fitted [%]."""
    robot = load(asked.robot)
    fit, held_out = ([read_run(store, i) for i in runs[k]] for k in ("fit", "held_out"))
    told = [
        (h.effect.name, reported_joints(h.effect.name, h.joints, robot.dof))
        for h in hidden
    ]
    error = oracle(robot, fit, held_out, told).overall("filtered")
    return float(error) if np.isfinite(error) else None
