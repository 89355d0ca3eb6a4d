"""Faults as they are told: with the line that mends each, ready for JSON and back."""

from collections.abc import Mapping
from dataclasses import dataclass

from residual.errors import InputError
from residual.names import joints_listed, shown

SCHEMA = 1


@dataclass(frozen=True, slots=True)
class FaultReport:
    """One fault of logs, and what mends it.

    Attributes:
        kind: What sort of fault (docs/check.md).
        joints: Its joints, from 1; () for all.
        certain: Whether the reading given is excluded; else it is a warning.
        evidence: Why, in words and numbers.
        repair: Lines for COLUMNS.toml or robot.toml; None where no line mends it.
    """

    kind: str
    joints: tuple[int, ...]
    certain: bool
    evidence: str
    repair: str | None = None

    @property
    def where(self) -> str:
        """Kind and joints: 'torque sign, joint 2'."""
        joints = f", {joints_listed(self.joints)}" if self.joints else ""
        return self.kind.replace("_", " ") + joints

    @property
    def sentence(self) -> str:
        """What is wrong, why, and what mends it, in one line."""
        sure = "certain" if self.certain else "suspected"
        mended = f" To mend it: {self.repair}" if self.repair else ""
        said = f"fault of the logs ({self.where}, {sure}): {self.evidence}{mended}"
        return " ".join(said.split())


@dataclass(frozen=True, slots=True, repr=False)
class CheckReport:
    """What is wrong with the logs of one command.

    Attributes:
        faults: The faults, certain ones first.
    """

    faults: tuple[FaultReport, ...] = ()

    @property
    def verdict(self) -> str:
        """Return "clean", "suspect", or "unusable" where any fault is certain."""
        if self.certain:
            return "unusable"
        return "suspect" if self.faults else "clean"

    @property
    def certain(self) -> tuple[FaultReport, ...]:
        """The faults that exclude the reading given."""
        return tuple(fault for fault in self.faults if fault.certain)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Every fault in a line."""
        return tuple(fault.sentence for fault in self.faults)

    def to_json(self) -> dict:
        """Return the report in its documented form (docs/check.md)."""
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "faults": [
                {
                    "kind": fault.kind,
                    "joints": list(fault.joints),
                    "certain": fault.certain,
                    "evidence": fault.evidence,
                    "repair": fault.repair,
                }
                for fault in self.faults
            ],
        }

    def __repr__(self) -> str:
        lines = [f"LogCheck({self.verdict})"]
        for fault in self.faults:
            sure = "certain" if fault.certain else "suspect"
            lines.append(f"  {fault.where} ({sure}): {fault.evidence}")
            lines += [f"    {line}" for line in (fault.repair or "").splitlines()]
        return "\n".join(lines)


def from_json(document: Mapping) -> CheckReport:
    """Return the report of a document.

    Raises:
        InputError: If it is of another schema, or a key is missing.
    """
    if document.get("schema") != SCHEMA:
        raise InputError(
            f"A check of schema {shown(document.get('schema'))}, expected {SCHEMA}."
        )
    try:
        return CheckReport(
            tuple(
                FaultReport(
                    f["kind"],
                    tuple(f["joints"]),
                    f["certain"],
                    f["evidence"],
                    f["repair"],
                )
                for f in document["faults"]
            )
        )
    except (KeyError, TypeError) as error:
        raise InputError(f"This is no whole check: {error!r}.") from error
