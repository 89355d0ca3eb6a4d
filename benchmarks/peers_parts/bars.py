"""Figures of each program."""

import argparse

import numpy as np

from benchmarks.harness.cases import by_group, crash_figures
from benchmarks.harness.figures import NO_BAR, Figures, figure
from benchmarks.harness.rates import Rows, at_least, share
from benchmarks.hidden.score import NOTHING, UNKNOWN
from benchmarks.peers_parts.judge import LEVELS


def all_figures(rows: Rows, args: argparse.Namespace | None = None) -> Figures:
    out: Figures = {}
    for program, good in by_group(row for row in rows if "kind" in row).items():
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


def _of(rows: Rows, kind: str) -> Rows:
    return [row for row in rows if row["kind"] == kind]


def _counts(rows: Rows, key: str) -> tuple[int, int]:
    known = [row[key] for row in rows if row[key] is not None]
    return sum(known), len(known)


def _median(rows: Rows, key: str) -> tuple[float | None, int]:
    values = np.concatenate([np.atleast_1d(row[key]) for row in rows] or [[]])
    values = values.astype(float)[~np.isnan(values.astype(float))]
    return (float(np.median(values)) if len(values) else None), len(values)


def _rate(rows: Rows, key: str) -> dict:
    hits, n = _counts(rows, key)
    return at_least(share(hits, n) if n else figure(None, None, 0), None)
