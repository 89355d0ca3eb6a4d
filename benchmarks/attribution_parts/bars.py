"""Figures and bars of the rows of all groups."""

import argparse
from collections.abc import Mapping
from operator import itemgetter

from benchmarks.harness.cases import by_group, crash_figures
from benchmarks.harness.figures import Figures, figure, undecided
from benchmarks.harness.rates import Line, Rows, at_least, lines, share


def all_figures(rows: Rows, args: argparse.Namespace) -> Figures:
    groups = by_group(row for row in rows if "outcome" in row)
    figures = _unchanged(groups["unchanged"]) if "unchanged" in groups else {}
    figures |= _changed(groups.get("sets", [])) | crash_figures(rows)
    return figures if args.deciding else undecided(figures)


def _unchanged(rows: Rows) -> Figures:
    entry = figure(sum(bool(r["said"]) for r in rows), 0, len(rows))
    flagged = Line("unchanged_flagged", itemgetter("unexplained"))
    return {"unchanged_named": entry} | lines([flagged], rows)


_exact = itemgetter("exact")


def _exact_or_listed(row: Mapping) -> bool:
    return row["exact"] or row["listed"]


def _changed(rows: Rows) -> Figures:
    """Return figures of arms with changes; those with exact given values apart."""
    out: Figures = {}
    exact, rough = ([r for r in rows if bool(r["off"]) is off] for off in (False, True))
    if exact:
        names, true, due = _counts(exact)
        out |= lines([Line("exact_values_set_exact", _exact, 0.95)], exact) | {
            "exact_values_names_true": at_least(share(true, names), 0.99),
            "exact_values_changes_named": at_least(share(true, due), None),
        }
    if rough:
        names, true, due = _counts(rough)
        # If the true set is listed beside the first one, the first is no claim.
        fair = sum(len(r["said"]) if r["listed"] else r["true"] for r in rough)
        table = (
            Line("rough_values_exact_or_listed", _exact_or_listed, 0.90),
            Line("rough_values_set_exact", _exact),
        )
        out |= lines(table, rough) | {
            "rough_values_names_true": at_least(share(fair, names), 0.98),
            "rough_values_changes_named": at_least(share(true, due), None),
        }
    return out


def _counts(rows: Rows) -> tuple[int, int, int]:
    """Return how many names there are, how many are true, and how many were due."""
    each = [(len(r["said"]), r["true"], len(r["planted"])) for r in rows]
    return tuple(map(sum, zip(*each, strict=True))) if each else (0, 0, 0)
