"""Give a robot another model, with a reason, and take it back; nothing is deleted."""

from dataclasses import dataclass
from getpass import getuser
from pathlib import Path

from flows.inputs.robots import load
from flows.settings import store_folder
from flows.steps.loop.judge import Judged, judge
from residual.errors import InputError
from warehouse.files import read_parquet
from warehouse.ids import record_folder
from warehouse.layout import list_folders
from warehouse.numbered import (
    ADOPTED,
    ADOPTIONS,
    FORCED,
    ROLLED_BACK,
    Adoption,
    adopted,
    commit_adoption,
    read_adoption,
)
from warehouse.objects.mirror import shown
from warehouse.schema import KINDS


@dataclass(frozen=True, slots=True)
class Adopt:
    """Which model a robot is to get.

    Attributes:
        model: Id of a diagnosis, of the model that it ended with, or of an adoption.
        note: A word about it.
        force: Whether to adopt it against the gate; that needs a note.
        store: Folder of the store, None for the usual one.
    """

    model: str
    note: str = ""
    force: bool = False
    store: str | Path | None = None


def adopt(request: Adopt) -> tuple[str, Judged]:
    """Let a model be the nominal one of its robot in this store from now on.

    Returns:
        The number of the adoption, and what the gate saw.

    Raises:
        InputError: If the gate refuses, the robot has that model already, or has got
            another one meanwhile.
    """
    store = store_folder(request.store)
    judged = judge(store, request.model)
    robot, parent = judged.model.robot, judged.parent
    if parent and parent[1].model_id == judged.model_id:
        raise InputError(
            f"{robot.name} has that model already, by adoption {int(parent[0])}."
        )
    if judged.doubts and not request.force:
        raise InputError(
            f"Refused: {'; '.join(judged.doubts)}. {robot.name} keeps the model that "
            "it has. Diagnose with more motion, or give --force and a --note with the "
            "reason."
        )
    if request.force and not request.note:
        raise InputError(
            "--force needs a --note: why is it to be adopted all the same?"
        )
    made = Adoption(
        robot=robot.name,
        serial=robot.serial,
        action=FORCED if judged.doubts else ADOPTED,
        model_id=judged.model_id,
        diagnosis_id=judged.diagnosis,
        parent=parent[0] if parent else None,
        who=_user(),
        note=request.note,
        before=judged.worth.before if judged.worth else None,
        after=judged.worth.after if judged.worth else None,
        evidence=judged.as_record(),
    )
    return commit_adoption(store, made), judged


def roll_back(
    word: str | None, note: str = "", store: str | Path | None = None
) -> tuple[str, Adoption]:
    """Give a robot the model back that it had before, by one more record.

    Args:
        word: The robot; None where the store has adoptions of one alone.
        store: Folder of the store, None for the usual one.

    Raises:
        InputError: If there is nothing to go back from, or it is not clear for whom.
    """
    place = store_folder(store)
    robot, serial = _robot_of(place, word)
    last = adopted(place, robot, serial)
    if last is None or last[1].model_id is None:
        raise InputError(f"{robot} has its nominal model: nothing to go back from.")
    before = _gone_back_to(place, robot, serial)
    made = Adoption(
        robot=robot,
        serial=serial,
        action=ROLLED_BACK,
        model_id=before and before.model_id,
        diagnosis_id=before and before.diagnosis_id,
        parent=last[0],
        who=_user(),
        note=note,
        before=last[1].after,
        after=last[1].before,
    )
    return commit_adoption(place, made), made


def list_adoptions(
    store: str | Path | None = None, word: str | None = None
) -> list[tuple[str, Adoption, str]]:
    """Return all adoptions with number and time, the first one first.

    Args:
        store: Folder of the store, None for the usual one.
        word: A robot, or its name, to list alone; None for all.

    Raises:
        InputError: If a record is damaged.
    """
    place = store_folder(store)
    wanted = None if word is None else _named(place, word)
    out = []
    for id in list_folders(place, ADOPTIONS):
        made = read_adoption(place, id)
        if wanted is None or (made.robot, made.serial) in wanted:
            out.append((id, made, _created(place, id)))
    return out


def _gone_back_to(store: Path, robot: str, serial: str | None) -> Adoption | None:
    """The version under the one in force: what was rolled back is off the pile."""
    pile: list[Adoption] = []
    for id in list_folders(store, ADOPTIONS):
        made = read_adoption(store, id)
        if (made.robot, made.serial) != (robot, serial):
            continue
        if made.action == ROLLED_BACK:
            pile.pop()
        else:
            pile.append(made)
    return pile[-2] if len(pile) > 1 else None


def _named(store: Path, word: str) -> set[tuple[str, str | None]]:
    """Name and serial number that a word may stand for: a name, or a robot."""
    keys = {(made.robot, made.serial) for _, made, _ in list_adoptions(store)}
    by_name = {key for key in keys if key[0] == word}
    if by_name:
        return by_name
    robot = load(word)
    return {(robot.name, robot.serial)}


def _robot_of(store: Path, word: str | None) -> tuple[str, str | None]:
    if word is not None:
        keys = _named(store, word)
    else:
        keys = {(made.robot, made.serial) for _, made, _ in list_adoptions(store)}
    if len(keys) == 1:
        return keys.pop()
    if not keys:
        raise InputError(
            f"No model was adopted in {shown(store)}: nothing to go back from."
        )
    names = ", ".join(f"{r} {s or ''}".strip() for r, s in sorted(keys, key=str))
    raise InputError(f"Several robots have adopted models: {names}. Say --robot R.")


def _created(store: Path, id: str) -> str:
    path = record_folder(store, ADOPTIONS, id) / KINDS[ADOPTIONS].row
    created = read_parquet(path, ["created"]).column("created")[0].as_py()
    return f"{created:%Y-%m-%d %H:%M}"


def _user() -> str:
    try:
        return getuser()
    except (KeyError, OSError):  # a container may have no name for its user
        return "unknown"
