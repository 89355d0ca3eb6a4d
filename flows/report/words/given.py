"""Values that the model was given and the logs do not bear out, in words."""

from typing import NamedTuple

from flows.report.words.phrases import count, joint_words, listing
from residual.diagnosis.causes.change import Change
from residual.diagnosis.result import Verdict
from residual.quantity import known, measured, number, unit_text

_SHOWN = 3
_ROWS = 12
_HUGE = 10.0  # times: of a value that was next to nothing a share says nothing
_LONGEST = 2  # parts of a sum that are printed; the JSON has all of them


class GivenRow(NamedTuple):
    """One value of a table: what it is, as given, as the logs have it, how sure."""

    what: str
    given: str
    found: str
    off: str


def off(verdict: Verdict) -> list[Change]:
    """Return the values that are off and that no finding speaks of, worst first."""
    told = [c for c in verdict.changes if c.beyond and not c.explained]
    return sorted(told, key=lambda c: (not _of_drive(c, verdict), -abs(_share(c))))


def off_words(verdict: Verdict) -> str:
    """Return in one sentence which given values are off; empty where none is."""
    every = off(verdict)
    drives = [c for c in every if _of_drive(c, verdict)]
    sums = len(every) - len(drives)
    if not every:
        return ""
    few = len(drives) - _SHOWN <= 1
    shown = drives if few else drives[:_SHOWN]
    parts = [f"{_what(c, verdict)} ({_from_to(c)})" for c in shown]
    if not few:
        parts.append(f"{count(len(drives) - _SHOWN)} more")
    if sums:
        what = "sum" if sums == 1 else "sums"
        parts.append(f"{count(sums)} {what} of masses and inertias")
    verb = "is" if len(every) == 1 else "are"
    start = "Besides, " if verdict.effects else "But "
    many = count(len(every))
    return f"{start}{many} of its values {verb} off: {listing(parts)}."


def off_rows(verdict: Verdict) -> list[GivenRow]:
    """Return the table of the values that are off, at most twelve."""
    return [_row(c, verdict) for c in off(verdict)[:_ROWS]]


def all_rows(verdict: Verdict) -> list[GivenRow]:
    """Return the table of every value that the model was given."""
    return [_row(c, verdict) for c in verdict.changes]


def _row(change: Change, verdict: Verdict) -> GivenRow:
    share = _share(change)
    return GivenRow(
        _what(change, verdict),
        f"{number(change.nominal)} {unit_text(change.unit)}".strip(),
        measured(change.identified, change.std, change.unit),
        f"{100 * share:+.0f} %" if abs(share) < _HUGE else "",
    )


def hidden_rows(verdict: Verdict) -> int:
    """Return how many values the table leaves out."""
    return max(len(off(verdict)) - _ROWS, 0)


def _what(change: Change, verdict: Verdict) -> str:
    if not _of_drive(change, verdict):
        parts = change.parameter.split(" + ")
        more = " + ..." if len(parts) > _LONGEST else ""
        return " + ".join(parts[:_LONGEST]) + more
    words = change.name.replace("_", " ")
    if change.parameter not in words:
        words = f"{words} {change.parameter}"
    where = joint_words(change.joints, verdict.dof)
    return f"{words} of {where}" if where else words


def _from_to(change: Change) -> str:
    unit = unit_text(change.unit)
    return f"{number(change.nominal)} → {number(change.identified)} {unit}".strip()


def _share(change: Change) -> float:
    """By how much a value is off, as a share of what was given."""
    if not known(change.identified) or not known(change.nominal):
        return 0.0
    gap = change.identified - change.nominal
    return gap / abs(change.nominal) if change.nominal else float("inf")


def _of_drive(change: Change, verdict: Verdict) -> bool:
    """Whether a value belongs to a declared effect, not to the body."""
    return change.name in verdict.declared
