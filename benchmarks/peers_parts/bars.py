"""Figures of each program."""

import argparse
from operator import itemgetter

import numpy as np

from benchmarks.harness.cases import by_group, crash_figures
from benchmarks.harness.figures import NO_BAR, Figures, figure
from benchmarks.harness.rates import Line, Rows, lines
from benchmarks.hidden.score import NOTHING, UNKNOWN

_LINES = (
    Line("exact_name", itemgetter("exact_name")),
    Line("exact_class", itemgetter("exact_class")),
    Line("named_on_nothing", itemgetter("named"), of=lambda r: r["kind"] == NOTHING),
    Line("unknown_flagged", itemgetter("flagged"), of=lambda r: r["kind"] == UNKNOWN),
    Line("joint", itemgetter("joint"), of=lambda r: r["joint"] is not None),
)


def all_figures(rows: Rows, args: argparse.Namespace | None = None) -> Figures:
    out: Figures = {}
    for program, good in by_group(row for row in rows if "kind" in row).items():
        own = lines(_LINES, good)
        seconds = float(np.median([row["seconds"] for row in good]))
        own["seconds"] = figure(seconds, None, len(good), why=NO_BAR)
        out |= {f"{program}_{key}": entry for key, entry in own.items()}
    return out | crash_figures(rows)
