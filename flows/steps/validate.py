"""Validate models on runs of the store, without a fit (G2017 section 1.3).

Of the nominal model, as root mean square per joint:

- open loop: the model alone under the logged torque, minus what was measured;
- feed-forward: how the arm tracks its reference when the model's torque drives it.
  It needs the arm, so it exists only for a simulated run with its sealed half.

Of every model of the robot (nominal, identified, augmented, adopted) both ways: torque
from motion, acceleration from torque, and whether its mass matrix is positive definite
on the workspace. With an adopted or a named model also how the simulated arm tracks the
reference of the run, driven once by the torque of each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter

import numpy as np
from scipy.interpolate import CubicSpline

from flows.inputs import load_command_robot
from flows.requests import Validate as Request
from flows.settings import resolve_store_folder
from flows.steps.experiment import parse_sealed_plant
from flows.steps.fit import read_controller_model
from flows.steps.model_choice import NOMINAL, check_description
from flows.storage import read_models
from residual import one_blas_thread
from residual.errors import InputError
from residual.export.model_export import AnyModel, remove_tables
from residual.model.compare import compute_model_errors, prepare_held_out
from residual.model.dynamics import (
    POSES,
    compute_acceleration_error,
    compute_feed_forward,
    find_least_mass_eigenvalue,
)
from residual.model.model import Model
from residual.model.nominal import build_free_nominal, choose_declared_effects, prepare_fit_logs
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.track import FilterSettings, build_tracks
from sim.engine.plant_records import ReferenceMotion, TrajectorySpec
from sim.experiment import (
    measure_tracking_errors,
    simulate_nominal_twin,
    simulate_open_loop_windows,
)
from sim.plant import step_tables as at
from sim.plant.closed_loop import SimulationDivergedError, build_and_simulate
from sim.trajectories import plan_reference_motion
from warehouse.code_provenance import hash_plant_code
from warehouse.record_commit import build_run_columns, commit_record
from warehouse.record_ids import build_seal_path
from warehouse.remote_store import record_exists
from warehouse.store_catalogue import (
    find_last_adoption,
    find_record,
    open_seal,
    read_manifest,
    read_run,
)
from warehouse.view_schema import build_view_table

Array = np.ndarray

OPEN_LOOP, FEED_FORWARD = "rms_open_loop_q", "rms_feed_forward_q"
TORQUE, ACCELERATION = "percent_moving_tau", "percent_moving_qdd"
TRACKING = "rms_tracking_q"
_RATE = 1000.0  # Hz, about: the step of the engine, whatever the rate of the log
_SHORTEST = 0.01  # s: a shorter window shows no deviation


@dataclass(frozen=True, eq=False, slots=True)
class ModelValidation:
    """Errors of one model on a run, on samples where the joint moves.

    Attributes:
        torque: 100 ||tau - tau_hat|| / ||tau||, from motion [%]. Shape (dof,).
        acceleration: The same for qdd, from torque [%]; None where there is none.
            Shape (dof,).
        least_mass: Smallest eigenvalue of M(q) over random poses [kg m^2].
        tracking: Root mean square of measured minus reference position, where the torque
            of the model drives the arm [rad]; None without an arm. Shape (dof,).
    """

    torque: Array
    acceleration: Array | None
    least_mass: float
    tracking: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Validation:
    """The validation of models on one run.

    Attributes:
        window: Length of the simulated windows [s].
        open_loop: Error of the nominal model under the logged torque [rad]. (dof,)
        nominal: Tracking error with the nominal torque [rad]. (dof,) or None.
        arm: Tracking error with the arm's own torque [rad]. (dof,) or None.
        notes: Remarks, a line each.
        models: Errors of each model on the run, by its name.
    """

    window: float
    open_loop: Array
    nominal: Array | None = None
    arm: Array | None = None
    notes: tuple[str, ...] = ()
    models: Mapping[str, ModelValidation] = field(default_factory=dict)

    @property
    def kind(self) -> str:
        """The kind of validation, as in the store."""
        return "open_loop" if self.nominal is None else "open_loop,feed_forward"


@one_blas_thread
def validate(request: Request) -> tuple[str, Validation]:
    """Validate models on a run, and store the result.

    Returns:
        The id of the validation, the same for the same run and window; and the errors.

    Raises:
        InputError: If there is no such run, its robot is described differently now,
            the window is not usable, or the seal is broken.
    """
    store, window = resolve_store_folder(request.store), request.window
    begun = perf_counter()
    log = read_run(store, request.run)
    manifest = read_manifest(store, log.id)
    word = manifest.get("robot", log.robot)
    robot = load_command_robot(word)
    check_description(robot, log, manifest, word)
    strayed, used = compute_open_loop_error(robot, log, window)
    serial = manifest.get("serial") or robot.serial
    request = _with_ids(request, store, replace(robot, serial=serial))
    nominal = build_nominal_model(robot, [log])
    models: dict[str, AnyModel] = {NOMINAL: nominal}
    if request.model is not None:
        if find_record(store, request.model).kind == "diagnoses":
            models |= read_models(store, request.model) | models
        else:
            models["model"] = read_controller_model(store, request.model, robot, nominal)
    if request.adopted not in (NOMINAL, request.model):
        models["adopted"] = read_controller_model(store, request.adopted, robot)
    both = {name: validate_model(model, log) for name, model in models.items()}
    tracked = {}
    notes = ["No feed-forward: no simulated arm is sealed with the run."]
    # A missing seal is no error, a broken one is.
    if manifest["sealed_sha256"] and record_exists(build_seal_path(store, log.id)):
        notes = _notes(manifest)
        # The arm's own torque is that of the paper's closed loop on this motion: about
        # the best that a model could compute. It is no bound, since it contains
        # feedback, which the drives then add once more.
        plant = parse_sealed_plant(open_seal(store, log.id).spec)
        reference = _reference(robot, manifest)
        sources = (
            simulate_nominal_twin(robot, reference),
            build_and_simulate(robot, reference, plant),
        )
        tracked = {
            name: _rms(measure_tracking_errors(robot, reference, plant, trace.rows[:, at.DRIVE]))
            for name, trace in zip((NOMINAL, "arm"), sources, strict=True)
        }
        motion = reference.q, reference.qd, reference.qdd
        for name, model in models.items() if len(models) > 1 else ():
            torque = compute_feed_forward(model, reference.t, motion)
            error = measure_tracking_errors(robot, reference, plant, torque)
            both[name] = replace(both[name], tracking=_rms(error))
    if used < window:
        notes.insert(0, f"The model diverges in windows of {window:g} s; shortened to {used:g} s.")
    notes += [
        f"M(q) of the {name} model is not positive definite: {each.least_mass:.3g} "
        f"kg m^2 at some pose of {POSES}. It predicts torque, but cannot be simulated."
        for name, each in both.items()
        if each.least_mass <= 0
    ]
    result = Validation(used, strayed, **tracked, notes=tuple(notes), models=both)
    common = {"run_id": log.id, "trajectory": build_run_columns(manifest)["trajectory"]}
    record = {
        "robot": log.robot,
        "kind": result.kind,
        "window_s": used,
        "request": replace(request, run=log.id).to_record()
        | {"robot": word, "robot_hash": robot.content_hash},
        "unit": "rad",
        "notes": result.notes,
        "least_mass_matrix": {name: each.least_mass for name, each in both.items()},
    }
    named = (request.model, request.adopted)
    ids = dict.fromkeys(id for id in named if id not in (None, NOMINAL))
    parents = {"run": [log.id], **({"model": list(ids)} if ids else {})}
    rows = [{**common, **row} for row in _error_rows(result)]
    tables = {"errors": build_view_table("errors", rows)}
    took = {"validate": perf_counter() - begun}
    id = commit_record(store, "validations", record, tables, parents, seconds=took)
    return id, result


def build_nominal_model(robot: Robot, logs: Sequence[Recording]) -> Model:
    """Return the robot as described, with the effects that it declares.

    Args:
        logs: Logs that set the threshold of standstill.
    """
    prepared = prepare_fit_logs(robot, logs, None, FilterSettings())
    return build_free_nominal(prepared, choose_declared_effects(robot, None)).model


def validate_model(model: AnyModel, log: Recording) -> ModelValidation:
    """Return the errors of a model on a log: torque from motion, motion from torque."""
    body = remove_tables(model)
    errors, _ = compute_model_errors({NOMINAL: model}, prepare_held_out([log], body), body.filters)
    torque = errors[NOMINAL].per_joint("moving")
    try:
        acceleration = compute_acceleration_error(model, [log]).per_joint("moving")
    except InputError:
        acceleration = None
    return ModelValidation(torque, acceleration, find_least_mass_eigenvalue(body))


def _with_ids(request: Request, store: Path, robot: Robot) -> Request:
    """Return a request with complete ids, and with the adopted model."""
    if request.model == NOMINAL:
        return replace(request, model=None, adopted=NOMINAL)
    now = request.adopted
    if now is None:
        last = find_last_adoption(store, robot.name, robot.serial)
        now = (last and last[1].diagnosis_id) or NOMINAL
    ids = [
        word if word in (None, NOMINAL) else find_record(store, word).id
        for word in (request.model, now)
    ]
    return replace(request, model=ids[0], adopted=ids[1])


def compute_open_loop_error(robot: Robot, log: Recording, window: float) -> tuple[Array, float]:
    """Return the error of simulated windows, each started at the measured state.

    A poor model may turn a light wrist right over within a window. Windows are then
    halved, for all joints alike, until the model stays near the measured motion.

    Args:
        window: Length of a window [s].

    Returns:
        Root mean square over all samples [rad], shape (dof,); and the length [s].

    Raises:
        InputError: If the window is not usable, or the model never stays near.
    """
    if not _SHORTEST <= window <= log.duration:
        raise InputError(
            f"--window {window:g}: expected {_SHORTEST:g} s to the length of the run, "
            f"{log.duration:g} s; the default is 0.25."
        )
    motion, torque = _measured(log)
    while window >= _SHORTEST:
        try:
            return _rms(simulate_open_loop_windows(robot, motion, torque, window)), window
        except SimulationDivergedError:
            window /= 2
    raise InputError(
        f"Under the torque of run {log.id} the nominal model diverges within "
        f"{2 * window:g} s. Check units and signs of the log, and the robot's inertias."
    )


def _measured(log: Recording) -> tuple[ReferenceMotion, Array]:
    """Return the motion and torque of a log, at the step of the engine.

    The motion is that of the diagnosis, low-passed, interpolated by a cubic spline: then
    velocities and accelerations are exactly those of its positions.
    """
    (track,), _ = build_tracks((log,), FilterSettings(), full_rate=True)
    rate = track.rate * max(1, round(_RATE / track.rate))
    since = np.arange(round((track.t[-1] - track.t[0]) * rate) + 1) / rate
    curve = CubicSpline(track.t - track.t[0], track.q)
    motion = ReferenceMotion("measured", since, *(curve(since, d) for d in range(3)), None)
    now = track.t[0] + since
    return motion, np.column_stack([np.interp(now, log.t, c) for c in log.tau.T])


def _rms(error: Array) -> Array:
    return np.sqrt(np.mean(np.square(error), axis=0))


def _reference(robot: Robot, manifest: Mapping) -> ReferenceMotion:
    spec = manifest["spec"]
    try:
        motion = TrajectorySpec.from_record(spec["trajectory"])
        return plan_reference_motion(robot, motion, spec["rates"]["control"])
    except (KeyError, TypeError) as error:
        raise InputError(
            "The record of the run does not say which reference it had, expected "
            "'trajectory' and 'rates' in its spec. Run its experiment again."
        ) from error


def _notes(manifest: Mapping) -> list[str]:
    notes, start = [], manifest["spec"].get("start", 0.0)
    if manifest["provenance"]["code_hash"] != hash_plant_code():
        notes.append(
            "The plant code has changed since this run: feed-forward drives the arm of "
            "the present code, not exactly the logged one."
        )
    if start > 0:
        notes.append(
            f"The run began {start:g} s into its session; feed-forward starts at 0 s, "
            "with cold gears."
        )
    return notes


def _error_rows(result: Validation) -> list[dict]:
    figures = [
        (NOMINAL, OPEN_LOOP, result.open_loop),
        (NOMINAL, FEED_FORWARD, result.nominal),
        ("arm", FEED_FORWARD, result.arm),
    ]
    for name, each in result.models.items():
        figures += [
            (name, TORQUE, each.torque),
            (name, ACCELERATION, each.acceleration),
            (name, TRACKING, each.tracking),
        ]
    return [
        {"stage": stage, "metric": metric, "joint": joint, "value": float(value)}
        for stage, metric, errors in figures
        if errors is not None
        for joint, value in enumerate(errors, 1)
    ]
