"""Figures of each program, and the table of all."""

from collections.abc import Mapping

import numpy as np

from benchmarks.harness.cases import crash_figures
from benchmarks.harness.figures import NO_BAR, Figures, figure
from benchmarks.harness.rates import Rows, at_least, share, wilson
from benchmarks.hidden.score import NOTHING, PAIR, SINGLE, UNKNOWN
from benchmarks.peers_parts.judge import LEVELS

TITLES = {"ours": "modelgap", "squares": "least squares", "sparse": "sparse selection"}
KINDS = {
    SINGLE: "one effect",
    PAIR: "two effects",
    NOTHING: "nothing",
    UNKNOWN: "no name",
    "all": "all",
}
_RATES = {
    "exact_name": "exact set, by name or a stated equivalent",
    "exact_class": "exact set, by class",
    "named": "named",
    "flagged": "unknown stated",
    "joint": "on a right joint",
}
_RATIOS = {
    "held_out": "held-out error over oracle",
    "edits": "edit error over oracle",
}


def all_figures(rows: Mapping[str, Rows]) -> Figures:
    out: Figures = {}
    for program, of_program in rows.items():
        good = [row for row in of_program if "kind" in row]
        for level in LEVELS:
            out[f"{program}_exact_{level}"] = _rate(good, f"exact_{level}")
        out[f"{program}_named_on_nothing"] = _rate(_of(good, NOTHING), "named")
        out[f"{program}_unknown_flagged"] = _rate(_of(good, UNKNOWN), "flagged")
        out[f"{program}_joint"] = _rate(good, "joint")
        for key, name in (
            ("held_out", "held_out_over_oracle"),
            ("edits", "edit_over_oracle"),
            ("seconds", "seconds"),
        ):
            value, n = _median(good, key)
            out[f"{program}_{name}"] = figure(value, None, n, why=NO_BAR)
    return out | crash_figures(rows)


def table(rows: Mapping[str, Rows]) -> dict:
    """Return the table of programs by kind of case: title and rows of texts."""
    lines = [["program", "hidden", *_RATES.values(), *_RATIOS.values()]]
    for program, of_program in rows.items():
        good = [row for row in of_program if "kind" in row]
        for kind, name in KINDS.items():
            if some := _of(good, kind):
                ratios = [_median(some, key) for key in _RATIOS]
                shown = [f"{value:.3g} ({n})" if n else "–" for value, n in ratios]
                cells = [_cell(some, key) for key in _RATES]
                lines.append([TITLES[program], name, *cells, *shown])
    return {"title": "By program and kind of case", "rows": lines}


def _of(rows: Rows, kind: str) -> Rows:
    return [row for row in rows if kind in ("all", row["kind"])]


def _counts(rows: Rows, key: str) -> tuple[int, int]:
    known = [row[key] for row in rows if row[key] is not None]
    return sum(known), len(known)


def _median(rows: Rows, key: str) -> tuple[float | None, int]:
    values = np.concatenate([np.atleast_1d(row[key]) for row in rows] or [[]])
    values = values.astype(float)[~np.isnan(values.astype(float))]
    return (float(np.median(values)) if len(values) else None), len(values)


def _cell(rows: Rows, key: str) -> str:
    hits, n = _counts(rows, key)
    low, high = (round(100 * x) for x in wilson(hits, n))
    return f"{hits} of {n} ({low} to {high} %)" if n else "–"


def _rate(rows: Rows, key: str) -> dict:
    hits, n = _counts(rows, key)
    return at_least(share(hits, n) if n else figure(None, None, 0), None)
