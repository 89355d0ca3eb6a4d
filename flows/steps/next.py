"""The built-in motion that settles the open question of a verdict soonest."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from flows.inputs import LogSets, is_run_id
from flows.outputs import Progress
from flows.requests import Diagnose, Next
from flows.settings import resolve_store_folder
from flows.steps.diagnose import diagnose, read_logs, read_stored_runs
from flows.steps.model_choice import resolve_diagnosis_id
from flows.storage import read_verdict
from residual import one_blas_thread
from residual.errors import InputError, check_nesting
from residual.model.model_files import identify_file_content
from residual.planning.next_experiment import (
    ExpectedSeparation,
    MotionInformation,
    OpenQuestion,
    Pair,
    SimulatedDecision,
    describe_plan,
    expect_separation,
    find_inseparable_pairs,
    find_settling_time,
    list_separating_logs,
)
from residual.robot.robot import Robot
from residual.verdict.document import parse_verdict
from residual.verdict.result import Diagnosis, Verdict
from sim.engine.plant_records import TrajectorySpec, create_random_stream
from sim.trajectories import plan_motion
from sim.trajectories.excitation import draw_feasible_series, export_series_coefficients
from sim.trajectories.planning_limits import build_workspace
from warehouse.robots import find_used_robot
from warehouse.store_catalogue import read_record

SHORTEST, LONGEST = 4.0, 600.0  # s, of a motion
# Families that excite the arm. Those that follow a workpiece take a second or two to
# plan and move as the piece lies.
FOURIER, MOVES = "fourier", "move_stop_move"
PERIODS = (2.5, 5.0, 10.0)  # s, of the motions, about
WAVES, PLACES = 8, 4  # motions of each period, of either family
LOOKS = 3  # motions that are evaluated closely
# Samples of a motion per row of a log: as one of many, and evaluated closely.
COARSER, FINER = 0.5, 2


@dataclass(frozen=True, eq=False, slots=True)
class ReopenedDiagnosis:
    """A verdict, the repeated diagnosis of its logs, and the open question."""

    verdict: Verdict  # as it was named
    diagnosis: Diagnosis  # of the same logs, repeated
    question: OpenQuestion
    robot: Robot
    lines: tuple[str, ...] = ()  # notes on the logs, and which others would help

    @property
    def reproduced(self) -> bool:
        """Whether the logs reproduced the verdict."""
        both = (self.verdict, self.diagnosis.verdict)
        one, other = ({(f.name, f.joints) for f in v.effects} | {v.verdict} for v in both)
        return one == other


def reopen_diagnosis(request: Next, progress: Progress | None = None) -> ReopenedDiagnosis:
    """Diagnose the logs of a verdict again, and return the question that they leave."""
    check_duration(request.seconds)
    stored = is_run_id(request.verdict)
    verdict, again, logs = (_of_store if stored else _of_file)(request)
    found, question = diagnose_open_question(again, logs, progress)
    lines = (*logs.lines, *list_separating_logs(logs.robot, logs.fit))
    return ReopenedDiagnosis(verdict, found, question, logs.robot, lines)


def diagnose_open_question(
    request: Diagnose, logs: LogSets, progress: Progress | None = None
) -> tuple[Diagnosis, OpenQuestion | None]:
    """Diagnose logs, and return the open question, if any.

    A comparison with a baseline leaves none: then the new logs are diagnosed alone.
    """
    found = diagnose(request, logs, progress)
    if found.question is not None:
        return found, found.question
    return found, diagnose(request, logs, progress, ignore_baseline=True).question


def check_duration(seconds: float) -> None:
    """Raise InputError for a duration out of range [s]."""
    if not SHORTEST <= seconds <= LONGEST:
        raise InputError(f"--seconds {seconds:g}: expected {SHORTEST:g} to {LONGEST:g}.")


def _of_store(request: Next) -> tuple[Verdict, Diagnose, LogSets]:
    given = {"logs": request.logs, "--robot": request.robot, "--map": request.columns}
    given |= {"--holdout": request.held_out, "--baseline": request.baseline}
    if extra := [name for name, value in given.items() if value]:
        raise InputError(
            f"{', '.join(extra)}: a stored diagnosis has its own. Leave it "
            "out, or give the JSON file of a verdict."
        )
    store = resolve_store_folder(request.store)
    id = resolve_diagnosis_id(store, request.verdict)
    record = read_record(store, id)
    kept = record.get("request") or {}
    if kept.get("step") != "diagnose":
        raise InputError(f"{id} has no record of its request. Diagnose its runs again.")
    word = find_used_robot(store, kept["robot"], kept.get("robot_hash"))
    again = Diagnose.from_record({**kept, "robot": word}, store)
    return read_verdict(store, id), again, read_stored_runs(again)


def _of_file(request: Next) -> tuple[Verdict, Diagnose, LogSets]:
    verdict = read_verdict_file(Path(request.verdict))
    if request.robot is None or not request.logs:
        raise InputError(
            f"{request.verdict} has the verdict but not the logs. Name them: modelgap "
            f"next {request.verdict} LOG... --robot R."
        )
    again = Diagnose(
        logs=request.logs,
        robot=request.robot,
        held_out=request.held_out,
        baseline=request.baseline,
        declared=verdict.declared,
        columns=request.columns,
        store=request.store,
    )
    logs = read_logs(again)
    if logs.robot.name != verdict.robot:
        raise InputError(
            f"{request.verdict} is of {verdict.robot}, --robot is {logs.robot.name}. "
            "Give the robot of the verdict."
        )
    return verdict, again, logs


def read_verdict_file(path: Path) -> Verdict:
    """Return the verdict of a JSON file."""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(
            f"{path}: no such verdict. Expected the id of a diagnosis, or the file of "
            "modelgap diagnose --json."
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path.name} is no JSON: {error}.") from error
    if not isinstance(document, dict):
        raise InputError(f"{path.name} has no verdict: expected a JSON object.")
    check_nesting(document, path.name)
    if identify_file_content(path) == "a model":
        raise InputError(
            f"{path.name} holds a model, expected a verdict: the file of modelgap "
            "diagnose --json, or the id of a diagnosis."
        )
    return parse_verdict(document)


@dataclass(frozen=True, eq=False, slots=True)
class RankedMotion:
    """A motion with its expected evidence."""

    spec: TrajectorySpec  # reproduces the motion
    outlook: ExpectedSeparation  # of the whole motion, at the estimated sizes
    prospect: SimulatedDecision  # of the whole motion, from drawn logs
    # Length after which the chance of settling the question is `SURE` [s], or None.
    after: float | None

    @property
    def rank(self) -> tuple[float, float]:
        """Sort key: early settlement, then a large chance."""
        return np.inf if self.after is None else self.after, -self.prospect.chance


@dataclass(frozen=True, eq=False, slots=True)
class Ranking:
    """Motions for a question, the best first."""

    question: OpenQuestion
    twins: frozenset[Pair]  # pairs that no motion separates
    ranked: tuple[RankedMotion, ...]  # those that were evaluated closely, the best first

    @property
    def best(self) -> RankedMotion:
        """The one to run."""
        return self.ranked[0]

    def document(self, program: str | None) -> dict:
        """Return the best as `next_experiment` of a verdict, with its program file."""
        spec, best = self.best.spec, self.best
        shown: dict = {"periods": spec.periods}
        if spec.coefficients:
            shown["coefficients"] = [list(row) for row in spec.coefficients]
        else:
            shown["seed"] = spec.seed
        plan = describe_plan(self.question, best.outlook, best.prospect, spec.duration, best.after)
        return plan | {"family": spec.kind, "parameters": shown, "program": program}


@one_blas_thread
def rank_motions(
    question: OpenQuestion, robot: Robot, seconds: float, seed: int, tell: Progress | None = None
) -> Ranking | None:
    """Rank motions of both families; None where nothing is open, or none is found.

    Each is rated by its expected evidence at the identified sizes; for the best few,
    simulated logs give the time after which they settle the question.
    """
    if not question.contests:
        return None
    tell = tell or (lambda stage, share: None)
    twins, every = find_inseparable_pairs(question), list(_specs(robot, seconds, seed))
    weighed = []
    for i, spec in enumerate(every):
        tell("motions", i / len(every))
        try:
            course = _course(question, robot, spec, COARSER)
        except InputError:  # no feasible place for it
            continue
        weighed.append((-expect_separation(question, course.gram(seconds), twins).share, i))
    looked = []
    for _, i in sorted(weighed)[:LOOKS]:
        course = _course(question, robot, every[i], FINER)
        seen = expect_separation(question, course.gram(seconds), twins)
        sure = find_settling_time(question, course, seconds, twins)
        looked.append(RankedMotion(every[i], seen, *sure))
    tell("motions", 1.0)
    ranked = tuple(sorted(looked, key=lambda motion: motion.rank))
    return Ranking(question, twins, ranked) if ranked else None


def _specs(robot: Robot, seconds: float, seed: int) -> Iterator[TrajectorySpec]:
    rng = create_random_stream(seed, "next/fourier")
    for periods in sorted({max(1, round(seconds / p)) for p in PERIODS}):
        place = build_workspace(robot, seconds / periods)
        for _ in range(WAVES):
            rows = export_series_coefficients(draw_feasible_series(place, rng))
            yield TrajectorySpec(FOURIER, seconds, periods, 0, rows)
        for i in range(PLACES):
            yield TrajectorySpec(MOVES, seconds, periods, 100 * seed + i)


def _course(
    question: OpenQuestion, robot: Robot, spec: TrajectorySpec, finer: float
) -> MotionInformation:
    plan = plan_motion(robot, spec)
    rate = finer * question.signals.rate
    motion = plan.curve(np.arange(round(plan.pattern_duration * rate)) / rate)
    return MotionInformation.of(
        question, motion, rate, max(plan.pattern_duration - plan.period, 0.0)
    )
