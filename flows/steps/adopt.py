"""Give a robot another model, with a reason, and take it back; nothing is deleted."""

from dataclasses import asdict, dataclass
from getpass import getuser
from pathlib import Path
from typing import NamedTuple

from flows.inputs.given import load
from flows.requests import Flag, GivenWord, Request, Store, Text
from flows.settings import store_folder
from flows.steps.models import diagnosis_of
from flows.storage.diagnosis import read_known, read_models, read_verdict, store_report
from residual.diagnosis.held_out import AdoptionCheck, check_adoption
from residual.errors import InputError
from residual.model.model import Model
from residual.threads import one_blas_thread
from residual.verdict.result import Verdict
from warehouse.files import read_parquet
from warehouse.ids import record_folder
from warehouse.layout import list_folders, read_record
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
from warehouse.remote import store_name
from warehouse.runs import read_run
from warehouse.schema import KINDS

# Times the error of the baseline's own model: what a model may leave of its logs once
# what was found is taken out again.
EDITED = 2.0


@dataclass(frozen=True, eq=False, slots=True)
class Judged:
    """A model before the gate."""

    diagnosis: str  # id of the diagnosis that found it
    model_id: str
    model: Model
    # The adoption that the robot has, with its number; None for none.
    parent: tuple[str, Adoption] | None
    check: AdoptionCheck | None  # on held-out motion; None without held-out logs
    # Why it should not be adopted; empty for a model that may.
    doubts: tuple[str, ...] = ()

    def as_record(self) -> dict:
        """Return what the gate saw as JSON can hold it."""
        seen = asdict(self.check) if self.check else {}
        seen.pop("doubts", None)
        return {"held_out": seen, "doubts": list(self.doubts)}


@one_blas_thread
def judge(store: Path, word: str) -> Judged:
    """Hold the model of a diagnosis against the one that its robot has.

    The logs are those that the diagnosis held out; the model before it is the adopted
    one, else the one that the diagnosis started from.

    Args:
        word: Id of a diagnosis, of the model that it ended with, or of an adoption.
    """
    id = diagnosis_of(store, word)
    verdict, model = read_verdict(store, id), read_known(store, id)
    parent = adopted(store, model.robot.name, model.robot.serial)
    doubts, seen, record = _of_verdict(verdict), None, read_record(store, id)
    runs = record["request"].get("held_out")
    if not runs:
        doubts.append("no run was held out; diagnose with --holdout RUN")
    else:
        if parent and parent[1].diagnosis_id:
            before = read_known(store, parent[1].diagnosis_id)
        else:
            before = read_models(store, id)["nominal"]
        seen = check_adoption(model, before, [read_run(store, run) for run in runs])
        doubts += seen.doubts
    return Judged(id, record["model_id"], model, parent, seen, tuple(doubts))


def _of_verdict(verdict: Verdict) -> list[str]:
    """What of a verdict speaks against its model."""
    out = []
    if not verdict.trusted:
        out.append("a fault of its logs is certain")
    if verdict.contradictions:
        out.append("no arm can be as its fit says")
    if not verdict.effects:
        out.append("it names nothing that the model lacks")
    if verdict.error.same_run:
        out.append("its proof is the end of a log that was fitted")
    # The edit test: without its effects a model is that of the baseline.
    for one in verdict.edit or ():
        if None in (one.error, one.kept, one.reference):
            continue
        if one.error > min(one.kept, EDITED * one.reference):
            out.append(
                f"without {one.name} it leaves {one.error:.3g} % "
                f"of the healthy logs' torque, with it {one.kept:.3g} %, and their own "
                f"model {one.reference:.3g} %: the edit test is not passed"
            )
    return out


@dataclass(frozen=True, slots=True)
class Adopt(Request):
    """Which model a robot is to get.

    Attributes:
        model: Id of a diagnosis, of the model that it ended with, or of an adoption.
        note: A word about it, which is kept.
        force: Adopt it against the gate; that needs a --note.
    """

    model: GivenWord = ""
    note: Text = ""
    force: Flag = False
    store: Store = None


def adopt(request: Adopt) -> tuple[str, Judged]:
    """Let a model be the nominal one of its robot in this store from now on.

    Returns:
        The number of the adoption, and what the gate saw.
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
        before=judged.check.before if judged.check else None,
        after=judged.check.after if judged.check else None,
        evidence=judged.as_record(),
    )
    return commit_adoption(store, made), judged


def roll_back(
    word: str | None, note: str = "", store: str | Path | None = None
) -> tuple[str, Adoption]:
    """Give a robot the model back that it had before, by one more record.

    Args:
        word: The robot; None where the store has adoptions of one alone.
    """
    place = store_folder(store)
    robot, serial = _robot_of(place, word)
    last = adopted(place, robot, serial)
    if last is None or last[1].model_id is None:
        raise InputError(f"{robot} has its nominal model: nothing to go back from.")
    # The version under the one in force: what was rolled back is off the pile.
    pile: list[Adoption | None] = [None]
    for _, each, _ in list_adoptions(place):
        if (each.robot, each.serial) != (robot, serial):
            continue
        if each.action == ROLLED_BACK:
            pile.pop()
        else:
            pile.append(each)
    before = pile[-2]
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


class Listed(NamedTuple):
    """An adoption of a store, with its number and when it was made, in words."""

    number: str
    adoption: Adoption
    since: str


def list_adoptions(
    store: str | Path | None = None, word: str | None = None
) -> list[Listed]:
    """Return all adoptions, the first one first.

    Args:
        word: A robot, or its name, to list alone; None for all.
    """
    place = store_folder(store)
    keys = None if word is None else _robots(place, word)
    out = []
    for id in list_folders(place, ADOPTIONS):
        made = read_adoption(place, id)
        if keys is None or (made.robot, made.serial) in keys:
            path = record_folder(place, ADOPTIONS, id) / KINDS[ADOPTIONS].row
            created = read_parquet(path, ["created"]).column("created")[0].as_py()
            out.append(Listed(id, made, f"{created:%Y-%m-%d %H:%M}"))
    return out


def _robots(store: Path, word: str | None) -> set[tuple[str, str | None]]:
    """Name and serial number of what a word may stand for: a name, or a robot.

    Of None: of all robots with an adoption.
    """
    keys = {(made.robot, made.serial) for _, made, _ in list_adoptions(store)}
    if word is None:
        return keys
    by_name = {key for key in keys if key[0] == word}
    if by_name:
        return by_name
    robot = load(word)
    return {(robot.name, robot.serial)}


def _robot_of(store: Path, word: str | None) -> tuple[str, str | None]:
    keys = _robots(store, word)
    if len(keys) == 1:
        return keys.pop()
    if not keys:
        raise InputError(
            f"No model was adopted in {store_name(store)}: nothing to go back from."
        )
    names = ", ".join(f"{r} {s or ''}".strip() for r, s in sorted(keys, key=str))
    raise InputError(f"Several robots have adopted models: {names}. Say --robot R.")


def _user() -> str:
    try:
        return getuser()
    except (KeyError, OSError):  # a container may have no name for its user
        return "unknown"


@dataclass(frozen=True, eq=False, slots=True)
class Proposal:
    """What is proposed."""

    judged: Judged
    verdict: Verdict

    @property
    def now(self) -> str:
        """The model that the robot has."""
        parent = self.judged.parent
        if parent is None or parent[1].diagnosis_id is None:
            return "nominal model"
        return f"adoption {int(parent[0])}, diagnosis {parent[1].diagnosis_id[:8]}"

    @property
    def about(self) -> dict:
        """What makes it the same proposal as that of another night."""
        parent = self.judged.parent
        return {
            "robot": self.verdict.robot,
            "serial": self.judged.model.robot.serial,
            "kind": "proposal",
            "parent": parent and parent[0],
            "findings": [[e.name, *e.joints] for e in self.verdict.effects],
        }


def known_already(store: Path, proposal: Proposal) -> str | None:
    """Return the id of a proposal of the same findings, answered or not, or None."""
    about = proposal.about
    for id in list_folders(store, "reports"):
        if read_record(store, id) == about:
            return id
    return None


def keep_proposal(store: Path, proposal: Proposal, page: bytes) -> Path:
    """Put the page of a proposal into the store."""
    files = {"proposal.html": page}
    folder = store_report(store, proposal.about, proposal.judged.diagnosis, files)
    return folder / "proposal.html"
