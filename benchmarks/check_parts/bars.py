"""What must be reached, as figures of the rows of all groups."""

from collections import defaultdict
from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.check_parts.arms import MEASURED
from benchmarks.harness.figures import (
    FEW,
    NO_BAR,
    NO_LOGS,
    Figures,
    figure,
    missing,
    undecided,
)
from benchmarks.harness.rates import Rows, at_least, at_most, counts, rate

FOUND, EXACT, FALSE, CERTAIN, UNNAMED = 0.95, 0.90, 0.02, 0, 1.0

# What is true of a log is no false fault.
TRUE_OF = {
    "ur10": ("filtered",),
    # In each run speeds 1, 3, 4, 6, 7 are proportional, and 2 and 5 are.
    "lwr4": ("filtered", "lockstep"),
    # The inertia of its link 5 breaks the triangle inequality.
    "gen3": ("too_short", "no_reversal", "robot_file"),
}
# What an arm has by its effect, the check may say too, if not with certainty.
SHOWS_AS = {
    "torque_gain": ("torque_scale",),
    "delay": ("delay",),
    "saturation": ("saturated",),
}


def figures(rows: Rows, absent: Sequence[str], deciding: bool) -> Figures:
    by_group = defaultdict(list)
    for row in rows:
        by_group["crashes" if "error" in row else row["group"]].append(row)
    every, sound = by_group["faults"], by_group["clean"] + by_group["effects"]
    faults = [row for row in every if not row.get("void")]
    drawn = [r for r in faults if r["host"] not in MEASURED]
    out = {
        "faults_found": at_least(rate(faults, _hit), FOUND) | _tables(faults),
        "not_applicable": _void(every),
        "faults_found_simulated": at_least(rate(drawn, _hit), None),
        "faults_found_measured": _on_measured(faults, absent),
        "repairs_exact": _exact(faults),
        "false_faults": at_most(rate(sound, lambda r: bool(false_of(r))), FALSE)
        | {"which": _which(sound)},
        "false_certain": _certain(sound),
        "certain_unnamed": at_least(rate(by_group["trusted"], _nothing_said), UNNAMED),
        "seconds": _seconds(faults),
        "crashes": figure(len(by_group["crashes"]), 0, len(rows)),
    }
    return out if deciding else undecided(out)


def false_of(row: Mapping) -> list:
    """Return the faults that a check told of clean logs."""
    true = (*TRUE_OF.get(row["host"], ()), *SHOWS_AS.get(row["effect"], ()))
    return [said for said in row["said"] if said[2] or said[0] not in true]


def _hit(row: Mapping) -> bool:
    return row["hit"]


def _nothing_said(row: Mapping) -> bool:
    return row["answer"] in ("unknown", "refused") and not row["named"]


def _void(every: Rows) -> dict:
    """Count faults that leave no trace in their log (`check_parts.traces`)."""
    rows = [row for row in every if row.get("void")]
    entry = figure(len(rows), None, len(every), why="for information, no bar")
    which = [[r["host"], r["seed"], r["kind"], r["size"], r["joints"]] for r in rows]
    found = sum(bool(row["hit"]) for row in rows)
    return entry | {"found_all_the_same": found, "which": which}


def _on_measured(faults: Rows, absent: Sequence[str]) -> dict:
    rows = [r for r in faults if r["host"] in MEASURED]
    if not rows:
        return missing(None, NO_LOGS if absent else FEW)
    return at_least(rate(rows, _hit), None)


def _exact(faults: Rows) -> dict:
    lines = [{"kind": r["kind"], "exact": e} for r in faults for e in r["exact"]]
    entry = at_least(rate(lines, lambda line: line["exact"]), EXACT)
    return entry | {"per_kind": counts(lines, lambda line: line["exact"], "kind")}


def _certain(sound: Rows) -> dict:
    rows = [r for r in sound if any(said[2] for said in r["said"])]
    entry = figure(len(rows), CERTAIN, len(sound))
    return entry | {"which": [[r["host"], r["seed"], r["said"]] for r in rows]}


def _seconds(faults: Rows) -> dict:
    own = [row["seconds"] for row in faults]
    value = float(np.median(own)) if own else None
    return figure(value, None, len(own), why=NO_BAR)


def _tables(faults: Rows) -> dict:
    return {f"per_{key}": counts(faults, _hit, key) for key in ("kind", "host")}


def _which(sound: Rows) -> dict:
    each: dict[str, int] = defaultdict(int)
    for row in sound:
        for kind, _, certain in false_of(row):
            each[f"{kind}{' (certain)' if certain else ''} on {row['host']}"] += 1
    return dict(sorted(each.items()))
