"""What must be reached where several things changed, as figures of the rows."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from benchmarks.attribution_parts.arms import BODIES
from benchmarks.harness.cases import crash_figures, group_figures
from benchmarks.harness.figures import NO_BAR, Figures, figure, missing, undecided
from benchmarks.harness.rates import Hit, Rows, at_least, counted, counts, rate, share

_NO_LIST = "the verdict has no list of changed values"


def case_figures(rows: Mapping[str, Rows], deciding: bool) -> Figures:
    makers: Mapping[str, Callable[[Rows], Figures]] = {
        "unchanged": _unchanged,
        "changed": _changed,
        "sets": _sets,
    }
    figures = group_figures(rows, makers)
    every = [r for group in rows.values() for r in group if "outcome" in r]
    figures |= _moved(every) | edit_figures(every) | crash_figures(rows)
    return figures if deciding else undecided(figures)


def _unchanged(rows: Rows) -> Figures:
    named = [r for r in rows if r["said"]]
    entry = _parts(figure(len(named), 0, len(rows)), rows, lambda r: bool(r["said"]))
    names = counted(n[0][0] for r in named for n in r["said"])
    flagged = _rate(rows, lambda r: bool(r["unexplained"]))
    return {
        "unchanged_named": entry | {"names": names},
        "unchanged_flagged": flagged | {"why": NO_BAR},
    }


def _changed(rows: Rows) -> Figures:
    def told(row: Mapping) -> bool:
        return row["exact"] or row["listed"]

    said = [(r, len(r["said"])) for r in rows]
    names = sum(count for _, count in said)
    true = sum(r["true"] for r in rows)
    # Where the set that changed is listed beside the first one, the first is no claim.
    fair = sum(n if r["listed"] else r["true"] for r, n in said)
    missed = [p[0] for r in rows for p in r["planted"] if not _named(r, p)]
    short = sum(len(r["planted"]) < r["count"] for r in rows)
    return {
        "set_exact_or_listed": at_least(_rate(rows, told), 0.90)
        | {"per_name_missed": counted(missed)},
        "set_exact": _rate(rows, lambda r: r["exact"]) | {"why": NO_BAR},
        "set_exact_by_name": _rate(rows, lambda r: r["exact_by_name"])
        | {"why": NO_BAR},
        "precision": at_least(share(fair, names), 0.98)
        | {"false": counted(f for r in rows if not r["listed"] for f in _false(r))},
        "precision_first_set": share(true, names) | {"why": NO_BAR},
        "changes_named": share(true, sum(len(r["planted"]) for r in rows))
        | {"why": NO_BAR},
        "fewer_than_asked": figure(short, None, len(rows), why=NO_BAR),
    }


def _sets(rows: Rows) -> Figures:
    names = sum(len(r["said"]) for r in rows)
    true = sum(r["true"] for r in rows)
    false = counted(f for r in rows for f in _false(r))
    due = sum(len(r["planted"]) for r in rows)
    return {
        "exact_values_set_exact": at_least(rate(rows, lambda r: r["exact"]), 0.95),
        "exact_values_names_true": at_least(share(true, names), 0.99)
        | {"false": false},
        "exact_values_changes_named": share(true, due) | {"why": NO_BAR},
    }


def _named(row: Mapping, one: Sequence) -> bool:
    return any([one[0], one[1]] in names for names in row["said"])


def _false(row: Mapping) -> list[str]:
    """Names that are none of what changed, nor of a class with it."""
    there = [[p[0], p[1]] for p in row["planted"]]
    return [names[0][0] for names in row["said"] if not any(n in there for n in names)]


def _moved(rows: Rows) -> Figures:
    known = [r for r in rows if r["moved_due"] is not None]
    if not known:
        return {"moved_told": missing(0.98, _NO_LIST)} if rows else {}
    due = sum(len(r["moved_due"]) for r in known)
    told = sum(len(r["moved_told"]) for r in known)
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
    sparse = [e["error"] / e["reference"] for e in edits if e["reference"]]
    bodies = [e for e in edits if e["name"] in BODIES and e["least_squares"]]
    dense = [e["error"] / e["least_squares"] for e in bodies]
    left = [e["error"] for e in bodies], [e["least_squares"] for e in bodies]
    out = {
        "edit_over_oracle": _quantile(sparse, 0.5, 1.1),
        "edit_over_oracle_90": _quantile(sparse, 0.9, 1.5),
        "edit_over_least_squares": _quantile(dense, 0.5, 0.2),
        "edit_error": _quantile(left[0], 0.5, None),
        "edit_error_of_least_squares": _quantile(left[1], 0.5, None),
    }
    moving = [e["moving"] for e in edits if e["moving"][1]]
    over = [error / reference for error, reference, _ in moving]
    out["edit_over_oracle_moving"] = _quantile(over, 0.5, None)
    over = [e["moving"][0] / e["moving"][2] for e in bodies]
    out["edit_over_least_squares_moving"] = _quantile(over, 0.5, None)
    each: dict[str, list[float]] = {}
    for one in edits:
        each.setdefault(one["name"], []).append(one["error"] / one["reference"])
    per_name = {k: [len(v), float(np.median(v))] for k, v in sorted(each.items())}
    out["edit_over_oracle"] |= {"per_name": per_name}
    return out


def _quantile(values: Sequence[float], share: float, bar: float | None) -> dict:
    value = float(np.quantile(values, share)) if len(values) else None
    entry = figure(value, bar, len(values))
    return entry | ({"why": NO_BAR} if bar is None else {})


def _rate(rows: Rows, hit: Hit) -> dict:
    return _parts(rate(rows, hit), rows, hit)


def _parts(entry: dict, rows: Rows, hit: Hit) -> dict:
    """Return a figure with its counts by arm, by what is off and by changes."""
    named = [
        row | {"off": f"{row['off']} % off", "count": f"{row['count']} changes"}
        for row in rows
    ]
    parts = [counts(named, hit, key) for key in ("arm", "off", "count")]
    return entry | {"parts": dict(sorted((parts[0] | parts[1] | parts[2]).items()))}
