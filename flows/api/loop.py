"""Simulate an arm, monitor its runs, choose the next motion: what loads `sim`."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from flows.api.logs import advise_in_python, check_recordings
from flows.api.results import Diagnosis, build_log_sets, convert_to_subclass
from flows.outputs import Progress, write_files
from flows.requests import Diagnose
from flows.specs import parse_spec
from flows.steps.experiment import compute_run_id, format_reference_csv, simulate_experiment
from flows.steps.monitor import MonitoringResult, monitor_recordings
from flows.steps.next import check_duration, diagnose_open_question, rank_motions
from residual.errors import InputError
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.robot import Robot
from sim.engine.plant_records import ReferenceMotion
from sim.trajectories import plan_reference_motion
from warehouse.logs import check_logs_distinct

_DEFAULT: Mapping = MappingProxyType({})
RATE = 250.0  # samples per second of a program [Hz]


@dataclass(frozen=True, eq=False, slots=True)
class Experiment:
    """The motion that separates the rivals of a diagnosis.

    Attributes:
        diagnosis: The diagnosis.
        plan: `next_experiment` of a verdict (rivals, `sure_after` [s]); None where
            nothing is open, or no motion separates the rivals.
        reference: The motion: t [s], q, qd, qdd [rad, s]; None where the plan is.
    """

    diagnosis: Diagnosis
    plan: Mapping | None
    reference: ReferenceMotion | None

    def save_program(self, path: str | Path) -> None:
        """Write the motion as CSV for a controller; InputError where there is none."""
        if self.reference is None:
            raise InputError("There is no motion to write: no experiment is proposed.")
        write_files({Path(path): format_reference_csv(self.reference)})


@advise_in_python
def simulate(spec: Mapping = _DEFAULT) -> Recording:
    """Run one experiment on the simulated arm and return its log; nothing is stored.

    Args:
        spec: The content of a SPEC.toml, missing keys at their defaults:
            {"trajectory": {"kind": "cyclic", "duration": 10},
            "plant": {"effect": [{"name": "stribeck", "joints": [2]}]}}.

    Raises:
        InputError: If a key or value is not valid, or PyBullet is missing.
    """
    checked = parse_spec(dict(spec), "spec")
    return replace(simulate_experiment(checked).log, id=compute_run_id(checked))


@advise_in_python
def monitor(
    model: Model, healthy: Sequence[Recording], watched: Sequence[Recording], per_hour: float = 1.0
) -> MonitoringResult:
    """Set the limits of a monitor by healthy logs, and check other logs against them.

    Args:
        model: The model of the residual: of a diagnosis, or adopted.
        healthy: Logs of the healthy arm, three or more.
        watched: Logs to check.
        per_hour: Largest rate of false alarms [1/h].

    Returns:
        `alarms` by the id of the log.

    Raises:
        InputError: If there are too few healthy logs, or one is of another arm.
    """
    given = check_recordings("healthy", healthy), check_recordings("watched", watched)
    check_logs_distinct([*given[0], *given[1]])
    sets = [{log.id: log for log in logs} for logs in given]
    return monitor_recordings(model, *sets, per_hour)


@advise_in_python
def next_experiment(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    baseline: Sequence[Recording] = (),
    seconds: float = 20.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> Experiment:
    """Choose the motion that separates the rivals of a diagnosis soonest.

    Arguments and errors as in ``diagnose``, and:

    Args:
        seconds: Longest duration of the motion, 4 to 600 [s].
        seed: Seed of the motions.
    """
    check_duration(seconds)
    logs = build_log_sets(robot, fit, baseline, held_out)
    outcome, question = diagnose_open_question(Diagnose(robot=robot.name), logs, progress)
    diagnosis = convert_to_subclass(Diagnosis, outcome)
    best = rank_motions(question, robot, seconds, seed, progress)
    if best is None or best.best.outlook.separates_nothing:
        return Experiment(diagnosis, None, None)
    reference = plan_reference_motion(robot, best.best.spec, RATE)
    return Experiment(diagnosis, best.document(None), reference)
