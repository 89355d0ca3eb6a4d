"""What must be reached, as figures of the rows of all groups.

A row is one case by one method (`ask.run`). A case that ended in an error or was
refused said nothing, and counts as such.
"""

from collections.abc import Mapping, Sequence
from functools import partial
from statistics import median

from scipy.stats import binomtest

from benchmarks.changes_parts import case, peer
from benchmarks.changes_parts.ask import PEER, PRODUCT, joints_of
from benchmarks.changes_parts.case import SIZES
from benchmarks.changes_parts.real import UR10E
from benchmarks.harness.cases import crash_figures
from benchmarks.harness.figures import NO_BAR, Figures, figure, missing, undecided
from benchmarks.harness.rates import (
    Line,
    Rows,
    between,
    counted,
    lines,
    per,
    within_two_deviations,
)

_RIGHT = {0.10: 0.95, 0.05: 0.85, 0.025: 0.50}
_RIGHT_UR10E = {0.10: 0.90, 0.05: 0.80}
_NOTHING_ELSE = 0.90
_WITHIN = (0.90, 0.99)
_LOAD_ERROR, _LOAD = 0.05, (2.7, 3.1)  # share; kg
_LOADS = ("load_feb19", "load_feb12_feb19")  # in the order of `real.load_epochs`
_SECONDS = {"six": 5.0, "seven": 8.0}
_DRIFTED = 0.03  # from which a factor of friction ought to be told


def all_figures(rows: Sequence[Mapping], deciding: bool) -> Figures:
    ours, theirs = (_by_group(rows, method) for method in (PRODUCT, PEER))
    figures: Figures = {}
    for group, own in ours.items():
        figures |= lines(_TABLES.get(group, ()), own, "arm")
        figures |= _MORE[group](own) if group in _MORE else {}
    change, real = (ours.get(g, ()) for g in (case.CHANGE, case.REAL_CHANGE))
    figures |= _load_error([*change, *real])
    figures |= _seconds([*ours.get(case.UNCHANGED, ()), *change])
    figures |= _of_peer(theirs)
    figures |= _against(ours, theirs)
    figures |= crash_figures({"all": rows})
    return figures if deciding else undecided(figures)


def absent(arms: int, of: int, why: str) -> dict:
    """Return how many measured arms have no logs on this machine."""
    return figure(arms, None, of, why=why if arms else NO_BAR)


def token(size: float) -> str:
    """Return a size as names of figures have it, in per cent: 2.5 % is 2_5."""
    return f"{100 * size:g}".replace(".", "_")


def of_size(rows: Rows, size: float) -> Rows:
    return [r for r in rows if abs(r["target"] - size) < 1e-9]


def _by_group(rows: Sequence[Mapping], method: str) -> dict[str, list[Mapping]]:
    out: dict[str, list[Mapping]] = {}
    for row in rows:
        if row["method"] == method:
            out.setdefault(row["group"], []).append(row)
    return out


def _names(row: Mapping) -> bool:
    return bool(row["names"])


def _right(row: Mapping) -> bool:
    return bool(row["right_first"])


def _flagged_right(row: Mapping) -> bool:
    return row["flagged_right"]


def _is_ur10e(row: Mapping) -> bool:
    return row["arm"] == UR10E


def _is_other(row: Mapping) -> bool:
    return row["arm"] != UR10E


def _which(rows: Rows) -> dict:
    return {"names": counted(name for r in rows for name, _ in r["names"])}


def _extra(rows: Rows) -> dict:
    return {"names": counted(e for r in rows for e in r["extra"])}


def _drifted(row: Mapping) -> bool:
    factor = row.get("true_factor")
    return factor is not None and abs(factor - 1) >= _DRIFTED


def _way(row: Mapping) -> bool:
    said = row["told_factor"]
    return said is not None and (said[0] - 1) * (row["true_factor"] - 1) > 0


def _near(row: Mapping) -> bool:
    factor, std = row["told_factor"]
    return abs(factor - row["true_factor"]) <= 2 * std


def _told(row: Mapping) -> bool:
    return row.get("true_factor") is not None and row["told_factor"] is not None


_PER_EFFECT = per(_right)
_TABLES: Mapping[str, tuple[Line, ...]] = {
    case.UNCHANGED: (
        Line("unchanged_named", _names, 0.02, most=True, beside=_which),
        Line("unchanged_flagged", lambda r: bool(r["flagged"])),
    ),
    case.DRIFT: (
        Line("drift_named", _names, 0.02, most=True, beside=_which),
        Line("drift_told", _way, of=_drifted),
        Line("drift_within_two_deviations", _near, of=_told),
    ),
    case.UNNAMED: (
        Line("unnamed_flagged", _flagged_right, 0.90, beside=per(_flagged_right)),
        Line("unnamed_named", _names, 0.02, most=True, beside=_which),
    ),
    case.EDGE: (
        Line(
            "edge",
            _right,
            0.65,
            lambda r: not r.get("unsized"),
            low=0.35,
            beside=_PER_EFFECT,
        ),
        Line("edge_no_size_said", lambda r: r.get("unsized"), count=True),
    ),
    case.PAIRS: (Line("pairs_both", lambda r: r["found"] == 2),),
    case.REAL_UNCHANGED: (
        Line("measured_ur10e_named", _names, of=_is_ur10e, beside=_which),
        Line("measured_others_named", _names, of=_is_other, beside=_which),
        Line("measured_refused", lambda r: "refused" in r, count=True),
    ),
}


def _change(rows: Rows) -> Figures:
    out: Figures = {}
    for size, bar in _RIGHT.items():
        out |= _first(f"change_{token(size)}", of_size(rows, size), bar)
    return out | {"change_within_two_deviations": _within(rows)}


def _real_change(rows: Rows) -> Figures:
    ur10e = [r for r in rows if _is_ur10e(r)]
    out = {"measured_ur10e_within_two_deviations": _within(ur10e)}
    for size, bar in _RIGHT_UR10E.items():
        name = token(size)
        out |= _first(f"measured_ur10e_{name}", of_size(ur10e, size), bar)
        line = Line(f"measured_others_{name}_right_first", _right, beside=_PER_EFFECT)
        others = [r for r in of_size(rows, size) if _is_other(r)]
        out |= lines([line] if others else [], others, "arm")
    return out


def _load(rows: Rows) -> Figures:
    out: Figures = {}
    for row in rows:
        name = _LOADS[row["index"]]
        known = row.get("value") is not None and row.get("key") == "mass"
        out[name] = between(figure(row["value"] if known else None, None, 1), *_LOAD)
        if not known:
            # A load that nobody names is missed, not unmeasured.
            out[name] |= {"ok": False, "why": "no load named"}
    return out


def _load_error(rows: Rows) -> Figures:
    loads = [r for r in of_size(rows, SIZES[0]) if r["effect"] == "payload"]
    if not rows:
        return {}
    if not loads:
        return {"load_mass_error": missing(_LOAD_ERROR, "no load among these cases")}

    def miss(row: Mapping) -> float:
        # Nothing said of a load is all of it missed.
        known = row.get("value") is not None
        return abs(row["value"] / row["true"] - 1) if known else 1.0

    errors = sorted(miss(row) for row in loads)
    entry = figure(median(errors), _LOAD_ERROR, len(errors), errors=errors)
    return {"load_mass_error": entry}


def _seconds(rows: Rows) -> Figures:
    out: Figures = {}
    for kind, bar in _SECONDS.items():
        of = 7 if kind == "seven" else 6
        own = [r["seconds"] for r in rows if r["seconds"] and joints_of(r["arm"]) == of]
        if own:
            most = round(max(own), 1)
            entry = figure(round(median(own), 2), bar, len(own), most=most)
            out[f"seconds_{kind}"] = entry
    return out


def _of_peer(theirs: Mapping[str, Rows]) -> Figures:
    """Return what the peer reaches: of all cases, and of those that it can name."""
    out: Figures = {}
    for group in (case.UNCHANGED, case.DRIFT, case.REAL_UNCHANGED, case.UNNAMED):
        line = Line(f"peer_{group}_named", _names, beside=_which)
        out |= lines([line] if group in theirs else [], theirs.get(group, ()), "arm")
    for name, rows in _sized(theirs).items():
        table = [
            Line(f"peer_{name}_right_first", _right),
            Line(
                f"peer_{name}_own_right_first",
                _right,
                of=lambda r: r["effect"] in peer.EFFECTS,
            ),
        ]
        out |= lines(table, rows, "arm")
    for row in theirs.get(case.LOAD, ()):
        name = f"peer_{_LOADS[row['index']]}"
        out[name] = figure(row.get("value"), None, 1, why=NO_BAR)
    return out


def _against(ours: Mapping[str, Rows], theirs: Mapping[str, Rows]) -> Figures:
    """Return by how much this program is above the peer on the very same cases."""
    out: Figures = {}
    others = _sized(theirs)
    for name, rows in _sized(ours).items():
        known = {_key(r): r for r in others.get(name, ())}
        pairs = [(_right(r), _right(known[_key(r)])) for r in rows if _key(r) in known]
        if not pairs:
            continue
        mine = sum(a and not b for a, b in pairs)
        its = sum(b and not a for a, b in pairs)
        # McNemar, exact: of those where one alone is right, as often as a coin.
        p = binomtest(mine, mine + its).pvalue if mine + its else 1.0
        value = (mine - its) / len(pairs)
        out[f"{name}_over_peer"] = figure(
            value,
            0.0,
            len(pairs),
            ok=bool(value >= 0),
            at_least=True,
            alone=[mine, its],
            p=round(float(p), 4),
        )
    return out


def _sized(groups: Mapping[str, Rows]) -> dict[str, Rows]:
    out = {f"change_{token(s)}": of_size(groups.get(case.CHANGE, ()), s) for s in SIZES}
    real = [r for r in groups.get(case.REAL_CHANGE, ()) if r["arm"] == UR10E]
    for size in _RIGHT_UR10E:
        out[f"measured_ur10e_{token(size)}"] = of_size(real, size)
    return {name: rows for name, rows in out.items() if rows}


def _key(row: Mapping) -> tuple:
    return tuple(row[k] for k in ("group", "seed", "index", "target", "arm"))


def _first(name: str, rows: Rows, bar: float | None) -> Figures:
    """Return how often a change is right first, and alone where anything is named."""
    table = (
        Line(f"{name}_right_first", _right, bar, beside=_PER_EFFECT),
        Line(
            f"{name}_nothing_else",
            lambda r: not r["extra"],
            bar and _NOTHING_ELSE,
            _names,
            beside=_extra,
        ),
    )
    return lines(table, rows, "arm") if rows else {}


def _within(rows: Rows) -> dict:
    return within_two_deviations(rows, "arm", *_WITHIN)


_MORE = {
    case.CHANGE: _change,
    case.PAIRS: partial(_first, "pairs", bar=None),
    case.REAL_CHANGE: _real_change,
    case.LOAD: _load,
}
