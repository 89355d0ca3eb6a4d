"""Figures and bars of the rows of all groups.

A row is one case by one method (`answers.run`). A refused case has no name.
"""

import argparse
from collections.abc import Callable, Mapping
from operator import itemgetter
from statistics import median

from scipy.stats import binomtest

from benchmarks.changes_parts import draw
from benchmarks.changes_parts.answers import PEER, PROGRAM
from benchmarks.harness.cases import by_group, crash_figures
from benchmarks.harness.figures import Figures, figure, missing, undecided
from benchmarks.harness.rates import Line, Rows, between, lines, per, within_two_deviations
from benchmarks.measured_parts.arms import UR10E

_RIGHT = {0.10: 0.95, 0.05: 0.85, 0.025: 0.50}
_WITHIN = 0.90, 0.99
_LOAD_ERROR, _LOAD = 0.05, (2.7, 3.1)  # share; kg
_LOADS = ("load_feb19", "load_feb12_feb19")  # in the order of `real.epochs`
_SECONDS = {6: ("seconds_six", 5.0), 7: ("seconds_seven", 8.0)}
_DRIFTED = 0.03  # a smaller change of friction need not be found


def all_figures(rows: Rows, args: argparse.Namespace) -> Figures:
    good = [row for row in rows if "error" not in row]
    ours, peers = (
        by_group(row for row in good if row["method"] == method) for method in (PROGRAM, PEER)
    )
    figures: Figures = {}
    for group, of_group in ours.items():
        figures |= lines(_TABLES.get(group, ()), of_group)
        figures |= _MORE[group](of_group) if group in _MORE else {}
    figures |= _load_error(ours[draw.CHANGE])
    figures |= _seconds([*ours[draw.UNCHANGED], *ours[draw.CHANGE]])
    for group in (draw.UNCHANGED, draw.DRIFT, draw.UNNAMED, draw.REAL_UNCHANGED):
        if peers[group]:
            figures |= lines([Line(f"peer_{group}_named", _names)], peers[group])
    figures |= _against_peer(ours[draw.CHANGE], peers[draw.CHANGE])
    figures |= crash_figures(rows)
    return figures if args.deciding else undecided(figures)


def token(size: float) -> str:
    """Return a size in names of figures, in per cent: 2.5 % is 2_5."""
    return f"{100 * size:g}".replace(".", "_")


_names, _right = itemgetter("names"), itemgetter("right_first")


def _same_direction(row: Mapping) -> bool:
    factor = row["factor"]
    return factor is not None and (factor[0] - 1) * (row["true_factor"] - 1) > 0


def _near(row: Mapping) -> bool:
    return abs(row["factor"][0] - row["true_factor"]) <= 2 * row["factor"][1]


_TABLES: Mapping[str, tuple[Line, ...]] = {
    draw.UNCHANGED: (
        Line("unchanged_named", _names, 0.02, most=True),
        Line("unchanged_flagged", itemgetter("flagged")),
    ),
    draw.DRIFT: (
        Line("drift_named", _names, 0.02, most=True),
        Line("drift_told", _same_direction, of=lambda r: abs(r["true_factor"] - 1) >= _DRIFTED),
        Line("drift_within_two_deviations", _near, of=lambda r: r["factor"]),
    ),
    draw.UNNAMED: (
        Line("unnamed_flagged", itemgetter("flagged_right"), 0.90),
        Line("unnamed_named", _names, 0.02, most=True),
    ),
    draw.REAL_UNCHANGED: (
        Line("measured_ur10e_named", _names, of=lambda r: r["arm"] == UR10E),
        Line("measured_others_named", _names, of=lambda r: r["arm"] != UR10E),
        Line("measured_refused", itemgetter("refused")),
    ),
}


def _change(rows: Rows) -> Figures:
    out: Figures = {}
    for size, bar in _RIGHT.items():
        name = f"change_{token(size)}"
        table = (
            Line(f"{name}_right_first", _right, bar, beside=per(_right)),
            Line(f"{name}_nothing_else", lambda r: not r["extra"], 0.90, _names),
        )
        out |= lines(table, _of_size(rows, size))
    sized = [row for row in rows if row.get("z") is not None]
    within = within_two_deviations(sized, *_WITHIN)
    return out | {"change_within_two_deviations": within}


def _of_size(rows: Rows, size: float) -> Rows:
    return [r for r in rows if r["target"] == size]


def _load(rows: Rows) -> Figures:
    out: Figures = {}
    for row in rows:
        value, name = row["value"], _LOADS[row["index"]]
        out[name] = between(figure(value, None, 1), *_LOAD)
        if value is None:
            out[name] |= {"ok": False, "why": "no load named"}
    return out


def _load_error(rows: Rows) -> Figures:
    """Median error of the mass of loads of 10 %; without a name it is 100 %."""
    loads = [r for r in _of_size(rows, 0.10) if r["effect"] == "payload"]
    if not loads:
        why = "no load among these cases"
        return {"load_mass_error": missing(_LOAD_ERROR, why)} if rows else {}
    errors = sorted(1.0 if r["value"] is None else abs(r["value"] / r["true"] - 1) for r in loads)
    entry = figure(median(errors), _LOAD_ERROR, len(errors), errors=errors)
    return {"load_mass_error": entry}


def _seconds(rows: Rows) -> Figures:
    out: Figures = {}
    for dof, (name, bar) in _SECONDS.items():
        times = [r["seconds"] for r in rows if r["dof"] == dof and not r["refused"]]
        if times:
            entry = figure(round(median(times), 2), bar, len(times))
            out[name] = entry | {"most": round(max(times), 1)}
    return out


def _against_peer(ours: Rows, peers: Rows) -> Figures:
    out: Figures = {}
    for size in _RIGHT:
        mine, its = (list(map(_right, _of_size(x, size))) for x in (ours, peers))
        if not mine or len(mine) != len(its):
            continue
        name = token(size)
        line = Line(f"peer_change_{name}_right_first", _right)
        out |= lines([line], _of_size(peers, size))
        wins = sum(a and not b for a, b in zip(mine, its, strict=True))
        losses = sum(b and not a for a, b in zip(mine, its, strict=True))
        # McNemar's exact test on the cases where one method alone is right.
        p = binomtest(wins, wins + losses).pvalue if wins + losses else 1.0
        value = (wins - losses) / len(mine)
        entry = figure(value, 0.0, len(mine), ok=value >= 0, at_least=True)
        out[f"change_{name}_over_peer"] = entry | {"p": round(float(p), 4)}
    return out


_MORE: Mapping[str, Callable[[Rows], Figures]] = {draw.CHANGE: _change, draw.LOAD: _load}
