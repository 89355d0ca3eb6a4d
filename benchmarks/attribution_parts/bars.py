"""Figures and bars of the rows of all groups."""

from collections.abc import Mapping

from benchmarks.harness.cases import crash_figures, group_figures
from benchmarks.harness.figures import Figures, figure, undecided
from benchmarks.harness.rates import Line, Rows, at_least, counted, lines, share


def case_figures(rows: Mapping[str, Rows], deciding: bool) -> Figures:
    makers = {"unchanged": _unchanged, "sets": _changed}
    figures = group_figures(rows, makers)
    figures |= crash_figures(rows)
    return figures if deciding else undecided(figures)


def _unchanged(rows: Rows) -> Figures:
    named = [r for r in rows if r["said"]]
    names = counted(n[0][0] for r in named for n in r["said"])
    flagged = Line("unchanged_flagged", lambda r: bool(r["unexplained"]))
    entry = figure(len(named), 0, len(rows), names=names)
    return {"unchanged_named": entry} | lines([flagged], rows)


def _exact(row: Mapping) -> bool:
    return row["exact"]


def _exact_or_listed(row: Mapping) -> bool:
    return row["exact"] or row["listed"]


def _missed(rows: Rows) -> dict:
    lost = [
        p[0]
        for r in rows
        for p in r["planted"]
        if not any([p[0], p[1]] in names for names in r["said"])
    ]
    return {"per_name_missed": counted(lost)}


def _changed(rows: Rows) -> Figures:
    """Return figures of arms with changes; those with exact given values apart."""
    out: Figures = {}
    exact, rough = ([r for r in rows if bool(r["off"]) is off] for off in (False, True))
    if exact:
        names, true, due = _counts(exact)
        false = {"false": counted(f for r in exact for f in _false(r))}
        out |= lines([Line("exact_values_set_exact", _exact, 0.95)], exact) | {
            "exact_values_names_true": at_least(share(true, names), 0.99) | false,
            "exact_values_changes_named": at_least(share(true, due), None),
        }
    if rough:
        names, true, due = _counts(rough)
        # If the true set is listed beside the first one, the first is no claim.
        fair = sum(len(r["said"]) if r["listed"] else r["true"] for r in rough)
        false = counted(f for r in rough if not r["listed"] for f in _false(r))
        table = (
            Line(
                "rough_values_exact_or_listed", _exact_or_listed, 0.90, beside=_missed
            ),
            Line("rough_values_set_exact", _exact),
        )
        out |= lines(table, rough) | {
            "rough_values_names_true": at_least(share(fair, names), 0.98)
            | {"false": false},
            "rough_values_changes_named": at_least(share(true, due), None),
        }
    return out


def _counts(rows: Rows) -> tuple[int, int, int]:
    """Return how many names there are, how many are true, and how many were due."""
    each = [(len(r["said"]), r["true"], len(r["planted"])) for r in rows]
    return tuple(map(sum, zip(*each, strict=True))) if each else (0, 0, 0)


def _false(row: Mapping) -> list[str]:
    """Names that are none of what changed, nor of a class with it."""
    there = [[p[0], p[1]] for p in row["planted"]]
    return [names[0][0] for names in row["said"] if not any(n in there for n in names)]
