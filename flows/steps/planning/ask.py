"""From a verdict to what it leaves open: its logs are looked at once more."""

import json
from dataclasses import dataclass
from pathlib import Path

from flows.inputs.given import LogSets, is_run
from flows.outputs import Progress
from flows.requests import Diagnose, Next
from flows.settings import store_folder
from flows.steps.diagnose import diagnose, read_logs, runs_of
from flows.steps.models import diagnosis_of
from flows.storage.diagnosis import checked_verdict, read_verdict
from residual.diagnosis.result import Diagnosis, Verdict
from residual.errors import InputError, check_nesting
from residual.model.record import held_in
from residual.planning.question import Question
from residual.robot.robot import Robot
from warehouse.layout import read_record
from warehouse.runs import robot_word

SHORTEST, LONGEST = 4.0, 600.0  # s, of a motion


@dataclass(frozen=True, eq=False, slots=True)
class Asked:
    """A verdict and what it leaves open.

    Attributes:
        verdict: The verdict that was named.
        found: The same logs diagnosed once more.
        question: What is open.
        robot: The arm.
        request: The diagnosis.
        lines: What the user should know of the logs.
    """

    verdict: Verdict
    found: Diagnosis
    question: Question
    robot: Robot
    request: Diagnose
    lines: tuple[str, ...] = ()

    @property
    def same(self) -> bool:
        """Whether the logs gave the verdict again."""
        return _names(self.verdict) == _names(self.found.verdict)


def ask(request: Next, progress: Progress | None = None) -> Asked:
    """Find out what a verdict leaves open.

    A comparison asks nothing of one arm: of it the new logs are looked at by
    themselves.

    Raises:
        InputError: If the request, the verdict or a log is not usable.
    """
    check_length(request.seconds)
    stored = is_run(request.verdict)
    verdict, again, logs = (_of_store if stored else _of_file)(request)
    found = diagnose(again, logs, progress)
    question = found.question
    if question is None:
        question = diagnose(again, logs, progress, alone=True).question
    return Asked(verdict, found, question, logs.robot, again, logs.lines)


def check_length(seconds: float) -> None:
    """Raise unless a motion may be so long [s].

    Raises:
        InputError: If it may not.
    """
    if not SHORTEST <= seconds <= LONGEST:
        raise InputError(
            f"--seconds {seconds:g}: expected {SHORTEST:g} to {LONGEST:g}."
        )


def _of_store(request: Next) -> tuple[Verdict, Diagnose, LogSets]:
    """The verdict, request and runs of a diagnosis in the store."""
    given = {"logs": request.logs, "--robot": request.robot, "--map": request.columns}
    given |= {"--holdout": request.held_out, "--baseline": request.baseline}
    if extra := [name for name, value in given.items() if value]:
        raise InputError(
            f"{', '.join(extra)}: a diagnosis in the store knows its own. Leave it "
            "out, or name the JSON file of a verdict."
        )
    store = store_folder(request.store)
    id = diagnosis_of(store, request.verdict)
    verdict = read_verdict(store, id)
    record = read_record(store, id).get("request") or {}
    if record.get("step") != "diagnose":
        raise InputError(f"{id} does not say how it was made. Diagnose its runs again.")
    word = robot_word(store, record["robot"], record.get("robot_hash"))
    again = Diagnose.from_record({**record, "robot": word}, store)
    return verdict, again, runs_of(again)


def _of_file(request: Next) -> tuple[Verdict, Diagnose, LogSets]:
    """The verdict of a JSON file, and the logs that were named with it."""
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
    """Return the verdict of a JSON file.

    Raises:
        InputError: If it is not there, or no verdict.
    """
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
    if held_in(path) == "a model":
        raise InputError(
            f"{path.name} holds a model, expected a verdict: the file of modelgap "
            "diagnose --json, or the id of a diagnosis."
        )
    return checked_verdict(document)


def _names(verdict: Verdict) -> set:
    return {(f.name, f.joints) for f in verdict.effects} | {verdict.verdict}
