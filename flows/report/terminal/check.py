"""What a check found, for the terminal."""

from flows.inputs.repair import place_of
from flows.report.words.phrases import sentence_case
from flows.report.words.verdict import summary, title
from residual.check.result import Fault, LogCheck


def lines(report: LogCheck) -> list[str]:
    """Return the answer: one line, then a paragraph for each fault."""
    said = ["", summary(report)]
    for fault in report.faults:
        said += ["", *_fault(fault)]
    return said


def _fault(fault: Fault) -> list[str]:
    sure = "certain" if fault.certain else "suspected"
    said = [f"{sentence_case(title(fault))}: {fault.kind}, {sure}."]
    said += [f"  {line}" for line in fault.evidence.splitlines()]
    if fault.repair is None:
        return said
    repair = fault.repair.splitlines()
    place = place_of(fault.repair)
    return [*said, f"  To mend it ({place}):", *(f"    {line}" for line in repair)]
