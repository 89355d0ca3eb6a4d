"""Which model of a robot a command goes by: the adopted one, or what --model says."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.inputs.logs import is_run
from flows.inputs.robots import load_of, robot_of
from flows.settings import store_folder
from residual.errors import InputError
from residual.lazy import Lazy
from residual.robot.robot import Robot

keep = Lazy("flows.storage.diagnosis")
numbered = Lazy("warehouse.numbered")
sql = Lazy("warehouse.query.store")
layout = Lazy("warehouse.layout")

NOMINAL = "nominal"


@dataclass(frozen=True, slots=True)
class Choice:
    """The model that a command goes by.

    Attributes:
        diagnosis: Id of the diagnosis that it is from, None for the nominal model.
        line: What to say of it, None where there was nothing to choose.
    """

    diagnosis: str | None = None
    line: str | None = None

    @property
    def lines(self) -> tuple[str, ...]:
        """The line, as what is printed first."""
        return () if self.line is None else (self.line,)


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a user says of the model, and of where to look for it.

    Attributes:
        model: Value of --model: "nominal", an id, or None.
        store: Value of --store, None where it is not given.
        logs: The logs of the command.
        instead: The option that says by itself what the nominal model is, such as
            "--baseline"; None for none.
    """

    model: str | None = None
    store: str | Path | None = None
    logs: Sequence[str] = ()
    instead: str | None = None


def choose(robot: Robot, wanted: Wanted) -> Choice:
    """Return the model to go by.

    The store is asked where the logs are runs of it, or where --store names it; what is
    in it has no say about files alone.

    Raises:
        InputError: If there is no such model, or it is of another robot or of another
            description of this one.
    """
    if wanted.model is not None and wanted.model != NOMINAL:
        if wanted.instead:
            raise InputError(
                f"--model and {wanted.instead} each say what the nominal model is. "
                "Give one of them."
            )
        id = diagnosis_of(store_folder(wanted.store), wanted.model)
        _check_robot(robot, store_folder(wanted.store), id)
        return Choice(id, f"model: that of diagnosis {id[:8]}, as --model says")
    runs = wanted.logs and all(map(is_run, wanted.logs))
    in_store = wanted.store is not None or runs
    last = in_store and numbered.adopted(
        store_folder(wanted.store), robot.name, robot.serial
    )
    if not last or last[1].diagnosis_id is None:
        return Choice(line=_nominal(robot, last or None))
    name = _named(robot, *last)
    if wanted.model == NOMINAL or wanted.instead:
        why = wanted.instead or "--model nominal"
        return Choice(line=f"model: the nominal one by {why}, not {name}")
    _check_robot(robot, store_folder(wanted.store), last[1].diagnosis_id)
    return Choice(last[1].diagnosis_id, f"model: {name}")


def choose_for(word: str, wanted: Wanted) -> Choice:
    """Return the model to go by for a robot by its word, as `choose` does."""
    return choose(load_of(word, wanted.logs, wanted.store), wanted)


def in_force(runs: Sequence[str], store: Path) -> Choice:
    """Return the model that the robot of some runs of a store has.

    Raises:
        InputError: If there is no run, or the model is of another description.
    """
    return choose_for(robot_of(runs, store), Wanted(store=store, logs=tuple(runs)))


def choose_to_watch(
    word: str, store: Path, nominal: bool, runs: Sequence[str] = ()
) -> Choice:
    """Return the model to watch by; no choice where a word names it by an id.

    Raises:
        InputError: If there is no such robot, or its model is of another description.
    """
    if is_run(word):
        return Choice()
    return choose_for(word, Wanted(NOMINAL if nominal else None, store, runs))


def chosen_to_drive(store: Path, run: str, model: str | None) -> Choice:
    """Return the model to drive the arm of a run by: any of the store may drive.

    Raises:
        InputError: If there is no such run or model.
    """
    if model is None or model == NOMINAL:
        word = robot_of([run], store)
        return choose_for(word, Wanted(model, store))
    id = layout.find(store, model).id
    return Choice(id, f"model: {id[:8]}, as --model says")


def diagnosis_of(store: Path, word: str) -> str:
    """Return the whole id of the diagnosis that a word stands for.

    Args:
        word: Id of a diagnosis, of the model that it ended with, or of an adoption.

    Raises:
        InputError: If there is none, or it is another record.
    """
    found = layout.find(store, word)
    if found.kind == "adoptions":
        id = layout.read_record(store, found.id)["diagnosis_id"]
        if id is None:
            raise InputError(f"Adoption {found.id} went back to the nominal model.")
        return id
    if found.kind == "diagnoses":
        return found.id
    of_model = _ended_with(store, found.id)
    if not of_model:
        raise InputError(
            f"{word} is one of {found.kind}, expected a diagnosis or the model that "
            "one ended with: modelgap sql 'SELECT diagnosis_id FROM diagnoses'."
        )
    return of_model[0]


def _ended_with(store: Path, model_id: str) -> list[str]:
    """Diagnoses that ended with a model, the first one first."""
    query = "SELECT diagnosis_id FROM diagnoses WHERE model_id = $id ORDER BY created"
    with sql.open_store(store) as opened:
        return opened.sql(query, {"id": model_id}).column(0).to_pylist()


def _check_robot(robot: Robot, store: Path, diagnosis: str) -> None:
    own = keep.read_known(store, diagnosis).robot
    if own.name != robot.name:
        raise InputError(
            f"The model of diagnosis {diagnosis[:8]} is of {own.name}, the robot is "
            f"{robot.name}. Give a model of this robot, or --model nominal."
        )
    if own.content_hash != robot.content_hash:
        raise InputError(
            f"The model of diagnosis {diagnosis[:8]} was made with another description "
            f"of {robot.name} than it has now. Put back the URDF and robot.toml of "
            "that time, or go on with --model nominal."
        )


def _named(robot: Robot, id: str, made: "numbered.Adoption") -> str:
    serial = f" {robot.serial}" if robot.serial else ""
    forced = ", against the gate" if made.action == "forced" else ""
    return (
        f"adoption {int(id)} of {robot.name}{serial}, diagnosis "
        f"{made.diagnosis_id[:8]}{forced}"
    )


def _nominal(robot: Robot, last: "tuple[str, numbered.Adoption] | None") -> str | None:
    """Nothing is said of a robot that never had another model."""
    if last is None:
        return None
    return f"model: the nominal one, to which adoption {int(last[0])} went back"
