"""Write a sealed study as a folder: what programs may see, and what judges them."""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import tomli_w

from flows.blind.draw import Draft, StudyRequest, arm_of, drafts, motions
from flows.blind.row import measured
from flows.blind.run import (
    Minimum,
    hidden_effects,
    in_spec,
    make_case,
    null_sizes,
    run_experiments,
)
from flows.blind.score import UNKNOWN
from flows.inputs.given import load
from flows.outputs import Progress
from flows.specs.experiment import ExperimentSpec, derived_seed
from flows.steps import experiment
from flows.workers.pool import Runs, outcomes
from residual.diagnosis.oracle import oracle_model
from residual.effects import registry
from residual.effects.base import Effect
from residual.errors import InputError, RunError
from residual.lazy import one_blas_thread
from residual.model.model import Model
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from sim.draw import light_arm
from sim.engine.records import PlantEffect
from warehouse.runs import read_run

# Motions of their own, so that no two logs of a case can be laid over each other.
AFTER = ("fourier", "cyclic")
OPEN, SEALED = "open", "sealed"
SPEED, SPAN = 0.05, 10  # rad/s; samples to both sides, over which encoders tell it


@dataclass(frozen=True, slots=True)
class Job:
    """One case to write."""

    name: str  # what it is called, which says nothing
    request: StudyRequest  # the study, with the arm of this case
    draft: Draft  # what was drawn
    minimum: Minimum  # detectable sizes of its motions
    folder: Path
    store: Path


def write_case(job: Job) -> dict:
    """Run one case, write its logs and the torque that is kept back.

    Returns:
        "open", what everybody may know of it, and "sealed", the truth.
    """
    case = make_case(job.request, job.draft, job.minimum)
    held_out = len(job.draft.excitation.held_out)
    runs = run_experiments(case.specs, held_out, job.store)
    effects = hidden_effects(job.request, job.draft, job.minimum)
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
    names = _told(job, effects)
    if names is not None:
        _seal(job, names, list(fit.values()), (held, after))
    known = {"fit": list(fit), "held_out": list(held), "after": list(after)}
    gone = _missing(names or ())
    return {
        "open": {"robot": load(job.request.robot).name, **known},
        "sealed": {
            "kind": job.draft.drawn,
            "effects": [_truth(job, effect) for effect in effects],
            "held_out": [] if names is None else list(held),
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


def _missing(names: Sequence) -> list[int | None]:
    """Which effect the arm has no more in each log after; None where it has all."""
    return [min(i, len(names) - 1) if names else None for i in range(len(AFTER))]


def _after(job: Job, effects: Sequence[PlantEffect]) -> list[ExperimentSpec]:
    """Return the experiments of the same arm without one of its effects."""
    excitation = job.draft.excitation
    count = len(excitation.fit) + len(excitation.held_out)
    longer = replace(excitation, held_out=(*excitation.held_out, *AFTER))
    plant = arm_of(job.request, f"case/{job.draft.index}", excitation)
    out = []
    gone = _missing(effects)
    for motion, number in zip(motions(job.request, longer)[count:], gone, strict=True):
        left = [e for i, e in enumerate(effects) if i != number]
        own = {**plant, "effect": [in_spec(e) for e in left]}
        out.append(ExperimentSpec.model_validate({**motion, "plant": own}))
    return out


def _told(job: Job, effects: Sequence[PlantEffect]) -> list | None:
    """Return names and joints for the oracle; None where there is no name."""
    if job.draft.drawn == UNKNOWN:
        return None
    robot = load(job.request.robot)
    found = [measured(e, job.minimum, robot, None) for e in effects]
    return [(h.effect.name, h.joints) for h in found]


@one_blas_thread
def _seal(
    job: Job,
    names: Sequence,
    fit: Sequence[Recording],
    logs: tuple[Mapping[str, Recording], Mapping[str, Recording]],
) -> None:
    """Write measured torque beside that of who is told the names, logs as given."""
    robot, (held, after) = load(job.request.robot), logs
    model = oracle_model(robot, fit, list(held.values()), names)
    for name, log in held.items():
        _keep(job, name, log, model)
    for (name, log), number in zip(after.items(), _missing(names), strict=True):
        if number is not None:
            effect, joints = names[number]
            _keep(job, name, log, model.without(effect, joints or None))


def _keep(job: Job, name: str, log: Recording, model: Model) -> None:
    columns = {"t": log.t, "tau": log.tau, "oracle": model.predict(log)}
    columns["moves"] = moves(log.t, log.q).astype(float)
    write_csv(job.folder / SEALED / job.name / f"{name}.csv", columns)


def _truth(job: Job, effect: PlantEffect) -> dict:
    robot, known = load(job.request.robot), registry().get(effect.name)
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


URDF, DECLARED, TOML = "{}.urdf", "declared.json", "robot.toml"


def drawn_arm(folder: Path, seed: int, number: int) -> Path:
    """Write the description of an arm that no other study has."""
    robot = light_arm(derived_seed(seed, f"arm/{number}"))
    name = f"drawn_{robot.content_hash[:8]}"
    place = folder / name
    place.mkdir(parents=True, exist_ok=True)
    (place / URDF.format(name)).write_text(robot.urdf, encoding="utf-8")
    content = {"robot": {"name": name}, **json.loads(robot.toml)}
    (place / TOML).write_text(tomli_w.dumps(content), encoding="utf-8")
    return place


def describe(robot: Robot, folder: Path) -> None:
    """Write what anybody may know of an arm: its URDF, and what is declared of it."""
    place = folder / robot.name
    place.mkdir(parents=True, exist_ok=True)
    (place / URDF.format(robot.name)).write_text(robot.urdf, encoding="utf-8")
    content = json.loads(robot.toml)
    own = content.setdefault("robot", {})
    own["name"] = robot.name
    own["gravity"] = [float(x) for x in robot.model.gravity.linear]
    text = json.dumps(content, indent=1, sort_keys=True)
    (place / DECLARED).write_text(text + "\n", encoding="utf-8")


BODY, JOINT, OTHER = "body", "joint", "other"
_PLACES = {
    "local": "one joint",
    "link": "the joint that carries the link",
    "pair": "two joints",
    "flange": "the last joint",
    "global": "none",
}


def class_of(effect: Effect) -> str:
    """Return "body", "joint" (friction and rotor) or "other"."""
    if effect.carries == BODY or effect.of_link:
        return BODY
    # Two joints that share a gear share its friction.
    drive = effect.brakes or effect.carries == "acceleration" or effect.scope == "pair"
    return JOINT if drive else OTHER


def classes() -> dict[str, str]:
    """Return the class of every effect that has a name."""
    return {name: class_of(effect) for name, effect in sorted(registry().items())}


def words() -> dict[str, dict]:
    """Return every effect with its class, its joints, what it is, and its units."""
    return {
        name: {
            "class": class_of(effect),
            "joints": _PLACES[effect.scope],
            "is": effect.sentence,
            "parameters": dict(effect.parameters),
        }
        for name, effect in sorted(registry().items())
    }


FORMAT = 1  # of the folder; raised when it changes
_HERE = Path(__file__).parent
Part = tuple[StudyRequest, Draft]


def export_study(
    request: StudyRequest,
    arms: Sequence[int],
    target: Path,
    store: Path,
    pool: Runs,
    tell: Progress | None = None,
) -> None:
    """Write the cases of a study as plain files.

    Every ten cases, which share their motions, have another arm, and after the last the
    first again.

    Args:
        arms: Numbers of the arms: 0 for the built-in one, others are drawn.
        target: Folder to make, which must not be there.

    Raises:
        InputError: If the folder is there already.
        RunError: If a case did not come to its end; nothing is left then.
    """
    check_target(target)
    draft = target.with_name(target.name + ".part")
    shutil.rmtree(draft, ignore_errors=True)
    draft.mkdir(parents=True)
    cases = parts(request, arms, draft)
    done = _written(cases, draft, store, pool, tell)
    for word in dict.fromkeys(own.robot for own, _ in cases):
        describe(load(word), draft / OPEN / "robots")
        (draft / OPEN / "robots" / load(word).name / "robot.toml").unlink(True)
    _write_rest(request, done, draft)
    draft.rename(target)


def check_target(target: Path) -> None:
    """Refuse a folder that is there already."""
    if target.exists():
        raise InputError(f"--export {target} is there already; name a new folder.")
    if not target.parent.is_dir():
        raise InputError(f"--export {target}: there is no folder '{target.parent}'.")


def parts(request: StudyRequest, arms: Sequence[int], folder: Path) -> list[Part]:
    """Return the cases, each with the study that has its arm."""
    every = drafts(request)
    arm_of = [arms[d.excitation.index % len(arms)] for d in every]
    robots = folder / OPEN / "robots"
    drawn = sorted(set(arm_of) - {0})
    words = {k: str(drawn_arm(robots, request.seed, k)) for k in drawn}
    own = {k: replace(request, robot=words.get(k, request.robot)) for k in arm_of}
    return [(own[k], d) for k, d in zip(arm_of, every, strict=True)]


def _written(
    cases: Sequence[Part],
    folder: Path,
    store: Path,
    pool: Runs,
    tell: Progress | None,
) -> dict[str, Mapping]:
    wanted = {d.excitation.index: (own, d.excitation) for own, d in cases}
    minima, lost = null_sizes(list(wanted.values()), store, tell, pool)
    if lost:
        raise RunError(lost[0])
    digits = max(3, len(str(len(cases))))
    jobs = [
        Job(
            f"case_{draft.index + 1:0{digits}}",
            own,
            draft,
            minima[draft.excitation.index],
            folder,
            store,
        )
        for own, draft in cases
    ]
    work = [partial(write_case, job) for job in jobs]
    done = {}
    for count, (at, value, why) in enumerate(outcomes(pool, work), start=1):
        if value is None:
            raise RunError(f"{jobs[at].name}: {why}")
        done[jobs[at].name] = value
        if tell:
            tell(f"{jobs[at].name} written, {count} of {len(jobs)}", count / len(jobs))
    return dict(sorted(done.items()))


def _write_rest(
    request: StudyRequest, done: Mapping[str, Mapping], folder: Path
) -> None:
    """Write what is not of a single case: lists, truth, words and the judge."""
    opened = {name: case["open"] for name, case in done.items()}
    study = {k: v for k, v in asdict(request).items() if k != "robot"}
    truth = {
        "format": FORMAT,
        "study": study,
        "classes": classes(),
        "cases": {name: case["sealed"] for name, case in done.items()},
    }
    (folder / SEALED).mkdir(exist_ok=True)
    _json(folder / OPEN / "cases.json", {"format": FORMAT, "cases": opened})
    _json(folder / OPEN / "classes.json", words())
    _json(folder / SEALED / "truth.json", truth)
    shutil.copyfile(_HERE / "README.md", folder / "README.md")
    shutil.copyfile(_HERE / "score.py", folder / SEALED / "score.py")


def _json(path: Path, content: Mapping) -> None:
    text = json.dumps(content, indent=1, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")
