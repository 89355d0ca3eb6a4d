"""Run experiments on the simulated arm: spec, reference, plant, store.

A campaign has no journal: the id of a run identifies its spec, and a run is in the
store completely or not at all. So the same command completes an interrupted campaign.
"""

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path
from time import perf_counter

import numpy as np
from pydantic import TypeAdapter

from flows.inputs import load_command_robot
from flows.outputs import Progress
from flows.settings import count_cores, resolve_store_folder
from flows.specs import (
    NOMINAL,
    CampaignEntry,
    ControllerTable,
    ExperimentSpec,
    format_point,
    load_campaign,
)
from flows.steps.fit import read_controller_model
from flows.steps.model_choice import choose_model
from flows.workers import ProcessExecutor, run_jobs
from residual import one_blas_thread
from residual.calibration.calibration_rows import CalibrationRun
from residual.drive import Drive
from residual.errors import InputError, RunError, build_missing_package_error
from residual.model.dynamics import (
    FrictionReversal,
    build_computed_torque_law,
    compute_feed_forward,
)
from residual.recording import Recording, apply_drive
from residual.robot.robot import Robot
from sim.effects import load_effects
from sim.engine.plant_records import NAMES, PlantSpec, ReferenceMotion, TrajectorySpec
from sim.experiment import compute_log_twin_errors, run_experiment
from sim.plant.closed_loop import check_servo
from sim.plant.effect_catalogue import check_effect
from sim.trajectories import plan_reference_motion
from warehouse import record_ids
from warehouse.code_provenance import hash_plant_code
from warehouse.record_commit import commit_record, commit_run
from warehouse.record_ids import build_record_path, convert_to_json_types
from warehouse.remote_store import format_store_name, record_exists
from warehouse.robots import store_robot_description
from warehouse.store_catalogue import SealedTruth, find_record, hash_sealed_spec
from warehouse.view_schema import build_view_table

_LATER = ("background", "worked_before", "drive")
_PLANT = TypeAdapter(PlantSpec)


@dataclass(frozen=True, slots=True)
class PlannedExperiment:
    """An experiment whose id is known before it is run."""

    label: str  # what it is, for people
    spec: ExperimentSpec  # what to run
    run_id: str  # the id that its run has or will have
    stored: bool  # whether the run is in the store
    campaign: str | None = None  # name of the campaign that it is of, None for none
    # What the campaign varies and the store may show, by axis.
    points: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class SimulatedExperiment:
    """An experiment that was run and is not stored yet."""

    log: Recording  # what the arm logged
    twin: Mapping  # its errors against the nominal twin, by channel
    truth: Mapping  # what no robot logs, by channel
    manifest: Mapping  # how it came to be
    hidden: Mapping  # the sealed half of its spec


def plan_experiments(
    specs: Iterable[tuple[str, ExperimentSpec] | CampaignEntry],
    store: Path,
    campaign: str | None = None,
) -> list[PlannedExperiment]:
    """Return what would run and what is there; the same experiment only once."""
    planned: dict[str, PlannedExperiment] = {}
    for label, requested, *points in specs:
        try:
            spec = resolve_controller_model(requested, store)
            id = compute_run_id(spec)
        except InputError as error:
            where = f"{campaign}: {label}" if campaign else Path(label).name
            raise InputError(f"{where}: {error}") from error
        if id not in planned:
            stored = is_stored(store, spec, id)
            known = (label, spec, id, stored, campaign)
            planned[id] = PlannedExperiment(*known, *points[:1])
    return list(planned.values())


def store_campaign(planned: Sequence[PlannedExperiment], file: str, store: Path) -> str | None:
    """Put the record of a campaign into the store, before its runs; return its id.

    It has the open points of all its runs, also of those that fail; it has no sealed
    point, not even in a label.
    """
    if not planned:
        return None
    rows = [
        {"run_id": each.run_id, **_point_row(axis, value, each.spec)}
        for each in planned
        for axis, value in each.points.items()
    ]
    record = {
        "robot": load_spec_robot(planned[0].spec).name,
        "name": planned[0].campaign,
        "file": Path(file).name,
        "labels": {each.run_id: format_point(each.points) for each in planned},
    }
    tables = {"points": build_view_table("points", rows)}
    parents = {"point": [each.run_id for each in planned]}
    return commit_record(store, "campaigns", record, tables, parents)


_UNITS = {"start": "s", "duration": "s", "worked_before": "s", "onset": "s"}
_UNITS |= {"control": "Hz", "log": "Hz", "encoder_step": "rad", "rise": "s"}


def _point_row(axis: str, value: object, spec: ExperimentSpec) -> dict:
    """Return a value of an axis as the view points has it."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        word = value if isinstance(value, str) else json.dumps(value)
        return {"axis": axis, "word": word}
    *tables, key = axis.split(".")
    unit = _UNITS.get(key)
    if tables[:2] == ["plant", "effect"] and unit is None:
        number = int(tables[2]) - 1 if len(tables) > 2 else 0
        name = spec.plant.effect[number].name
        unit = load_effects()[name].parameters.get(key)
    return {"axis": axis, "value": float(value), "unit": unit}


def name_arm(spec: ExperimentSpec, robot: Robot) -> str | None:
    """Return the serial number of a simulated arm, derived from its definition.

    None if neither a serial number nor a seed of the plant identifies the arm.
    """
    plant = spec.plant
    if spec.serial is not None or plant.seed is None:
        return spec.serial
    makes = (plant.scatter, plant.background, plant.seed, plant.salt)
    return record_ids.hash_values(robot.content_hash, *makes)[:8]


def compute_run_id(spec: ExperimentSpec) -> str:
    """Return the id of an experiment, without running it."""
    robot = load_spec_robot(spec)
    hidden = hash_sealed_spec(build_sealed_record(spec.plant_spec()))
    return record_ids.compute_simulated_run_id(
        build_public_record(spec, robot), hidden, hash_plant_code()
    )


def is_stored(store: Path, spec: ExperimentSpec, run_id: str) -> bool:
    """Return whether a run is in the store."""
    return record_exists(build_record_path(store, "runs", run_id, load_spec_robot(spec).name))


def simulate_and_store(spec: ExperimentSpec, store: Path, campaign: str | None = None) -> str:
    """Run one experiment and store it; one that is stored is not run again.

    Raises:
        InputError: If the motion breaks a limit of the arm (which joint, when, by how
            much) or the simulation diverges; then nothing is stored.
    """
    spec = resolve_controller_model(spec, store)
    id = compute_run_id(spec)
    if is_stored(store, spec, id):
        return id
    simulated, robot = simulate_experiment(spec, store), load_spec_robot(spec)
    store_robot_description(store, spec.robot, robot)
    about = {"campaign": campaign, "serial": name_arm(spec, robot), "tags": spec.tags}
    known = {key: value for key, value in about.items() if value}
    simulated = replace(simulated, manifest={**simulated.manifest, **known})
    return store_experiment(simulated, store)


def simulate_experiment(spec: ExperimentSpec, store: Path | None = None) -> SimulatedExperiment:
    """Run one experiment, whether or not it is stored; nothing is written.

    Args:
        spec: What to run, the model of its controller named by a whole id.
        store: Where that model is; None where the nominal one drives.
    """
    robot, model = load_spec_robot(spec), spec.controller.model
    simulated, timings = _simulate(spec, robot, store)
    manifest = {
        "spec": build_public_record(spec, robot),
        "robot": spec.robot,
        "robot_hash": robot.content_hash,
        "seed_streams": {"reference": spec.reference().seed, "sealed": list(NAMES)},
        "timings": timings,
        "parents": {} if model == NOMINAL else {"controller": [model]},
    }
    return SimulatedExperiment(
        simulated.log,
        simulated.twin,
        simulated.truth,
        manifest,
        build_sealed_record(spec.plant_spec()),
    )


def store_experiment(
    simulated: SimulatedExperiment, store: Path, parents: Mapping | None = None
) -> str:
    """Store an experiment that was run."""
    lineage = {**simulated.manifest.get("parents", {}), **(parents or {})}
    manifest = {**simulated.manifest, "parents": lineage}
    if not lineage:
        del manifest["parents"]
    sealed = SealedTruth(simulated.hidden, simulated.truth)
    return commit_run(store, simulated.log, manifest, sealed, simulated.twin)


def build_public_record(spec: ExperimentSpec, robot: Robot) -> dict:
    """Return the public half of an experiment, for its record."""
    reference, driver = spec.reference(), {}
    # Keys of later versions are written only if they differ from the default, so that
    # the ids of runs do not change.
    if spec.controller.model != NOMINAL:
        usual = ControllerTable()
        late = ("encoder_step", "rise")
        same = {n for n in late if getattr(spec.controller, n) == getattr(usual, n)}
        driver = {"controller": spec.controller.model_dump(exclude=same)}
    if spec.drive is not None:
        driver["drive"] = spec.drive.model_dump(exclude_defaults=True)
    motion = asdict(reference)
    if not reference.coefficients:
        del motion["coefficients"]
    return {
        **driver,
        "schema": spec.schema_,
        "robot": {"name": robot.name, "content_hash": robot.content_hash},
        "declared": sorted(robot.declared),
        "trajectory": motion,
        "seed": reference.seed,
        "start": spec.start,
        "rates": asdict(spec.log_rates()),
    }


def build_sealed_record(plant: PlantSpec) -> dict:
    """Return the sealed half, hidden from the diagnosis.

    Keys of later versions are omitted at their defaults, so that seals of earlier
    versions stay valid.
    """
    later = {name: getattr(PlantSpec(), name) for name in _LATER}
    half = asdict(plant)
    return {k: v for k, v in half.items() if k not in later or v != later[k]}


def parse_sealed_plant(sealed: Mapping) -> PlantSpec:
    """Return the plant of a sealed half: `build_sealed_record` undone."""
    try:
        plant = _PLANT.validate_python(sealed)
    except ValueError:
        plant = None
    # An extra or missing key would silently give another arm. The hidden values stay
    # hidden: neither the message nor its cause contains any.
    whole = [] if plant is None else [build_sealed_record(plant), asdict(plant)]
    if convert_to_json_types(sealed) not in map(convert_to_json_types, whole):
        raise InputError(
            "The sealed half of the run has another form than expected: effects, "
            "scatter, noise, seed, salt and background. Run its experiment again."
        )
    return plant


def load_spec_robot(spec: ExperimentSpec) -> Robot:
    """Return the arm, checked against the hidden half of the spec."""
    robot = _robot(spec.robot)
    for effect in spec.plant_spec().effects:
        check_effect(effect, robot)
    check_servo(spec.plant_spec().drive, robot)
    return robot


@lru_cache(maxsize=8)
def _robot(name: str) -> Robot:
    return load_command_robot(name)


@one_blas_thread
def _simulate(spec: ExperimentSpec, robot: Robot, store: Path | None) -> tuple:
    rates, clock = spec.log_rates(), [perf_counter()]
    reference = plan_reference(robot, spec.reference(), rates.control)
    given, table = None, spec.controller
    if table.model != NOMINAL:
        if store is None:
            raise InputError(f"Model {table.model} of the controller needs a store.")
        law = compute_feed_forward if table.kind == "feed_forward" else build_computed_torque_law
        given = law(
            read_controller_model(store, table.model, robot),
            reference.t,
            (reference.q, reference.qd, reference.qdd),
            FrictionReversal(table.encoder_step, rise=table.rise),
        )
    clock.append(perf_counter())
    plant = spec.plant_spec()
    simulated = run_experiment(robot, reference, plant, rates, spec.start, given)
    if spec.drive is not None:
        drive = Drive(**spec.drive.model_dump())
        simulated = replace(simulated, log=apply_drive(simulated.log, drive))
    clock.append(perf_counter())
    seconds = (round(b - a, 3) for a, b in pairwise(clock))
    return simulated, dict(zip(("reference_s", "plant_s"), seconds, strict=True))


@lru_cache(maxsize=12)
def plan_reference(robot: Robot, spec: TrajectorySpec, rate: float) -> ReferenceMotion:
    """Return a motion; cached, since many arms may run the same one."""
    return plan_reference_motion(robot, spec, rate)


def explain_infeasible_motion(planned: PlannedExperiment) -> str | None:
    """Plan the motion of an experiment; nothing is simulated, nothing is written.

    Returns:
        Why it would fail: the limit of range, speed, acceleration or torque that its
        motion breaks. None where the motion is possible; only the run itself shows
        whether the arm diverges.
    """
    spec = planned.spec
    try:
        plan_reference(load_spec_robot(spec), spec.reference(), spec.log_rates().control)
    except InputError as error:
        return str(error)
    return None


def format_reference_csv(reference: ReferenceMotion) -> str:
    """Return t [s], q1.. [rad], qd1.. [rad/s] and qdd1.. [rad/s^2] as CSV text."""
    joints = range(1, reference.q.shape[1] + 1)
    names = [f"{name}{joint}" for name in ("q", "qd", "qdd") for joint in joints]
    parts = [reference.t[:, None], reference.q, reference.qd, reference.qdd]
    text = io.StringIO()
    values = np.hstack(parts).round(9) + 0.0  # + 0 makes of -0 a 0
    np.savetxt(text, values, "%.9f", ",", header=",".join(["t", *names]), comments="")
    return text.getvalue()


def add_twin_errors(robot: Robot, runs: Sequence[CalibrationRun]) -> tuple[CalibrationRun, ...]:
    """Return runs with their errors against a twin on their own reference.

    Runs that have a twin, or no reference, are unchanged.
    """
    return tuple(
        run
        if run.log.q_ref is None or "e_tau" in run.twin
        else replace(run, twin=compute_log_twin_errors(robot, run.log))
        for run in runs
    )


def resolve_controller_model(spec: ExperimentSpec, store: Path) -> ExperimentSpec:
    """Return a spec whose controller names its model by a whole id, not "adopted"."""
    word = spec.controller.model
    if word == NOMINAL:
        return spec
    if word == "adopted":
        robot = _robot(spec.robot)
        arm = replace(robot, serial=name_arm(spec, robot) or robot.serial)
        word = choose_model(arm, store=store).diagnosis or NOMINAL
    else:
        word = find_record(store, word).id
    table = spec.controller.model_copy(update={"model": word})
    return spec.model_copy(update={"controller": table})


Runs = dict[str, list[str]]  # ids by role


@dataclass(frozen=True, slots=True)
class CampaignSummary:
    """The result of a campaign."""

    planned: tuple[PlannedExperiment, ...]  # all experiments, in order
    # What failed and why, by the id of its run; all others are in the store.
    failed: Mapping[str, str]
    seconds: float = 0.0  # time that it took

    @property
    def stored(self) -> tuple[str, ...]:
        """Ids of all runs that are in the store now."""
        return tuple(p.run_id for p in self.planned if p.run_id not in self.failed)

    @property
    def new(self) -> tuple[str, ...]:
        """Ids of those that were not there before."""
        known = {p.run_id for p in self.planned if p.stored}
        return tuple(id for id in self.stored if id not in known)


def run_campaign_experiments(
    planned: Sequence[PlannedExperiment],
    store: Path,
    tell: Progress | None = None,
    executor: Executor | None = None,
) -> CampaignSummary:
    """Run what is not in the store, in as many processes as there are cores.

    Returns:
        Their results; a failure is a result and raises nothing.

    Raises:
        InputError: If the engine of simulated arms is not installed.
    """
    missing = [p for p in planned if not p.stored]
    if missing and find_spec("pybullet") is None:  # reported once, not per experiment
        raise build_missing_package_error("pybullet")
    begun, failed = perf_counter(), {}
    if missing and executor is None:
        with ProcessExecutor(min(count_cores(), len(missing))) as ours:
            return run_campaign_experiments(planned, store, tell, ours)
    # The store's name and not its folder: on another machine that is another one.
    work = partial(run_planned_experiment, store=format_store_name(store))
    done = run_jobs(executor, work, missing) if executor else ()
    for count, each in enumerate(done, start=1):
        at = missing[each.index]
        if why := _line(each.error) or explain_missing_run(at, each.value, store):
            failed[at.run_id] = f"{at.label}: {why}"
        if tell:
            word = "failed" if why else "stored"
            tell(f"{word} {count} of {len(missing)}: {at.label}", count / len(missing))
    return CampaignSummary(tuple(planned), failed, round(perf_counter() - begun, 2))


def advise_on_failures(summary: CampaignSummary) -> str:
    """Return what to do about the failures of a campaign, in two sentences."""
    return (
        f"{len(summary.failed)} of {len(summary.planned)} experiments failed (see "
        "above). A spec that cannot run fails again: change or remove it. The same "
        "command reruns those that a lost process, disk or network interrupted."
    )


def build_campaign_document(summary: CampaignSummary, done: bool = True) -> dict:
    """Return the JSON of a campaign: every experiment, in its order.

    Args:
        done: Whether it was run; else what is not stored is "to run".
    """
    new = summary.new

    def state(each: PlannedExperiment) -> str:
        if each.run_id in summary.failed:
            return "failed" if done else "will fail"
        if each.run_id in new:
            return "stored" if done else "to run"
        return "was there"

    return {
        "schema": 1,
        "campaign": next((p.campaign for p in summary.planned), None),
        "runs": [
            {
                "run_id": each.run_id,
                "label": each.label,
                "state": state(each),
                "why": summary.failed.get(each.run_id),
            }
            for each in summary.planned
        ],
        "seconds": summary.seconds if done else None,
    }


def plan_campaign(path: str, store: Path, seed: int | None) -> list[PlannedExperiment]:
    """Return the experiments of a campaign, of one robot, and which of them are stored."""
    entries = load_campaign(path, seed)
    robots = {entry.spec.robot for entry in entries}
    if len(robots) > 1:
        raise InputError(f"{path} has {len(robots)} robots; expected one.")
    return plan_experiments(entries, store, Path(path).stem)


def group_runs_by_role(path: str, proof: str, summary: CampaignSummary) -> Runs:
    """Return the stored runs of a campaign: fit, and held_out those of one kind of motion."""
    runs: Runs = {"fit": [], "held_out": []}
    for each in summary.planned:
        if each.run_id in summary.stored:
            kind = each.spec.trajectory.kind
            role = "held_out" if kind == proof else "fit"
            runs[role].append(each.run_id)
    if not runs["fit"]:
        all_out = f"all motions are '{proof}', held out"
        why = next(iter(summary.failed.values()), all_out)
        raise RunError(f"{path} has no run to fit: {why}.")
    return runs


def explain_failures(
    batch: Sequence[PlannedExperiment], error: BaseException, store: Path
) -> dict[str, str]:
    """Return why experiments of a batch that failed are not in the store, by run."""
    lost = [p for p in batch if not is_stored(store, p.spec, p.run_id)]
    return {each.run_id: f"{each.label}: {_line(error)}" for each in lost}


def run_planned_experiment(planned: PlannedExperiment, store: str) -> str:
    """Run one experiment of a campaign; returns the id of its run."""
    return simulate_and_store(planned.spec, resolve_store_folder(store), planned.campaign)


def explain_missing_run(planned: PlannedExperiment, run_id: str, store: Path) -> str:
    """Return why a run that was stored is not where it should be; "" where it is."""
    # A process loads the code again, and the id of a run depends on the code.
    if run_id != planned.run_id:
        return f"stored as {run_id}: the code has changed since the start"
    if not is_stored(store, planned.spec, run_id):
        return (
            f"stored elsewhere than in {format_store_name(store)}: a cluster needs a store on "
            "object storage (--store s3://BUCKET/PREFIX), or a file system that all "
            "its machines share"
        )
    return ""


def _line(error: BaseException | None) -> str:
    return " ".join(str(error).split()) if error else ""
