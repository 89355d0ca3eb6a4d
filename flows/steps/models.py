"""A word to a model: which model of a robot a command goes by, and the model itself.

A word is a file, the id of a record of the store or its beginning, "nominal", or a
robot, which has the model that was adopted for it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.inputs.given import is_run, load, load_of, robot_of
from flows.requests import Diagnose, Identify
from flows.settings import store_folder
from flows.storage.calibration import CORRECTED, KIND, STAGE
from flows.storage.diagnosis import (
    read_known,
    read_models,
    read_models_record,
    read_runs,
)
from residual.calibration.calibrate import with_tables
from residual.calibration.rows import MEASURED, PAPER
from residual.errors import InputError, check_name
from residual.export.export import AnyModel, without_tables
from residual.identification.identify import identify
from residual.model.corrected import CorrectedModel
from residual.model.lookup import Lookup
from residual.model.model import Model
from residual.model.nominal import declared_names, prepare_logs, start_nominal
from residual.model.record import from_record, load_model
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.track import Filters
from warehouse.commit import commit_record
from warehouse.layout import Found, find, list_folders, read_record
from warehouse.numbered import Adoption, adopted
from warehouse.remote import shown
from warehouse.runs import read_manifest

NOMINAL = "nominal"
AUGMENTED = "augmented"
TABLES = "tables"  # a calibration, among models
# Keys of the record of a model, as identify and calibrate write them.
_ALONE = ("model", "nominal")
_OF_ANOTHER = (
    "The model of {} is of {} as it was described then, the robot is {} as it is "
    "described now. Give a model of this one."
)
_GOOD = ("baseline", "fit")  # roles of a diagnosis' runs; the first that there is


@dataclass(frozen=True, slots=True)
class Choice:
    """The model that a command goes by."""

    # Id of the diagnosis that it is from, None for the nominal model.
    diagnosis: str | None = None
    line: str | None = None  # what to say of it, None where there was nothing to choose

    @property
    def lines(self) -> tuple[str, ...]:
        """The line, as what is printed first."""
        return () if self.line is None else (self.line,)


def choose(
    robot: Robot,
    model: str | None = None,
    store: str | Path | None = None,
    logs: Sequence[str] = (),
    instead: str | None = None,
) -> Choice:
    """Return the model to go by.

    The store is asked where the logs are runs of it, or where --store names it; what is
    in it has no say about files alone.

    Args:
        model: Value of --model: "nominal", an id, or None.
        store: Value of --store, None where it is not given.
        instead: The option that says by itself what the nominal model is, such as
            "--baseline"; None for none.

    Raises:
        InputError: If there is no such model, or it is of another robot or of another
            description of this one.
    """
    if model is not None and model != NOMINAL:
        if instead:
            raise InputError(
                f"--model and {instead} each say what the nominal model is. "
                "Give one of them."
            )
        id = diagnosis_of(store_folder(store), model)
        _check_robot(robot, store_folder(store), id)
        return Choice(id, f"model: that of diagnosis {id[:8]}, as --model says")
    in_store = store is not None or (logs and all(map(is_run, logs)))
    last = in_store and adopted(store_folder(store), robot.name, robot.serial)
    if not last or last[1].diagnosis_id is None:
        # Nothing is said of a robot that never had another model.
        back = last and f"the nominal one, to which adoption {int(last[0])} went back"
        return Choice(line=f"model: {back}" if back else None)
    name = _named(robot, *last)
    if model == NOMINAL or instead:
        why = instead or "--model nominal"
        return Choice(line=f"model: the nominal one by {why}, not {name}")
    _check_robot(robot, store_folder(store), last[1].diagnosis_id)
    return Choice(last[1].diagnosis_id, f"model: {name}")


def choose_for(request: Diagnose | Identify) -> Choice:
    """Return the model that a request goes by, as `choose` does."""
    logs = (*request.logs, *getattr(request, "held_out", ()))
    robot = load_of(request.robot, logs, request.store)
    return choose(robot, request.model, request.store, logs, request.instead)


def in_force(runs: Sequence[str], store: Path) -> Choice:
    """Return the model that the robot of some runs of a store has."""
    robot = load_of(robot_of(runs, store), runs, store)
    return choose(robot, None, store, tuple(runs))


def chosen_to_watch(
    word: str, store: Path, nominal: bool, runs: Sequence[str] = ()
) -> Choice:
    """Return the model to watch by; no choice where a word names it by an id."""
    if is_run(word):
        return Choice()
    robot = load_of(word, runs, store)
    return choose(robot, NOMINAL if nominal else None, store, runs)


def chosen_to_drive(store: Path, run: str, model: str | None) -> Choice:
    """Return the model to drive the arm of a run by: any of the store may drive."""
    if model is None or model == NOMINAL:
        return choose(load(robot_of([run], store)), model, store)
    id = find(store, model).id
    return Choice(id, f"model: {id[:8]}, as --model says")


def diagnosis_of(store: Path, word: str) -> str:
    """Return the whole id of the diagnosis that a word stands for.

    Args:
        word: Id of a diagnosis, of its proof, of the model that it ended with, or of
            an adoption.
    """
    found = find(store, word)
    if found.kind == "adoptions":
        id = read_record(store, found.id)["diagnosis_id"]
        if id is None:
            raise InputError(f"Adoption {found.id} went back to the nominal model.")
        return id
    if found.kind == "diagnoses":
        return found.id
    if found.kind == "validations" and (
        id := read_record(store, found.id).get("diagnosis")
    ):
        return id
    of_model = _ended_with(store, found.id) if found.kind == "models" else []
    if not of_model:
        raise InputError(
            f"{word} is one of {found.kind}, expected a diagnosis or the model that "
            "one ended with: modelgap sql 'SELECT diagnosis_id FROM diagnoses'."
        )
    return of_model[0]


def read_model(store: Path, word: str, which: str | None = None) -> AnyModel:
    """Return a model of a file, of a diagnosis, or of a model of the store.

    Args:
        word: File of a model, or the id of a record; the beginning is enough.
        which: Which of the models of a diagnosis; None for the augmented one.

    Raises:
        InputError: If there is none, or it was kept without its numbers.
        UnknownNameError: If the diagnosis has no model of that name.
    """
    if Path(word).is_file():
        if which is not None:
            raise InputError(
                f"{word} holds one model; --which chooses among those of a diagnosis."
            )
        return load_model(word)
    if word.endswith(".json") or "/" in word:
        raise InputError(f"There is no file {word}. Name one that holds a model.")
    found = find(store, word)
    if found.kind == "models":
        return _of_record(store, found, word, which)
    if found.kind == "diagnoses":
        return _one_of(read_models(store, found.id), which)
    raise InputError(
        f"{word} is one of {found.kind}, which hold no model. Name a diagnosis or "
        "a model: modelgap sql 'SELECT model_id, robot, stage FROM models'."
    )


def model_to_drive(store: Path, word: str, robot: Robot) -> AnyModel:
    """Return the model that a controller is to have.

    Args:
        word: Id of a diagnosis (its augmented model, tables included), of a model, or
            of a calibration (its look-up tables); or a file that holds a model.
    """
    if not Path(word).is_file() and find(store, word).kind == "diagnoses":
        model: AnyModel = read_known(store, find(store, word).id)
    else:
        model = read_model(store, word)
    own = without_tables(model).robot
    if own.content_hash != robot.content_hash:
        raise InputError(_OF_ANOTHER.format(word, own.name, robot.name))
    return model


def calibration_of(store: Path, word: str) -> str:
    """Return the id of a calibration; one that is a file is put into the store first.

    Args:
        word: Id of the model or the validation that a calibration was kept as, or the
            `corrected.json` that it was exported as.

    Raises:
        InputError: If there is none, or it is another record or file.
    """
    if Path(word).is_file():
        whole = load_model(word)
        if not isinstance(whole, CorrectedModel):
            raise InputError(
                f"{word} holds a model without tables, expected corrected.json of "
                "modelgap calibrate --export."
            )
        record = {"robot": whole.model.robot.name, "stage": STAGE, "mode": MEASURED}
        return commit_record(
            store, "models", record, files={CORRECTED: Path(word).read_bytes()}
        )
    found = find(store, word)
    record = read_record(store, found.id)
    if found.kind == "validations" and record["kind"] == KIND:
        return record["model_id"]
    if found.kind != "models" or record.get("stage") != STAGE:
        raise InputError(
            f"{word} is one of {found.kind}, expected a calibration: modelgap sql "
            f"\"SELECT model_id FROM models WHERE stage = '{STAGE}'\"."
        )
    return found.id


def tables_to_drive(store: Path, id: str, nominal: Model) -> CorrectedModel:
    """Return a calibration as a controller drives with it: a model and its tables.

    Tables of the paper's form correct a simulated twin: on the model as described.

    Args:
        id: Of the model that a calibration was kept as.
        nominal: The robot as described.

    Raises:
        InputError: If it is of another robot.
    """
    record = read_record(store, id)
    if record["mode"] != PAPER:
        return model_to_drive(store, id, nominal.robot)
    hash, robot = record["request"]["robot_hash"], nominal.robot
    if hash != robot.content_hash:
        raise InputError(_OF_ANOTHER.format(id, record["robot"], robot.name))
    lookup = Lookup.load(find(store, id).folder / "model.npz")
    return with_tables(nominal, lookup, record["joints"])


def nominal_of(robot: Robot, logs: Sequence[Recording]) -> Model:
    """Return the robot as described, with the effects that it declares.

    Args:
        logs: What counts as standing is learnt from them.
    """
    prepared = prepare_logs(robot, logs, None, Filters())
    return start_nominal(prepared, declared_names(robot, None)).model


@dataclass(frozen=True, slots=True)
class Source:
    """Where the model of a monitor comes from."""

    robot: str | None  # name or file of the robot; None for that of the diagnosis
    diagnosis: str | None = None  # id of the diagnosis, None for a nominal model
    model: Model | None = None  # the augmented model of the diagnosis
    good: tuple[str, ...] = ()  # runs that it was made from, to calibrate on

    def robot_of(self, run: Recording, store: Path) -> Robot:
        """Return the robot, which must be described as it was when a run was made."""
        known = self.model.robot if self.model else None
        robot = known or load_of(str(self.robot), [run.id], store)
        if robot.name != run.robot:
            raise InputError(
                f"Run {run.id} is of {run.robot}, the model of {robot.name}. Give runs "
                "of the robot, or its own model."
            )
        manifest = read_manifest(store, run.id)
        return as_described(robot, run, manifest, self.robot or "the model")

    def model_of(self, robot: Robot, runs: Sequence[Recording]) -> Model:
        """Return the model: of a diagnosis as it is, of a robot fitted to some runs."""
        return self.model or identify(robot, runs).model


def source_of(word: str, store: Path) -> Source:
    """Say what a word stands for: a diagnosis of the store, else a robot."""
    if not word or len(word) > 20 or not is_run(word):
        return Source(word)
    if not any(id.startswith(word) for id in list_folders(store, "diagnoses")):
        raise InputError(
            f"'{word}' is no diagnosis in {shown(store)}. Name a robot such as irb140, "
            "or a diagnosis as in: modelgap sql 'SELECT diagnosis_id FROM diagnoses'."
        )
    id = find(store, word).id
    model = read_models(store, id)[AUGMENTED]
    good = next((ids for role in _GOOD if (ids := read_runs(store, id, (role,)))), ())
    return Source(None, id, model, tuple(sorted(good)))


def as_described(
    robot: Robot, run: Recording, manifest: Mapping, by: str | None
) -> Robot:
    """Return a robot that is described as it was when a run was made."""
    if robot.content_hash != manifest.get("robot_hash"):
        raise InputError(
            f"Run {run.id} was made with another description of {run.robot} than "
            f"{by} has now. Put back the URDF and robot.toml of that time."
        )
    return robot


def _of_record(store: Path, found: Found, word: str, which: str | None) -> AnyModel:
    """Return a model of the store, as calibrate, diagnose or identify kept it."""
    if (found.folder / CORRECTED).is_file():
        return load_model(found.folder / CORRECTED)
    record = read_record(store, found.id)
    if record.get("models"):
        return _one_of(read_models_record(record["models"]), which)
    kept = next((record[key] for key in _ALONE if record.get(key)), None)
    if kept is None:
        raise InputError(
            f"Model {word} was kept without its numbers. Make it again with this "
            "version."
        )
    return from_record(kept)


def _one_of(kept: Mapping[str, AnyModel], which: str | None) -> AnyModel:
    return kept[check_name(which or AUGMENTED, kept, "model of the diagnosis")]


def _ended_with(store: Path, model_id: str) -> list[str]:
    """Diagnoses that ended with a model, the first one first."""
    from warehouse.query.store import ask

    query = (
        "SELECT diagnosis_id AS id FROM diagnoses WHERE model_id = $id ORDER BY created"
    )
    return [row["id"] for row in ask(store, query, id=model_id)]


def _check_robot(robot: Robot, store: Path, diagnosis: str) -> None:
    own = read_known(store, diagnosis).robot
    if own.name != robot.name:
        raise InputError(
            f"The model of diagnosis {diagnosis[:8]} is of {own.name}, the robot is "
            f"{robot.name}. Give a model of this robot, or --model nominal."
        )
    if own.joints != robot.joints:
        raise InputError(
            f"The model of diagnosis {diagnosis[:8]} is of the chain "
            f"{', '.join(own.joints)}, this is {', '.join(robot.joints)}. Choose that "
            "one with --chain, or go on with --model nominal."
        )
    if own.content_hash != robot.content_hash:
        raise InputError(
            f"The model of diagnosis {diagnosis[:8]} was made with another description "
            f"of {robot.name} than it has now. Put back the URDF and robot.toml of "
            "that time, or go on with --model nominal."
        )


def _named(robot: Robot, id: str, made: Adoption) -> str:
    serial = f" {robot.serial}" if robot.serial else ""
    forced = ", against the gate" if made.action == "forced" else ""
    return (
        f"adoption {int(id)} of {robot.name}{serial}, diagnosis "
        f"{str(made.diagnosis_id)[:8]}{forced}"
    )
