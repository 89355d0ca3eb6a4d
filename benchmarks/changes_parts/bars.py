"""What must be reached, as figures of the rows of all groups.

A row is one case by one method (`ask.run`). A case that ended in an error or was
refused said nothing, and counts as such.
"""

from collections.abc import Callable, Mapping, Sequence
from statistics import median

from scipy.stats import binomtest

from benchmarks.changes_parts import peer
from benchmarks.changes_parts.ask import PEER, PRODUCT, joints_of
from benchmarks.changes_parts.case import (
    CHANGE,
    DRIFT,
    EDGE,
    LOAD,
    PAIRS,
    REAL_CHANGE,
    REAL_UNCHANGED,
    SIZES,
    UNCHANGED,
    UNNAMED,
)
from benchmarks.changes_parts.real import UR10E
from benchmarks.harness.cases import crash_figures
from benchmarks.harness.figures import NO_BAR, Figures, figure, missing, undecided
from benchmarks.harness.rates import (
    Hit,
    Rows,
    at_least,
    at_most,
    between,
    counted,
    counts,
    rate,
    within_two_deviations,
)

_RIGHT = {0.10: 0.95, 0.05: 0.85, 0.025: 0.50}
_RIGHT_UR10E = {0.10: 0.90, 0.05: 0.80}
_NOTHING_ELSE = 0.90
_WITHIN = (0.90, 0.99)
_LOAD_ERROR, _LOAD = 0.05, (2.7, 3.1)  # share; kg
_LOADS = ("load_feb19", "load_feb12_feb19")  # in the order of `real.load_epochs`
_EDGE = (0.35, 0.65)
_SECONDS = {"six": 5.0, "seven": 8.0}
_DRIFTED = 0.03  # from which a factor of friction ought to be told


def all_figures(rows: Sequence[Mapping], deciding: bool) -> Figures:
    ours, theirs = (_by_group(rows, method) for method in (PRODUCT, PEER))
    figures: Figures = {}
    for group, make in _MAKERS.items():
        if group in ours:
            figures |= make(ours[group])
    figures |= _load_error([*ours.get(CHANGE, ()), *ours.get(REAL_CHANGE, ())])
    figures |= _seconds([*ours.get(UNCHANGED, ()), *ours.get(CHANGE, ())])
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


def _rate(rows: Rows, hit: Hit) -> dict:
    return rate(rows, hit, "arm") | {"hits": sum(bool(hit(r)) for r in rows)}


def _least(rows: Rows, hit: Hit, bar: float | None) -> dict:
    return at_least(_rate(rows, hit), bar)


def _most(rows: Rows, hit: Hit, bar: float | None) -> dict:
    return at_most(_rate(rows, hit), bar)


def _per_effect(rows: Rows, hit: Hit | None = None) -> dict:
    return {"per_effect": counts(rows, hit or _right, "effect")}


def _which(rows: Rows) -> dict:
    return {"names": counted(name for r in rows for name, _ in r["names"])}


def _unchanged(rows: Rows) -> Figures:
    return {
        "unchanged_named": _most(rows, _names, 0.02) | _which(rows),
        "unchanged_flagged": _most(rows, lambda r: bool(r["flagged"]), None),
    }


def _drift(rows: Rows) -> Figures:
    known = [r for r in rows if r.get("true_factor") is not None]
    large = [r for r in known if abs(r["true_factor"] - 1) >= _DRIFTED]

    def way(row: Mapping) -> bool:
        said = row["told_factor"]
        return said is not None and (said[0] - 1) * (row["true_factor"] - 1) > 0

    def near(row: Mapping) -> bool:
        factor, std = row["told_factor"]
        return abs(factor - row["true_factor"]) <= 2 * std

    told = [r for r in known if r["told_factor"] is not None]
    return {
        "drift_named": _most(rows, _names, 0.02) | _which(rows),
        "drift_told": _least(large, way, None),
        "drift_within_two_deviations": _least(told, near, None),
    }


def _change(rows: Rows) -> Figures:
    out: Figures = {}
    for size in SIZES:
        some = of_size(rows, size)
        name = f"change_{token(size)}"
        out |= _first(name, some, _RIGHT[size])
    return out | {"change_within_two_deviations": _within(rows)}


def _pairs(rows: Rows) -> Figures:
    both = _least(rows, lambda r: r["found"] == 2, None)
    return _first("pairs", rows, None) | {"pairs_both": both}


def _unnamed(rows: Rows) -> Figures:
    flagged = _least(rows, lambda r: r["flagged_right"], 0.90)
    return {
        "unnamed_flagged": flagged | _per_effect(rows, lambda r: r["flagged_right"]),
        "unnamed_named": _most(rows, _names, 0.02) | _which(rows),
    }


def _edge(rows: Rows) -> Figures:
    sized = [r for r in rows if not r.get("unsized")]
    entry = _rate(sized, _right) | _per_effect(sized)
    many = figure(len(rows) - len(sized), None, len(rows), why=NO_BAR)
    return {"edge": between(entry, *_EDGE), "edge_no_size_said": many}


def _real_unchanged(rows: Rows) -> Figures:
    ur10e = [r for r in rows if r["arm"] == UR10E]
    others = [r for r in rows if r["arm"] != UR10E]
    out = {
        "measured_ur10e_named": _most(ur10e, _names, None) | _which(ur10e),
        "measured_others_named": _most(others, _names, None) | _which(others),
    }
    refused = sum("refused" in r for r in rows)
    return out | {"measured_refused": figure(refused, None, len(rows), why=NO_BAR)}


def _real_change(rows: Rows) -> Figures:
    out: Figures = {}
    for size, bar in _RIGHT_UR10E.items():
        ur10e = [r for r in of_size(rows, size) if r["arm"] == UR10E]
        others = [r for r in of_size(rows, size) if r["arm"] != UR10E]
        out |= _first(f"measured_ur10e_{token(size)}", ur10e, bar)
        if others:
            entry = _least(others, _right, None) | _per_effect(others)
            out[f"measured_others_{token(size)}_right_first"] = entry
    ur10e = [r for r in rows if r["arm"] == UR10E]
    return out | {"measured_ur10e_within_two_deviations": _within(ur10e)}


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
    for group in (UNCHANGED, DRIFT, REAL_UNCHANGED, UNNAMED):
        if group in theirs:
            out[f"peer_{group}_named"] = _most(theirs[group], _names, None) | _which(
                theirs[group]
            )
    for name, rows in _sized(theirs).items():
        own = [r for r in rows if r["effect"] in peer.EFFECTS]
        out[f"peer_{name}_right_first"] = _least(rows, _right, None)
        out[f"peer_{name}_own_right_first"] = _least(own, _right, None)
    for row in theirs.get(LOAD, ()):
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
    out = {f"change_{token(s)}": of_size(groups.get(CHANGE, ()), s) for s in SIZES}
    real = [r for r in groups.get(REAL_CHANGE, ()) if r["arm"] == UR10E]
    for size in _RIGHT_UR10E:
        out[f"measured_ur10e_{token(size)}"] = of_size(real, size)
    return {name: rows for name, rows in out.items() if rows}


def _key(row: Mapping) -> tuple:
    return tuple(row[k] for k in ("group", "seed", "index", "target", "arm"))


def _first(name: str, rows: Rows, bar: float | None) -> Figures:
    """Return how often a change is right first, and alone where anything is named."""
    if not rows:
        return {}
    right = _least(rows, _right, bar) | _per_effect(rows)
    named = [r for r in rows if r["names"]]
    alone = _least(named, lambda r: not r["extra"], bar and _NOTHING_ELSE)
    beside = {"names": counted(e for r in named for e in r["extra"])}
    return {f"{name}_right_first": right, f"{name}_nothing_else": alone | beside}


def _within(rows: Rows) -> dict:
    entry = within_two_deviations(rows, "arm", *_WITHIN)
    return entry | {
        "hits": sum(abs(r["z"]) <= 2 for r in rows if r.get("z") is not None)
    }


def _names(row: Mapping) -> bool:
    return bool(row["names"])


def _right(row: Mapping) -> bool:
    return bool(row["right_first"])


_MAKERS: Mapping[str, Callable[[Rows], Figures]] = {
    UNCHANGED: _unchanged,
    DRIFT: _drift,
    CHANGE: _change,
    PAIRS: _pairs,
    UNNAMED: _unnamed,
    EDGE: _edge,
    REAL_UNCHANGED: _real_unchanged,
    REAL_CHANGE: _real_change,
    LOAD: _load,
}
