"""What must be reached where several things changed, as figures of the rows."""

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.attribution_parts.arms import BODIES
from benchmarks.harness.cases import crash_figures, group_figures
from benchmarks.harness.figures import NO_BAR, Figures, figure, missing, undecided
from benchmarks.harness.rates import Line, Rows, at_least, counted, lines, share

_NO_LIST = "the verdict has no list of changed values"


def case_figures(rows: Mapping[str, Rows], deciding: bool) -> Figures:
    makers = {"unchanged": _unchanged, "changed": _changed, "sets": _sets}
    figures = group_figures(rows, makers)
    every = [r for group in rows.values() for r in group if "outcome" in r]
    figures |= _moved(every) | edit_figures(every) | crash_figures(rows)
    return figures if deciding else undecided(figures)


def _unchanged(rows: Rows) -> Figures:
    named = [r for r in rows if r["said"]]
    names = counted(n[0][0] for r in named for n in r["said"])
    flagged = Line("unchanged_flagged", lambda r: bool(r["unexplained"]))
    entry = figure(len(named), 0, len(rows), names=names)
    return {"unchanged_named": entry} | lines([flagged], rows)


def _exact(row: Mapping) -> bool:
    return row["exact"]


def _told(row: Mapping) -> bool:
    return row["exact"] or row["listed"]


def _missed(rows: Rows) -> dict:
    lost = [
        p[0]
        for r in rows
        for p in r["planted"]
        if not any([p[0], p[1]] in names for names in r["said"])
    ]
    return {"per_name_missed": counted(lost)}


_OF_CHANGED = (
    Line("set_exact_or_listed", _told, 0.90, beside=_missed),
    Line("set_exact", _exact),
    Line("set_exact_by_name", lambda r: r["exact_by_name"]),
)


def _changed(rows: Rows) -> Figures:
    names, true, due = _counts(rows)
    # Where the set that changed is listed beside the first one, the first is no claim.
    fair = sum(len(r["said"]) if r["listed"] else r["true"] for r in rows)
    false = counted(f for r in rows if not r["listed"] for f in _false(r))
    short = sum(len(r["planted"]) < r["count"] for r in rows)
    return lines(_OF_CHANGED, rows) | {
        "precision": at_least(share(fair, names), 0.98) | {"false": false},
        "precision_first_set": at_least(share(true, names), None),
        "changes_named": at_least(share(true, due), None),
        "fewer_than_asked": figure(short, None, len(rows), why=NO_BAR),
    }


def _sets(rows: Rows) -> Figures:
    names, true, due = _counts(rows)
    false = {"false": counted(f for r in rows for f in _false(r))}
    return lines([Line("exact_values_set_exact", _exact, 0.95)], rows) | {
        "exact_values_names_true": at_least(share(true, names), 0.99) | false,
        "exact_values_changes_named": at_least(share(true, due), None),
    }


def _counts(rows: Rows) -> tuple[int, int, int]:
    """Return how many names there are, how many are true, and how many were due."""
    each = [(len(r["said"]), r["true"], len(r["planted"])) for r in rows]
    return tuple(map(sum, zip(*each, strict=True))) if each else (0, 0, 0)


def _false(row: Mapping) -> list[str]:
    """Names that are none of what changed, nor of a class with it."""
    there = [[p[0], p[1]] for p in row["planted"]]
    return [names[0][0] for names in row["said"] if not any(n in there for n in names)]


def _moved(rows: Rows) -> Figures:
    known = [r for r in rows if r["moved_due"] is not None]
    if not known:
        return {"moved_told": missing(0.98, _NO_LIST)} if rows else {}
    due, told = (sum(len(r[k]) for r in known) for k in ("moved_due", "moved_told"))
    lost = [
        key[0] for r in known for key in r["moved_due"] if key not in r["moved_told"]
    ]
    false = sum(len(r["moved_false"]) for r in known)
    return {
        "moved_told": at_least(share(told, due), 0.98) | {"missed": counted(lost)},
        "moved_told_within_5_percent": figure(false, None, len(known), why=NO_BAR),
    }


def edit_figures(rows: Rows) -> Figures:
    """Return what is left of changes that were named and taken out again.

    Of changes under their very name: what has another cannot be taken out by it.
    """
    edits = [e for r in rows for e in r["edits"]]
    if not edits:
        return {}
    bodies = [e for e in edits if e["name"] in BODIES and e["least_squares"]]
    sparse = [e["error"] / e["reference"] for e in edits if e["reference"]]
    dense = [e["error"] / e["least_squares"] for e in bodies]
    moving = [e["moving"][0] / e["moving"][1] for e in edits if e["moving"][1]]
    others = [e["moving"][0] / e["moving"][2] for e in bodies]
    left, theirs = ([e[k] for e in bodies] for k in ("error", "least_squares"))
    each: dict[str, list[float]] = {}
    for one in edits:
        each.setdefault(one["name"], []).append(one["error"] / one["reference"])
    per_name = {k: [len(v), float(np.median(v))] for k, v in sorted(each.items())}
    return {
        "edit_over_oracle": _quantile(sparse, 0.5, 1.1) | {"per_name": per_name},
        "edit_over_oracle_90": _quantile(sparse, 0.9, 1.5),
        "edit_over_least_squares": _quantile(dense, 0.5, 0.2),
        "edit_error": _quantile(left, 0.5, None),
        "edit_error_of_least_squares": _quantile(theirs, 0.5, None),
        "edit_over_oracle_moving": _quantile(moving, 0.5, None),
        "edit_over_least_squares_moving": _quantile(others, 0.5, None),
    }


def _quantile(values: Sequence[float], share: float, bar: float | None) -> dict:
    value = float(np.quantile(values, share)) if len(values) else None
    entry = figure(value, bar, len(values))
    return entry | ({"why": NO_BAR} if bar is None else {})
