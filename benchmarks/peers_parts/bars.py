"""Figures of each program, and the tables of all."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from benchmarks.harness.figures import NO_BAR, Figures, figure
from benchmarks.harness.rates import Rows, at_least, share, wilson
from benchmarks.hidden.score import NOTHING, PAIR, SINGLE, UNKNOWN

TITLES = {"ours": "modelgap", "squares": "least squares", "sparse": "sparse selection"}
KINDS = {
    SINGLE: "one effect",
    PAIR: "two effects",
    NOTHING: "nothing",
    UNKNOWN: "no name",
    "all": "all",
}
LEVELS = {
    "name": "Effect and joint by name",
    "equivalent": "The same, or one of the equivalents that it states",
    "class": "By coarse class: body, friction or rotor, the rest",
}
# What is counted at a level, and of what.
_COUNTED = {
    "exact": ("exact", None),
    "precision": ("true", "said"),
    "recall": ("found", "there"),
}
Share = tuple[int, int]  # hits, of how many


def all_figures(rows: Mapping[str, Rows]) -> Figures:
    out: Figures = {}
    for program, own in rows.items():
        good = [row for row in own if "outcome" in row]
        for level in LEVELS:
            for key in _COUNTED:
                out[f"{program}_{key}_{level}"] = _rate(_at(good, level, key))
        none, odd = (_of(good, kind) for kind in (NOTHING, UNKNOWN))
        out[f"{program}_named_on_nothing"] = _rate(_told(none, "named"))
        out[f"{program}_unknown_flagged"] = _rate(_told(odd, "flagged"))
        out[f"{program}_joint"] = _rate(_told(good, "joint"))
        for key, value, n in (
            ("held_out_over_oracle", *_middle(good, _held)),
            ("edit_over_oracle", *_middle(good, _edits)),
            ("seconds", *_middle(good, lambda row: [row["seconds"]])),
        ):
            out[f"{program}_{key}"] = figure(value, None, n, why=NO_BAR)
    crashes = sum("error" in row for own in rows.values() for row in own)
    return out | {"crashes": figure(crashes, 0, sum(map(len, rows.values())))}


def tables(rows: Mapping[str, Rows]) -> list[dict]:
    """Return tables of programs by kind of case: title and rows of texts."""
    out = []
    for level, title in LEVELS.items():
        lines = [["program", "hidden", "exact set", "precision", "recall"]]
        for at, own in _lines(rows):
            lines.append([*at, *(_cell(_at(own, level, key)) for key in _COUNTED)])
        out.append({"title": title, "rows": lines})
    head = ["program", "hidden", "named", "said unknown", "on a right joint"]
    lines = [[*head, "held-out error over oracle", "edit error over oracle"]]
    for at, own in _lines(rows):
        cells = [_cell(_told(own, key)) for key in ("named", "flagged", "joint")]
        ratios = [_middle(own, each) for each in (_held, _edits)]
        shown = (f"{value:.3g} ({n})" if n else "–" for value, n in ratios)
        lines.append([*at, *cells, *shown])
    return [*out, {"title": "What else was said, and predicted", "rows": lines}]


def _lines(rows: Mapping[str, Rows]) -> Iterator[tuple[tuple[str, str], Rows]]:
    for program, every in rows.items():
        good = [row for row in every if "outcome" in row]
        for kind, word in KINDS.items():
            if own := good if kind == "all" else _of(good, kind):
                yield (TITLES[program], word), own


def _of(rows: Rows, kind: str) -> Rows:
    return [row for row in rows if row["kind"] == kind]


def _at(rows: Rows, level: str, key: str) -> Share:
    hits, of = _COUNTED[key]
    levels = [row["levels"][level] for row in rows]
    return sum(at[hits] for at in levels), sum(at[of] if of else 1 for at in levels)


def _told(rows: Rows, key: str) -> Share:
    known = [row[key] for row in rows if row[key] is not None]
    return sum(known), len(known)


def _held(row: Mapping) -> list[float]:
    return [] if row["held_out"] is None else [row["held_out"]]


def _edits(row: Mapping) -> list[float]:
    return [ratio for ratio in row["edits"] if ratio is not None]


def _middle(rows: Rows, each: Callable) -> tuple[float | None, int]:
    values = [value for row in rows for value in each(row)]
    return float(np.median(values)) if values else None, len(values)


def _cell(told: Share) -> str:
    hits, n = told
    low, high = (round(100 * x) for x in wilson(hits, n))
    return f"{hits} of {n} ({low} to {high} %)" if n else "–"


def _rate(told: Share) -> dict:
    return at_least(share(*told) if told[1] else figure(None, None, 0), None)
