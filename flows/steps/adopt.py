"""Adopt a model for a robot, roll it back, propose it; no record is ever deleted."""

from dataclasses import asdict, dataclass
from pathlib import Path

from flows.inputs import load_command_robot
from flows.settings import read_user_name, resolve_store_folder
from flows.steps.model_choice import resolve_diagnosis_id
from flows.storage import read_adoptable_model, read_models, read_verdict, store_report
from residual import one_blas_thread
from residual.diagnosis.adoption import AdoptionCheck, check_adoption
from residual.errors import InputError
from residual.model.model import Model
from residual.verdict.result import Verdict
from warehouse.record_commit import (
    ADOPTED,
    FORCED,
    ROLLED_BACK,
    AdoptionEntry,
    ModelAdoption,
    commit_adoption,
    find_last_adoption,
    read_adoptions,
)
from warehouse.remote_store import format_store_name
from warehouse.runs import read_run
from warehouse.store_catalogue import list_record_folders, read_record

# Largest error of a model on the baseline logs once its findings are removed, as a
# multiple of the error of the baseline's own model.
EDITED = 2.0


@dataclass(frozen=True, eq=False, slots=True)
class Judgment:
    """The judgment of the gate on a model, with the reasons."""

    diagnosis: str  # id of the diagnosis that found it
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


@one_blas_thread
def judge_adoption(store: Path, word: str) -> Judgment:
    """Compare the model of a diagnosis with the current model of its robot.

    The logs are those that the diagnosis held out; the model before it is the adopted
    one, else the one that the diagnosis started from.

    Args:
        word: Id of a diagnosis, of the model that it ended with, or of an adoption.
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
    return Judgment(id, record["model_id"], model, serial, parent, check, tuple(doubts))


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
    """Make a model the nominal model of its robot in this store.

    Args:
        word: Id of a diagnosis, of the model that it ended with, or of an adoption.
        force: Override the gate; needs a note.

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
            f"Refused: {'; '.join(judgment.doubts)}. {robot.name} keeps its current "
            "model. Diagnose with more motion, or give --force and a --note with the "
            "reason."
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


@dataclass(frozen=True, eq=False, slots=True)
class Proposal:
    """What is proposed."""

    judgment: Judgment
    verdict: Verdict

    @property
    def current_model(self) -> str:
        """The model that the robot has."""
        parent = self.judgment.parent
        if parent is None or parent[1].diagnosis_id is None:
            return "nominal model"
        return f"adoption {int(parent[0])}, diagnosis {parent[1].diagnosis_id[:8]}"

    @property
    def about(self) -> dict:
        """The content by which two proposals are the same."""
        parent = self.judgment.parent
        return {
            "robot": self.verdict.robot,
            "serial": self.judgment.serial,
            "kind": "proposal",
            "parent": parent and parent[0],
            "findings": [[e.name, *e.joints] for e in self.verdict.effects],
        }


def find_same_proposal(store: Path, proposal: Proposal) -> str | None:
    """Return the id of a proposal of the same findings, answered or not, or None."""
    about = proposal.about
    for id in list_record_folders(store, "reports"):
        if read_record(store, id) == about:
            return id
    return None


def store_proposal(store: Path, proposal: Proposal, page: bytes) -> Path:
    """Put the page of a proposal into the store."""
    files = {"proposal.html": page}
    folder = store_report(store, proposal.about, proposal.judgment.diagnosis, files)
    return folder / "proposal.html"
