"""Propose the model of a diagnosis: two models side by side, once for each finding."""

from dataclasses import dataclass
from pathlib import Path

from flows.steps.loop.judge import Judged
from flows.storage.diagnosis import read_verdict, store_report
from residual.diagnosis.result import Verdict
from warehouse.layout import list_folders, read_record

KIND = "proposal"


@dataclass(frozen=True, eq=False, slots=True)
class Proposal:
    """What is proposed.

    Attributes:
        judged: The model before the gate.
        verdict: What its diagnosis says.
    """

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
            "kind": KIND,
            "parent": parent and parent[0],
            "findings": [[e.name, *e.joints] for e in self.verdict.effects],
        }


def proposal_of(store: Path, judged: Judged) -> Proposal:
    """Return a model as a proposal."""
    return Proposal(judged, read_verdict(store, judged.diagnosis))


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
