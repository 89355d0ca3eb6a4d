"""The gate: may the model of a diagnosis be that of its robot from now on?"""

from dataclasses import asdict, dataclass
from pathlib import Path

from flows.steps.loop.choose import diagnosis_of
from flows.storage.diagnosis import read_known, read_models, read_verdict
from residual.diagnosis.held_out import Worth, worth
from residual.diagnosis.result import Verdict
from residual.model.model import Model
from residual.threads import one_blas_thread
from warehouse.layout import read_record
from warehouse.numbered import Adoption, adopted
from warehouse.runs import read_run

# Times the error of the baseline's own model: what a model may leave of its logs once
# what was found is taken out again.
EDITED = 2.0


@dataclass(frozen=True, eq=False, slots=True)
class Judged:
    """A model before the gate.

    Attributes:
        diagnosis: Id of the diagnosis that found it.
        model_id: Its own id.
        model: The model.
        parent: The adoption that the robot has, with its number; None for none.
        worth: What held-out motion says, None where there is none to ask.
        doubts: Why it should not be adopted; empty for a model that may.
    """

    diagnosis: str
    model_id: str
    model: Model
    parent: tuple[str, Adoption] | None
    worth: Worth | None
    doubts: tuple[str, ...] = ()

    def as_record(self) -> dict:
        """Return what the gate saw as JSON can hold it."""
        seen = asdict(self.worth) if self.worth else {}
        seen.pop("doubts", None)
        return {"held_out": seen, "doubts": list(self.doubts)}


@one_blas_thread
def judge(store: Path, word: str) -> Judged:
    """Hold the model of a diagnosis against the one that its robot has.

    The logs are those that the diagnosis held out; the model before it is the adopted
    one, else the one that the diagnosis started from.

    Args:
        word: Id of a diagnosis, of the model that it ended with, or of an adoption.

    Raises:
        InputError: If there is no such model.
    """
    id = diagnosis_of(store, word)
    verdict, model = read_verdict(store, id), read_known(store, id)
    parent = adopted(store, model.robot.name, model.robot.serial)
    doubts, seen = _of_verdict(verdict), None
    runs = _held_out(store, id)
    if not runs:
        doubts.append("no run was held out; diagnose with --holdout RUN")
    else:
        before = _before(store, id, parent)
        seen = worth(model, before, [read_run(store, run) for run in runs])
        doubts += seen.doubts
    record = read_record(store, id)
    return Judged(id, record["model_id"], model, parent, seen, tuple(doubts))


def _of_verdict(verdict: Verdict) -> list[str]:
    out = []
    if not verdict.trusted:
        out.append("a fault of its logs is certain")
    if verdict.contradictions:
        out.append("no arm can be as its fit says")
    if not verdict.effects:
        out.append("it names nothing that the model lacks")
    if verdict.error.same_run:
        out.append("its proof is the end of a log that was fitted")
    return [*out, *_of_edit(verdict)]


def _of_edit(verdict: Verdict) -> list[str]:
    """What the edit test says: without its effects a model is that of the baseline."""
    out = []
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


def _held_out(store: Path, diagnosis: str) -> tuple[str, ...]:
    return tuple(read_record(store, diagnosis)["request"].get("held_out") or ())


def _before(store: Path, diagnosis: str, parent: tuple[str, Adoption] | None) -> Model:
    if parent and parent[1].diagnosis_id:
        return read_known(store, parent[1].diagnosis_id)
    return read_models(store, diagnosis)["nominal"]
