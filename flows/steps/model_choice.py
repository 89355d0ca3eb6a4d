"""Resolve which model a command uses, and read that model.

A model is named by a file, by the id of a record of the store or its beginning, by
"nominal", or by a robot, which has the model that was adopted for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.inputs import is_run_id, load_run_robot, read_run_robot
from flows.requests import Diagnose, Identify
from flows.settings import resolve_store_folder
from flows.storage import CORRECTED, models_from_record, read_adoptable_model, read_models
from residual.errors import InputError, check_name
from residual.export.model_export import AnyModel
from residual.model.model_files import load_model, model_from_record
from residual.recording import Recording
from residual.robot.robot import Robot
from warehouse.record_commit import find_last_adoption
from warehouse.store_catalogue import find_record, read_record

NOMINAL = "nominal"
AUGMENTED = "augmented"


@dataclass(frozen=True, slots=True)
class ModelChoice:
    """The model that a command uses."""

    # Id of its diagnosis, None for the nominal model.
    diagnosis: str | None = None
    line: str | None = None  # what to print about it; None where there is no choice

    @property
    def lines(self) -> tuple[str, ...]:
        """The line, printed first."""
        return () if self.line is None else (self.line,)


def choose_model(
    robot: Robot,
    model: str | None = None,
    store: str | Path | None = None,
    logs: Sequence[str] = (),
    instead: str | None = None,
) -> ModelChoice:
    """Return the model that a command uses.

    The store counts if the logs are runs of it, or if --store names it; it does not
    influence commands on files alone.

    Args:
        model: Value of --model: "nominal", an id, or None.
        store: Value of --store, None where it is not given.
        instead: The option that itself determines the nominal model, such as
            "--baseline"; None for none.

    Raises:
        InputError: If there is no such model, or it is of another robot or of another
            description of this one.
    """
    place = resolve_store_folder(store)
    if model is not None and model != NOMINAL:
        if instead:
            raise InputError(f"--model and {instead} both set the nominal model. Give only one.")
        id = resolve_diagnosis_id(place, model)
        _check_robot(robot, place, id)
        serial = read_record(place, id).get("serial")
        if any(map(is_run_id, logs)) and serial != robot.serial:
            raise InputError(
                f"The model of diagnosis {id[:8]} is of the arm "
                f"{serial or 'without a number'}, the runs are of the arm "
                f"{robot.serial or 'without a number'}. Give a model of this arm, or "
                "--model nominal."
            )
        return ModelChoice(id, f"model: diagnosis {id[:8]} (--model)")
    in_store = store is not None or (logs and all(map(is_run_id, logs)))
    last = in_store and find_last_adoption(place, robot.name, robot.serial)
    if not last:  # a robot that never had another model needs no line
        return ModelChoice()
    number, adoption = last
    if adoption.diagnosis_id is None:
        back = f"the nominal one, restored by adoption {int(number)}"
        return ModelChoice(line=f"model: {back}")
    serial = f" {robot.serial}" if robot.serial else ""
    name = (
        f"adoption {int(number)} of {robot.name}{serial}, diagnosis {adoption.diagnosis_id[:8]}"
    ) + (", against the gate" if adoption.action == "forced" else "")
    if model == NOMINAL or instead:
        why = instead or "--model nominal"
        return ModelChoice(line=f"model: the nominal one by {why}, not {name}")
    _check_robot(robot, place, adoption.diagnosis_id)
    return ModelChoice(adoption.diagnosis_id, f"model: {name}")


def choose_request_model(request: Diagnose | Identify, robot: Robot) -> ModelChoice:
    """Return the model of a request, as `choose_model` does."""
    logs = (*request.logs, *request.held_out)
    return choose_model(robot, request.model, request.store, logs, request.instead)


def resolve_adopted_model(runs: Sequence[str], store: Path) -> ModelChoice:
    """Return the adopted model of the robot of some runs of a store."""
    robot = load_run_robot(read_run_robot(runs, store), runs, store)
    return choose_model(robot, None, store, tuple(runs))


def choose_monitor_model(
    word: str, store: Path, nominal: bool, runs: Sequence[str] = ()
) -> ModelChoice:
    """Return the model to monitor with; no choice where a word is an id.

    Raises:
        InputError: If the word is neither an id nor a robot.
    """
    if is_run_id(word):
        return ModelChoice()
    if word.endswith(".json"):
        raise InputError(
            f"{word} is a JSON file. MODEL is the id of a stored diagnosis (modelgap "
            "sql 'SELECT diagnosis_id FROM diagnoses'), or a robot: built-in name, "
            "robot file or folder."
        )
    robot = load_run_robot(word, runs, store)
    return choose_model(robot, NOMINAL if nominal else None, store, runs)


def resolve_diagnosis_id(store: Path, word: str) -> str:
    """Return the complete id of the diagnosis that a word stands for.

    Args:
        word: Id of a diagnosis, of its proof, of the model that it ended with, or of
            an adoption.
    """
    found = find_record(store, word)
    if found.kind == "diagnoses":
        return found.id
    if found.kind == "adoptions":
        id = read_record(store, found.id)["diagnosis_id"]
        if id is None:
            raise InputError(f"Adoption {found.id} restored the nominal model.")
        return id
    if found.kind == "validations" and (id := read_record(store, found.id).get("diagnosis")):
        return id
    if found.kind == "models":
        from warehouse.queries import query_store_rows

        query = (
            "SELECT diagnosis_id AS id FROM diagnoses WHERE model_id = $id ORDER BY created LIMIT 1"
        )
        for row in query_store_rows(store, query, id=found.id):
            return row["id"]
    raise InputError(
        f"{word} is one of {found.kind}, expected a diagnosis or the model that one "
        "ended with: modelgap sql 'SELECT diagnosis_id FROM diagnoses'."
    )


def read_model(store: Path, word: str, which: str | None = None) -> AnyModel:
    """Return a model of a file, of a diagnosis, or of a model of the store.

    Args:
        word: File of a model, or the id of a record; the beginning is enough.
        which: Which of the models of a diagnosis; None for the augmented one.

    Raises:
        InputError: If there is none, or it was stored without its values.
        UnknownNameError: If the diagnosis has no model of that name.
    """
    if Path(word).is_file():
        if which is not None:
            raise InputError(f"{word} holds one model; --which chooses among those of a diagnosis.")
        return load_model(word)
    if word.endswith(".json") or "/" in word:
        raise InputError(f"There is no file {word}. Name one that holds a model.")
    found = find_record(store, word)
    if found.kind == "diagnoses":
        return _one_of(read_models(store, found.id), which)
    if found.kind != "models":
        raise InputError(
            f"{word} is one of {found.kind}, which hold no model. Name a diagnosis or "
            "a model: modelgap sql 'SELECT model_id, robot, stage FROM models'."
        )
    # As calibrate, diagnose or identify stored it.
    if (found.folder / CORRECTED).is_file():
        return load_model(found.folder / CORRECTED)
    record = read_record(store, found.id)
    if record.get("models"):
        return _one_of(models_from_record(record["models"]), which)
    content = record.get("model") or record.get("nominal")
    if content is None:
        raise InputError(
            f"Model {word} was stored without its values. Make it again with this version."
        )
    return model_from_record(content)


def _one_of(models: Mapping[str, AnyModel], which: str | None) -> AnyModel:
    return models[check_name(which or AUGMENTED, models, "model of the diagnosis")]


def check_description(robot: Robot, run: Recording, manifest: Mapping, by: str | None) -> None:
    """Refuse a robot whose description differs from that of a run."""
    if robot.content_hash != manifest.get("robot_hash"):
        raise InputError(
            f"Run {run.id} was made with another description of {run.robot} than "
            f"{by} has now. Restore the URDF and robot.toml of that time."
        )


def _check_robot(robot: Robot, store: Path, diagnosis: str) -> None:
    own = read_adoptable_model(store, diagnosis).robot
    about = f"of diagnosis {diagnosis[:8]}"
    if own.name != robot.name:
        raise InputError(
            f"The model {about} is of {own.name}, the robot is {robot.name}. Give a "
            "model of this robot, or --model nominal."
        )
    if own.joints != robot.joints:
        raise InputError(
            f"The model {about} is of the chain {', '.join(own.joints)}, this is "
            f"{', '.join(robot.joints)}. Choose that one with --chain, or continue with "
            "--model nominal."
        )
    if own.content_hash != robot.content_hash:
        raise InputError(
            f"The model {about} was made with another description of {robot.name} than "
            "it has now. Restore the URDF and robot.toml of that time, or continue with "
            "--model nominal."
        )
