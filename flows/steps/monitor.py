"""Monitor the sensors of runs against healthy runs of the same arm."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from time import perf_counter

from flows.inputs import is_run_id, load_run_robot, read_file_serial, read_run_serial
from flows.requests import Monitor as Request
from flows.settings import HEALTHY, resolve_store_folder
from flows.steps.model_choice import AUGMENTED, check_description, resolve_adopted_model
from flows.storage import read_models, read_runs
from residual import one_blas_thread
from residual.errors import InputError
from residual.identification.identify import identify
from residual.model.model import Model
from residual.monitoring.monitor import LEAST_RUNS, Alarm, Monitor, calibrate_monitor
from residual.recording import Recording
from warehouse.queries import query_store_rows
from warehouse.record_commit import commit_record
from warehouse.remote_store import format_store_name
from warehouse.store_catalogue import (
    find_record,
    find_run,
    list_record_folders,
    read_manifest,
    read_quarantine_reason,
    read_record,
    read_run,
)
from warehouse.view_schema import build_view_table

MOST_HEALTHY = 12  # of them are read


@dataclass(frozen=True, eq=False, slots=True)
class MonitoringResult:
    """A calibrated monitor, and the alarms of the monitored runs."""

    monitor: Monitor  # the monitor, calibrated
    calibration: tuple[str, ...]  # ids of the healthy runs
    alarms: Mapping[str, tuple[Alarm, ...]]  # alarms of each monitored run, by its id
    seconds: float  # length of all watched runs [s]

    @property
    def notes(self) -> tuple[str, ...]:
        """Remarks on the result, a line each."""
        out, hours = [], self.monitor.hours
        if self.monitor.per_hour * hours < 1:
            out.append(
                f"The healthy runs last {60 * hours:.3g} min in total: the rate of "
                f"{self.monitor.per_hour:g} false alarms an hour is extrapolated."
            )
        if not self.monitor.referenced:
            out.append("q_ref is not logged: tracking errors are not monitored.")
        return tuple(out)


@one_blas_thread
def monitor(request: Request) -> tuple[str, MonitoringResult, dict[str, Recording]]:
    """Calibrate a monitor, monitor runs, and store the alarms.

    Returns:
        The id of the record, the result, and the watched runs by their id.
    """
    store, begun = resolve_store_folder(request.store), perf_counter()
    diagnosis = _diagnosis_in(request.model, store)
    good = request.good or (diagnosis and _behind(diagnosis, store)) or ()
    healthy = read_usable_runs(store, good)
    watched = read_usable_runs(store, request.runs)
    if not watched:
        raise InputError("No run to monitor. Give one: modelgap monitor MODEL RUN ...")
    if not healthy:
        whose = f"diagnosis {diagnosis} has" if diagnosis else "there are"
        raise InputError(
            f"Healthy runs to calibrate on: {whose} none, expected at least "
            f"{LEAST_RUNS}. Name them: --calibrate RUN ..."
        )
    if both := sorted(set(healthy) & set(watched)):
        raise InputError(
            f"Run {both[0]} is both monitored and used to calibrate. Monitor another, or "
            "name the healthy runs with --calibrate."
        )
    if diagnosis:
        model = read_models(store, diagnosis)[AUGMENTED]
        robot = model.robot
        serial = read_record(store, diagnosis).get("serial")
    else:
        robot = load_run_robot(request.model, (*healthy, *watched), store)
        serial = robot.serial
    for run in (*healthy.values(), *watched.values()):
        if robot.name != run.robot:
            raise InputError(
                f"Run {run.id} is of {run.robot}, the model of {robot.name}. Give runs "
                "of the robot, or its own model."
            )
        by = "the model" if diagnosis else request.model
        manifest = read_manifest(store, run.id)
        check_description(robot, run, manifest, by)
        arm = manifest.get("serial") or read_file_serial(robot)
        if arm != serial:
            raise InputError(
                f"Run {run.id} is of the arm {arm or 'without a number'}, {by} of the "
                f"arm {serial or 'without a number'}. Give runs and a model of one arm."
            )
    if not diagnosis:
        model = identify(robot, list(healthy.values())).model
    result = monitor_recordings(model, healthy, watched, request.per_hour)
    record = {
        "robot": robot.name,
        "kind": "monitor",
        "model_id": diagnosis and read_record(store, diagnosis)["model_id"],
        "alarms": {id: len(alarms) for id, alarms in result.alarms.items()},
        "watched_s": result.seconds,
        "request": request.to_record()
        | {
            "model": diagnosis or request.model,
            "runs": list(watched),
            "good": list(healthy),
            "robot": None if diagnosis else request.model,
            "robot_hash": robot.content_hash,
        },
        "notes": result.notes,
        "monitor": result.monitor.to_record(),
    }
    rows = [
        {"run_id": id, **asdict(alarm)} for id, alarms in result.alarms.items() for alarm in alarms
    ]
    parents = {"calibration": list(healthy), "watched": list(watched)}
    if diagnosis:
        parents["diagnosis"] = [diagnosis]
    tables = {"alarms": build_view_table("alarms", rows)}
    took = {"monitor": perf_counter() - begun}
    id = commit_record(store, "validations", record, tables, parents, seconds=took)
    return id, result, watched


@one_blas_thread
def monitor_recordings(
    model: Model,
    healthy: Mapping[str, Recording],
    watched: Mapping[str, Recording],
    per_hour: float,
) -> MonitoringResult:
    """Calibrate a monitor and monitor runs, each by its id; nothing is stored."""
    made = calibrate_monitor(model, list(healthy.values()), per_hour)
    return MonitoringResult(
        monitor=made,
        calibration=tuple(healthy),
        alarms={id: made.watch(run) for id, run in watched.items()},
        seconds=sum(run.duration for run in watched.values()),
    )


@dataclass(frozen=True, slots=True)
class NewRunsMonitoring:
    """The result of monitoring new runs."""

    record: str | None = None  # its id; None where no run was watched
    result: MonitoringResult | None = None  # None where no run was watched
    watched: Mapping[str, Recording] = field(default_factory=dict)  # by their id
    why: str = ""  # why nothing was watched, "" where it was

    @property
    def alarmed(self) -> tuple[str, ...]:
        """Runs with an alarm."""
        alarms = self.result.alarms if self.result else {}
        return tuple(run for run, own in alarms.items() if own)


def monitor_new_runs(
    runs: Sequence[str],
    store: Path,
    model: str | None = None,
    healthy_ids: Sequence[str] = (),
    tag: str = HEALTHY,
) -> NewRunsMonitoring:
    """Monitor new runs of one robot, with its adopted model or its last diagnosis.

    Args:
        model: Id of a diagnosis, or a robot; None for the adopted model, else the
            latest diagnosis.
        healthy_ids: Ids of the healthy runs; empty for those with the tag, or where
            these are too few for those of the diagnosis.
    """
    model = (
        model or resolve_adopted_model(runs, store).diagnosis or find_latest_diagnosis(runs, store)
    )
    if model is None:
        return NewRunsMonitoring(why="No diagnosis of this arm yet: nothing to compare with.")
    healthy = tuple(healthy_ids) or find_healthy_runs(runs, store, tag)
    if not healthy_ids and len(healthy) < LEAST_RUNS:
        diagnosis = _diagnosis_in(model, store)
        healthy = _behind(diagnosis, store) if diagnosis else ()
    new = tuple(run for run in runs if run not in healthy)
    if not new:
        return NewRunsMonitoring(why="All runs are healthy reference runs.")
    if len(healthy) < LEAST_RUNS:
        return NewRunsMonitoring(why=f"{len(healthy)} healthy runs, at least {LEAST_RUNS} needed.")
    return NewRunsMonitoring(*monitor(Request(model, new, good=healthy, store=store)))


def group_runs_by_arm(runs: Sequence[str], store: Path) -> list[list[str]]:
    """Return runs in groups of one arm each: a robot with its serial number."""
    arms: dict[tuple, list[str]] = {}
    for run in runs:
        robot = find_run(store, run).folder.parent.name
        arms.setdefault((robot, read_run_serial(run, store)), []).append(run)
    return list(arms.values())


def find_healthy_runs(runs: Sequence[str], store: Path, tag: str = HEALTHY) -> tuple[str, ...]:
    """Return the latest healthy runs of the arm of some runs, none of these."""
    query = """
        SELECT run_id FROM runs own
        WHERE list_contains(coalesce(tags, []), $tag) AND NOT quarantined
              AND NOT list_contains($runs, run_id)
              AND EXISTS (SELECT 1 FROM runs new WHERE new.run_id = $first
                          AND new.robot = own.robot
                          AND new.serial IS NOT DISTINCT FROM own.serial)
        ORDER BY coalesce(recorded_at, created) DESC, run_id LIMIT $most
    """
    values = {"tag": tag, "runs": list(runs), "first": runs[0], "most": MOST_HEALTHY}
    rows = query_store_rows(store, query, **values)
    return tuple(sorted(row["run_id"] for row in rows))


def find_diagnosis(runs: Sequence[str], store: Path) -> str | None:
    """Return the latest diagnosis that took all of some runs, None where none did."""
    query = """
        SELECT diagnosis_id FROM diagnoses JOIN lineage ON child = diagnosis_id
        WHERE role IN ('fit', 'held_out') AND list_contains($runs, parent)
        GROUP BY diagnosis_id HAVING count(DISTINCT parent) = $count
        ORDER BY any_value(diagnoses.created) DESC, diagnosis_id LIMIT 1
    """
    rows = query_store_rows(store, query, runs=list(runs), count=len(set(runs)))
    return rows[0]["diagnosis_id"] if rows else None


def find_latest_diagnosis(runs: Sequence[str], store: Path) -> str | None:
    """Return the id of the latest diagnosis of the arm of some runs, None if none."""
    robot = find_run(store, runs[0]).folder.parent.name.removeprefix("robot=")
    query = (
        "SELECT diagnosis_id FROM diagnoses WHERE robot = $robot AND "
        "serial IS NOT DISTINCT FROM $serial "
        "ORDER BY created DESC, diagnosis_id LIMIT 1"
    )
    result = query_store_rows(store, query, robot=robot, serial=read_run_serial(runs[0], store))
    return result[0]["diagnosis_id"] if result else None


def read_usable_runs(store: Path, ids: Sequence[str]) -> dict[str, Recording]:
    """Return runs by id, in their order; InputError for one in quarantine, or given twice."""
    out = {}
    for word in ids:
        run = read_run(store, word)
        if read_quarantine_reason(store, run.id):
            raise InputError(f"Run {run.id} is in quarantine. Leave it out.")
        if run.id in out:
            raise InputError(f"Run {run.id} is given twice. Give it once.")
        out[run.id] = run
    return out


def _diagnosis_in(word: str, store: Path) -> str | None:
    """Return the id of the diagnosis that a word names; None where it is a robot."""
    if not word or len(word) > 20 or not is_run_id(word):
        return None
    if not any(id.startswith(word) for id in list_record_folders(store, "diagnoses")):
        raise InputError(
            f"'{word}' is no diagnosis in {format_store_name(store)}. Name a robot such as "
            "irb140, or a diagnosis: modelgap sql 'SELECT diagnosis_id FROM diagnoses'."
        )
    return find_record(store, word).id


def _behind(diagnosis: str, store: Path) -> tuple[str, ...]:
    """Return the healthy runs behind a diagnosis: its baseline, else its fit."""
    runs = read_runs(store, diagnosis, ("baseline",))
    return tuple(sorted(runs or read_runs(store, diagnosis, ("fit",))))
