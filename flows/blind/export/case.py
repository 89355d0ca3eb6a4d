"""One case as plain files: the logs for all, the truth for the judge."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from flows.blind import steps
from flows.blind.draw import Asked, Draft, arm_of, motions
from flows.blind.score import UNKNOWN
from flows.blind.size import measured
from flows.inputs.robots import load
from flows.specs.experiment import ExperimentSpec
from flows.steps import experiment
from residual.diagnosis.oracle import oracle_model
from residual.effects import registry
from residual.model.model import Model
from residual.recording import Array, Recording
from residual.threads import one_blas_thread
from sim.records import PlantEffect
from warehouse.runs import read_run

# Motions of their own, so that no two logs of a case can be laid over each other.
AFTER = ("fourier", "cyclic")
OPEN, SEALED = "open", "sealed"
SPEED, SPAN = 0.05, 10  # rad/s; samples to both sides, over which encoders tell it


@dataclass(frozen=True, slots=True)
class Job:
    """One case to write.

    Attributes:
        name: What it is called, which says nothing.
        asked: The study, with the arm of this case.
        draft: What was drawn.
        minimum: Detectable sizes of its motions.
        folder: Folder of the export.
        store: The store.
    """

    name: str
    asked: Asked
    draft: Draft
    minimum: steps.Minimum
    folder: Path
    store: Path


def write_case(job: Job) -> dict:
    """Run one case, write its logs and the torque that is kept back.

    Returns:
        "open", what everybody may know of it, and "sealed", the truth.
    """
    case = steps.make_case(job.asked, job.draft, job.minimum)
    held_out = len(job.draft.excitation.held_out)
    runs = steps.run_experiments(case.specs, held_out, job.store)
    effects = steps.hidden_effects(job.asked, job.draft, job.minimum)
    ids = [experiment.run(spec, job.store) for spec in _after(job, effects)]
    fit, held, after = (
        {f"{role}_{i}": read_run(job.store, id) for i, id in enumerate(part, 1)}
        for role, part in [*runs.items(), ("after", ids)]
    )
    place = job.folder / OPEN / "logs" / job.name
    for name, log in fit.items():
        write_csv(place / f"{name}.csv", {"t": log.t, "q": log.q, "tau": log.tau})
    for name, log in (held | after).items():
        write_csv(place / f"{name}.csv", {"t": log.t, "q": log.q})
    told = _told(job, effects)
    if told is not None:
        _seal(job, told, list(fit.values()), (held, after))
    known = {"fit": list(fit), "held_out": list(held), "after": list(after)}
    gone = _missing(told or ())
    return {
        "open": {"robot": load(job.asked.robot).name, **known},
        "sealed": {
            "kind": job.draft.drawn,
            "effects": [_truth(job, effect) for effect in effects],
            "held_out": [] if told is None else list(held),
            "after": dict(zip(after, gone, strict=True)),
        },
    }


def write_csv(path: Path, columns: Mapping[str, Array]) -> None:
    """Write columns in SI units, those of several joints numbered from 1.

    Times have microseconds, angles a tenth of a microradian, torques six digits: all
    below what the sensors tell.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    names, formats = [], []
    for name, values in columns.items():
        form = {"t": "%.6f", "q": "%.7f"}.get(name, "%.6g")
        own = [name] if values.ndim == 1 else _numbered(name, values.shape[1])
        names += own
        formats += [form] * len(own)
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, formats, ",", header=",".join(names), comments="")


def moves(t: Array, q: Array) -> Array:
    """Return which joints move at each sample: at standstill any friction holds.

    Args:
        t: Time [s]. Shape (n,).
        q: Angles [rad]. Shape (n, dof).
    """
    later = np.minimum(np.arange(len(t)) + SPAN, len(t) - 1)
    before = np.maximum(np.arange(len(t)) - SPAN, 0)
    return np.abs(q[later] - q[before]) > SPEED * (t[later] - t[before])[:, None]


def _numbered(name: str, count: int) -> list[str]:
    return [f"{name}{i}" for i in range(1, count + 1)]


def _missing(told: Sequence) -> list[int | None]:
    """Which effect the arm has no more in each log after; None where it has all."""
    return [min(i, len(told) - 1) if told else None for i in range(len(AFTER))]


def _after(job: Job, effects: Sequence[PlantEffect]) -> list[ExperimentSpec]:
    """Return the experiments of the same arm without one of its effects."""
    excitation = job.draft.excitation
    count = len(excitation.fit) + len(excitation.held_out)
    longer = replace(excitation, held_out=(*excitation.held_out, *AFTER))
    plant = arm_of(job.asked, f"case/{job.draft.index}", excitation)
    out = []
    gone = _missing(effects)
    for motion, number in zip(motions(job.asked, longer)[count:], gone, strict=True):
        left = [e for i, e in enumerate(effects) if i != number]
        own = {**plant, "effect": [steps.in_spec(e) for e in left]}
        out.append(ExperimentSpec.model_validate({**motion, "plant": own}))
    return out


def _told(job: Job, effects: Sequence[PlantEffect]) -> list | None:
    """Return names and joints for the oracle; None where there is no name."""
    if job.draft.drawn == UNKNOWN:
        return None
    robot = load(job.asked.robot)
    found = [measured(e, job.minimum, robot, None) for e in effects]
    return [(h.effect.name, h.joints) for h in found]


@one_blas_thread
def _seal(
    job: Job,
    told: Sequence,
    fit: Sequence[Recording],
    logs: tuple[Mapping[str, Recording], Mapping[str, Recording]],
) -> None:
    """Write measured torque beside that of who is told the names, logs as given."""
    robot, (held, after) = load(job.asked.robot), logs
    model = oracle_model(robot, fit, list(held.values()), told)
    for name, log in held.items():
        _keep(job, name, log, model)
    for (name, log), number in zip(after.items(), _missing(told), strict=True):
        if number is not None:
            effect, joints = told[number]
            _keep(job, name, log, model.without(effect, joints or None))


def _keep(job: Job, name: str, log: Recording, model: Model) -> None:
    columns = {"t": log.t, "tau": log.tau, "oracle": model.predict(log)}
    columns["moves"] = moves(log.t, log.q).astype(float)
    write_csv(job.folder / SEALED / job.name / f"{name}.csv", columns)


def _truth(job: Job, effect: PlantEffect) -> dict:
    robot, known = load(job.asked.robot), registry().get(effect.name)
    unit = next(iter(known.parameters.values())) if known else None
    there = measured(effect, job.minimum, robot, unit)
    return {
        "effect": effect.name,
        "joints": list(there.joints),
        "parameters": dict(effect.parameters),
        "size": there.size,
        "unit": unit,
        "in_detectable_sizes": there.multiple,
    }
