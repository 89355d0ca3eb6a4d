"""Figures and bars of the rows of all groups."""

import argparse
from collections.abc import Mapping
from operator import itemgetter

import numpy as np

from benchmarks.check_parts.arms import MEASURED
from benchmarks.check_parts.file_flaws import FLAWED, SCALED
from benchmarks.harness.cases import by_group, crash_figures
from benchmarks.harness.figures import NO_BAR, NO_LOGS, Figures, figure, missing, undecided
from benchmarks.harness.rates import Line, Rows, counted, lines, per

# What is true of a log is no false fault.
TRUE_OF = {
    # In each run speeds 1, 3, 4, 6, 7 are proportional, and 2 and 5 are.
    # The tensor of its last link is a placeholder, as is that of kr300.
    "lwr4": ("lockstep", "robot_file"),
    "kr300": ("robot_file",),
    # The inertias of its links 1 and 5 break the triangle inequality.
    "gen3": ("too_short", "no_reversal", "robot_file"),
}
# What an arm has by its effect, the check may say too, if not with certainty.
SHOWS_AS = {"saturation": ("saturated",)}


def all_figures(rows: Rows, args: argparse.Namespace) -> Figures:
    of = by_group(row for row in rows if "error" not in row)
    faults, sound = of["faults"], of["clean"] + of["effects"]
    mended = [{"kind": r["kind"], "exact": e} for r in faults for e in r["exact"]]
    own = [row["seconds"] for row in faults]
    value = float(np.median(own)) if own else None
    every = sound + of["large_effects"]
    certain = [r for r in every if any(said[2] for said in r["said"])]
    which = [[r["host"], r["seed"], r["said"]] for r in certain]
    files = of["files"]
    blamed = {
        name: [r for r in files if r["effect"] == name and _blames_log(r)]
        for name in (FLAWED, SCALED)
    }
    out = {
        **lines(_OF_FAULTS, faults),
        **lines([_EXACT], mended),
        **lines([_FALSE], sound),
        "false_certain": figure(len(certain), 0, len(every), which=which),
        **lines(_OF_EXPLAINED, of["explained"]),
        **lines(_OF_FILES, files),
        **{
            f"log_blamed_for_{name.replace(' ', '_')}": figure(
                len(rows),
                0,
                sum(row["effect"] == name for row in files),
                which=counted([kind for r in rows for kind, *_ in r["said"]]),
            )
            for name, rows in blamed.items()
        },
        "seconds": figure(value, None, len(own), why=NO_BAR),
        **crash_figures(rows),
    }
    if not out["faults_found_measured"]["n"]:
        out["faults_found_measured"] = missing(None, NO_LOGS)
    return out if args.whole else undecided(out)


def false_of(row: Mapping) -> list:
    true = (*TRUE_OF.get(row["host"], ()), *SHOWS_AS.get(row["effect"], ()))
    return [said for said in row["said"] if said[2] or said[0] not in true]


def _blames_log(row: Mapping) -> bool:
    """Whether a certain fault is told that is none of the robot file."""
    return any(sure and kind != "robot_file" for kind, _, sure in row["said"])


_hit, _is_exact = itemgetter("hit"), itemgetter("exact")


def _is_ambiguous(row: Mapping) -> bool:
    """Whether a balancer or a drive explains a log as well as a fault."""
    return row["kind"] in ("balanced", "gain")


def _is_far(row: Mapping) -> bool:
    """Whether masses are off by more than a rough file or a load may be."""
    return not 0.5 <= row["factor"] <= 2


def _is_measured(row: Mapping) -> bool:
    return row["host"] in MEASURED


def _list_faults(sound: Rows) -> dict:
    told = [
        f"{kind}{' (certain)' if certain else ''} on {row['host']}"
        for row in sound
        for kind, _, certain in false_of(row)
    ]
    return {"which": counted(told)}


_OF_FAULTS = (
    Line("faults_found", _hit, 0.95, beside=per(_hit, "kind")),
    Line("faults_found_simulated", _hit, of=lambda r: not _is_measured(r)),
    Line("faults_found_measured", _hit, of=_is_measured),
)
_OF_EXPLAINED = (
    Line("zeros_named", _hit, 0.95, of=lambda r: r["kind"] == "zero"),
    Line("gains_named", _hit, 0.80, of=lambda r: r["kind"] == "gain"),
    Line("pairs_named", _hit, 0.90, of=lambda r: r["kind"] == "pair"),
    Line("explained_certain", itemgetter("certain"), 0.0, of=_is_ambiguous, most=True),
)
_OF_FILES = (
    Line("file_flaws_named", _hit, 0.90, of=lambda r: r["effect"] == FLAWED),
    Line("masses_named", _hit, 0.90, of=lambda r: r["effect"] == SCALED and _is_far(r)),
)
_EXACT = Line("repairs_exact", _is_exact, 0.90, beside=per(_is_exact, "kind"))
_FALSE = Line("false_faults", lambda r: bool(false_of(r)), 0.02, most=True, beside=_list_faults)
