"""What a check found, for the terminal."""

from flows.report.words.check import summary, title
from residual.check.report import CheckReport, FaultReport

_ROBOT_KEYS = ("gravity",)


def lines(report: CheckReport) -> list[str]:
    """Return the answer: one line, then a paragraph for each fault."""
    said = ["", summary(report)]
    for fault in report.faults:
        said += ["", *_fault(fault)]
    return said


def _fault(fault: FaultReport) -> list[str]:
    sure = "certain" if fault.certain else "suspected"
    said = [f"{title(fault)} ({fault.kind}, {sure})."]
    said += [f"  {line}" for line in fault.evidence.splitlines()]
    if fault.repair is None:
        return said
    repair = fault.repair.splitlines()
    of_robot = all(line.startswith(_ROBOT_KEYS) for line in repair)
    place = "robot.toml, [robot]" if of_robot else "COLUMNS.toml (--map)"
    return [*said, f"  To mend it, in {place}:", *(f"    {line}" for line in repair)]
