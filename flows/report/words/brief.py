"""A verdict in half a line: for names of flow runs and rows of lists."""

from flows.report.words.check import title
from flows.report.words.phrases import At, joint_words, place
from flows.report.words.verdict import change, is_wrong_value, level
from residual.diagnosis.result import Finding, Verdict
from residual.quantity import bare_percent, known, percent

_NAMED_AT_MOST = 2


def brief(verdict: Verdict) -> str:
    """Return a verdict with its errors: "load friction on joint 2, 9.6 → 7.1 %".

    The errors are those of the headline of the report: held out, refit, then with
    what was found.
    """
    return ", ".join(part for part in (finding(verdict), errors(verdict)) if part)


def finding(verdict: Verdict) -> str:
    """Return what a verdict names, and what else it may be, without its errors."""
    if not verdict.trusted:
        faults = [title(fault) for fault in verdict.log_check.certain]
        return f"logs not to be trusted: {' and '.join(faults)}"
    if verdict.verdict == "effects":
        shown = [_item(e, verdict) for e in verdict.effects[:_NAMED_AT_MOST]]
        rest = len(verdict.effects) - len(shown)
        return ", ".join([*shown, *([f"{rest} more"] if rest else [])])
    if verdict.verdict == "unknown":
        where = joint_words(verdict.unexplained.joints, verdict.dof)
        return f"unknown{f' on {where}' if where else ''}"
    return "nothing missing"


def errors(verdict: Verdict) -> str:
    """Return the held-out error before and after, or the one there is; "" for none."""
    found = change(verdict) if verdict.verdict == "effects" else None
    if found:
        return f"{bare_percent(found.before)} → {percent(found.after)}"
    found, _ = level(verdict.error)
    return percent(found) if known(found) else ""


def _item(effect: Finding, verdict: Verdict) -> str:
    others = [
        _name(other) if other.joints == effect.joints else _at(other, verdict)
        for other in effect.equivalent
    ]
    words = _at(effect, verdict)
    words += f" (or {' or '.join(dict.fromkeys(others))})" if others else ""
    return f"wrong {words}" if is_wrong_value(effect, verdict) else words


def _name(effect: At) -> str:
    return effect.name.replace("_", " ")


def _at(effect: At, verdict: Verdict) -> str:
    return f"{_name(effect)} {place(effect, verdict.dof)}".strip()
