"""Which model a robot has: choose it for a command, read, adopt and roll it back.

A model is named by a file, by the id of a record of the store or its beginning, by
"nominal", or by a robot, which has the model that was adopted for it. No record of an
adoption is ever deleted.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from flows.inputs import is_run_id, load_command_robot, load_run_robot, read_run_robot
from flows.requests import Diagnose, Identify
from flows.settings import read_user_name, resolve_store_folder
from flows.storage import (
    CORRECTED,
    models_from_record,
    read_adoptable_model,
    read_models,
    read_verdict,
)
from residual import one_blas_thread
from residual.diagnosis.adoption import AdoptionCheck, check_adoption
from residual.errors import InputError, check_name
from residual.export.model_export import AnyModel
from residual.model.model import Model
from residual.model.model_files import load_model, model_from_record
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.verdict.result import Verdict
from warehouse.record_commit import commit_adoption
from warehouse.remote_store import format_store_name
from warehouse.store_catalogue import (
    ADOPTED,
    FORCED,
    ROLLED_BACK,
    AdoptionEntry,
    ModelAdoption,
    find_last_adoption,
    find_record,
    list_record_folders,
    read_adoptions,
    read_record,
    read_run,
)

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


# Largest error of a model on the baseline logs once its findings are removed, as a
# multiple of the error of the baseline's own model.
EDITED = 2.0


@dataclass(frozen=True, eq=False, slots=True)
class Judgment:
    """The judgment of the gate on a model, with the reasons."""

    diagnosis: str  # id of the diagnosis that found it
    verdict: Verdict
    model_id: str
    model: Model
    serial: str | None  # serial number of the arm
    # The adoption that the robot has, with its number; None for none.
    parent: tuple[str, ModelAdoption] | None
    check: AdoptionCheck | None  # on held-out motion; None without held-out logs
    # Why it should not be adopted; empty for a model that may.
    doubts: tuple[str, ...] = ()

    def as_record(self) -> dict:
        """Return the judgment as JSON values."""
        check = asdict(self.check) if self.check else {}
        check.pop("doubts", None)
        return {"held_out": check, "doubts": list(self.doubts)}

    @property
    def current_model(self) -> str:
        """The model that the robot has."""
        if self.parent is None or self.parent[1].diagnosis_id is None:
            return "nominal model"
        return f"adoption {int(self.parent[0])}, diagnosis {self.parent[1].diagnosis_id[:8]}"

    @property
    def proposal(self) -> dict:
        """The record of its proposal: that of another night with these findings is the same."""
        return {
            "robot": self.verdict.robot,
            "serial": self.serial,
            "kind": "proposal",
            "parent": self.parent and self.parent[0],
            "findings": [[e.name, *e.joints] for e in self.verdict.effects],
        }


@one_blas_thread
def judge_adoption(store: Path, word: str) -> Judgment:
    """Compare the model of a diagnosis with the current model of its robot.

    The logs are those that the diagnosis held out; the model before it is the adopted
    one, else the one that the diagnosis started from.
    """
    id = resolve_diagnosis_id(store, word)
    verdict, model = read_verdict(store, id), read_adoptable_model(store, id)
    doubts, check, record = _of_verdict(verdict), None, read_record(store, id)
    # That of a simulated arm is no part of its description.
    serial = record.get("serial")
    parent = find_last_adoption(store, model.robot.name, serial)
    runs = record["request"].get("held_out")
    if not runs:
        doubts.append("no run was held out; diagnose with --holdout RUN")
    else:
        if parent and parent[1].diagnosis_id:
            before = read_adoptable_model(store, parent[1].diagnosis_id)
        else:
            before = read_models(store, id)["nominal"]
        check = check_adoption(model, before, [read_run(store, run) for run in runs])
        doubts += check.doubts
    return Judgment(id, verdict, record["model_id"], model, serial, parent, check, tuple(doubts))


def _of_verdict(verdict: Verdict) -> list[str]:
    """Return the reasons in a verdict not to adopt its model."""
    out = []
    if not verdict.trusted:
        out.append("its logs have a certain fault")
    if verdict.contradictions:
        out.append("its fit is physically impossible")
    if not verdict.effects:
        out.append("it names no missing effect")
    if verdict.error.same_run:
        out.append("its held-out data are the end of a fitted log")
    # The edit test: without its effects a model is that of the baseline.
    for edit in verdict.edit or ():
        if None in (edit.error, edit.kept, edit.reference):
            continue
        if edit.error > min(edit.kept, EDITED * edit.reference):
            out.append(
                f"the edit test fails: without {edit.name} the error on the healthy "
                f"logs is {edit.error:.3g} % of the torque, with it {edit.kept:.3g} %, "
                f"and of their own model {edit.reference:.3g} %"
            )
    return out


def adopt(
    word: str, note: str = "", force: bool = False, store: str | Path | None = None
) -> tuple[str, Judgment]:
    """Let a model be the nominal one of its robot in this store; by force against the gate.

    Returns:
        The number of the adoption, and the judgment of the gate.
    """
    place = resolve_store_folder(store)
    judgment = judge_adoption(place, word)
    robot, parent = judgment.model.robot, judgment.parent
    if parent and parent[1].model_id == judgment.model_id:
        raise InputError(f"{robot.name} already has that model, by adoption {int(parent[0])}.")
    if judgment.doubts and not force:
        raise InputError(
            f"Refused: {'; '.join(judgment.doubts)}. {robot.name} keeps the model that "
            "it has. Diagnose with more motion, or give --force and a --note with the reason."
        )
    if force and not note:
        raise InputError("--force needs a --note: give the reason for the adoption.")
    adoption = ModelAdoption(
        robot=robot.name,
        serial=judgment.serial,
        action=FORCED if judgment.doubts else ADOPTED,
        model_id=judgment.model_id,
        diagnosis_id=judgment.diagnosis,
        parent=parent[0] if parent else None,
        who=read_user_name(),
        note=note,
        before=judgment.check.before if judgment.check else None,
        after=judgment.check.after if judgment.check else None,
        evidence=judgment.as_record(),
    )
    return commit_adoption(place, adoption), judgment


def roll_back(
    word: str | None, note: str = "", store: str | Path | None = None
) -> tuple[str, ModelAdoption]:
    """Restore the previous model of a robot, by one more record.

    Args:
        word: The robot, with its serial number where several have its name; None where
            the store has adoptions of one alone.
    """
    place = resolve_store_folder(store)
    robot, serial = _robot_of(place, word)
    last = find_last_adoption(place, robot, serial)
    if last is None or last[1].model_id is None:
        raise InputError(f"{robot} has its nominal model: nothing to roll back.")
    # The version under the one in force: what was rolled back is off the pile.
    pile: list[ModelAdoption | None] = [None]
    for _, each, _ in read_adoptions(place):
        if (each.robot, each.serial) != (robot, serial):
            continue
        if each.action == ROLLED_BACK:
            pile.pop()
        else:
            pile.append(each)
    before = pile[-2]
    adoption = ModelAdoption(
        robot=robot,
        serial=serial,
        action=ROLLED_BACK,
        model_id=before and before.model_id,
        diagnosis_id=before and before.diagnosis_id,
        parent=last[0],
        who=read_user_name(),
        note=note,
        before=last[1].after,
        after=last[1].before,
    )
    return commit_adoption(place, adoption), adoption


def list_adoptions(store: str | Path | None = None, word: str | None = None) -> list[AdoptionEntry]:
    """Return all adoptions, or those of a robot, the first one first."""
    place = resolve_store_folder(store)
    entries = read_adoptions(place)
    if word is None:
        return entries
    keys = _robots(place, word)
    return [e for e in entries if (e.adoption.robot, e.adoption.serial) in keys]


def _robots(store: Path, word: str | None) -> set[tuple[str, str | None]]:
    """Name and serial number of what a word may stand for: a name, or a robot.

    Of None: of all robots with an adoption.
    """
    keys = {(each.robot, each.serial) for _, each, _ in read_adoptions(store)}
    if word is None:
        return keys
    by_name = {key for key in keys if word in (key[0], " ".join(filter(None, key)))}
    if by_name:
        return by_name
    robot = load_command_robot(word)
    return {(robot.name, robot.serial)}


def _robot_of(store: Path, word: str | None) -> tuple[str, str | None]:
    keys = _robots(store, word)
    # Of several of a name, the one of this number; without, that which has none.
    keys = {key for key in keys if " ".join(filter(None, key)) == word} or keys
    if len(keys) == 1:
        return keys.pop()
    if not keys:
        raise InputError(
            f"No model was adopted in {format_store_name(store)}: nothing to roll back."
        )
    names = ", ".join(f"{r} {s or ''}".strip() for r, s in sorted(keys, key=str))
    raise InputError(
        f"Several robots have adopted models: {names}. Choose one: --robot 'NAME SERIAL'."
    )


def find_same_proposal(store: Path, judgment: Judgment) -> str | None:
    """Return the id of a proposal of the same findings, answered or not, or None."""
    ids = list_record_folders(store, "reports")
    return next((id for id in ids if read_record(store, id) == judgment.proposal), None)
