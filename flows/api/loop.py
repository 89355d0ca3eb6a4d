"""The loop from a script, apart from the rest, which loads no simulation.

Simulate an arm, watch its runs, ask for the next motion.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from flows.api.logs import as_logs
from flows.api.results import Diagnosis, as_door, log_sets
from flows.outputs import Progress, write_all
from flows.specs.experiment import experiment_of
from flows.steps.diagnose import diagnose_logs
from flows.steps.experiment import as_csv, make, run_id_of
from flows.steps.monitor import Watched, watch
from flows.steps.next import check_length, rank_motions
from residual.errors import InputError
from residual.model.model import Model
from residual.recording import Recording
from residual.robot.robot import Robot
from sim.engine.records import Reference
from sim.trajectories import make_reference
from warehouse.logs import check_distinct

_PLAIN: Mapping = MappingProxyType({})
RATE = 250.0  # samples per second of a program [Hz]


@dataclass(frozen=True, eq=False, slots=True)
class Experiment:
    """The motion that tells apart what some logs leave open.

    Attributes:
        found: The diagnosis of these logs.
        plan: As `next_experiment` of a verdict has it (rivals, `sure_after` [s]); None
            where nothing is open, or no motion would decide.
        reference: The motion: t [s], q, qd, qdd [rad, s]; None like the plan.
    """

    found: Diagnosis
    plan: Mapping | None
    reference: Reference | None

    def save_program(self, path: str | Path) -> None:
        """Write the motion as CSV for a controller.

        Raises:
            InputError: If there is none, or the file cannot be written.
        """
        if self.reference is None:
            raise InputError("There is no motion to write: no experiment is proposed.")
        write_all({Path(path): as_csv(self.reference)})


def simulate(spec: Mapping = _PLAIN) -> Recording:
    """Run one experiment on the simulated arm and return its log; nothing is stored.

    Args:
        spec: What SPEC.toml of `modelgap experiment` says, as a mapping; what is left
            out is the default: {"trajectory": {"kind": "cyclic", "duration": 10},
            "plant": {"effect": [{"name": "stribeck", "joints": [2]}]}}.

    Raises:
        InputError: If the mapping says what there is not, or PyBullet is missing.
    """
    checked = experiment_of(dict(spec), "spec")
    return replace(make(checked).log, id=run_id_of(checked))


def monitor(
    model: Model,
    healthy: Sequence[Recording],
    watched: Sequence[Recording],
    per_hour: float = 1.0,
) -> Watched:
    """Calibrate a monitor on healthy logs, and tell what in others is not as usual.

    Args:
        model: The model whose residual is watched: of a diagnosis, or adopted.
        healthy: Logs of the arm as it should be, three or more.
        watched: Logs to look at.
        per_hour: False alarms wanted at most in an hour.

    Returns:
        `alarms` of each watched log by its id.

    Raises:
        InputError: If there are too few healthy logs, or one is of another arm.
    """
    given = as_logs("healthy", healthy), as_logs("watched", watched)
    check_distinct([*given[0], *given[1]])
    sets = [{log.id: log for log in logs} for logs in given]
    return watch(model, *sets, per_hour)


def next_experiment(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    baseline: Sequence[Recording] = (),
    seconds: float = 20.0,
    seed: int = 0,
    progress: Progress | None = None,
) -> Experiment:
    """Choose the motion that is soonest sure which of the open rivals is true.

    Args:
        robot: The arm.
        fit: Logs so far.
        held_out: Logs for the proof.
        baseline: Logs of healthy runs.
        seconds: The longest that the motion may take [s].
        seed: Seed of the motions.

    Raises:
        InputError: If a log or the length is not usable.
    """
    check_length(seconds)
    logs = log_sets(robot, fit, baseline, held_out)
    made = diagnose_logs(logs, progress=progress)
    found = as_door(Diagnosis, made)
    if made.question is None:
        made = diagnose_logs(logs, progress=progress, alone=True)
    best = rank_motions(made.question, robot, seconds, seed, progress)
    if best is None or best.best.seen.hopeless:
        return Experiment(found, None, None)
    reference = make_reference(robot, best.best.spec, RATE)
    return Experiment(found, best.document(None), reference)
