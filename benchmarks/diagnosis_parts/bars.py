"""What must be reached, as figures of the rows of all groups."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from benchmarks.figures import Figures, figure
from benchmarks.seeded import Rows, crash_figures, group_figures, undecided
from flows.blind.score import WRONG
from flows.blind.sums import both_clear, is_clear, is_right, wilson

_NO_BAR = "for information, no bar of its own"

# Families that detection is pooled over; a new effect is in "other" until it is here.
FAMILIES = {
    "dry friction": (
        "coulomb",
        "coulomb_asymmetry",
        "stribeck",
        "presliding",
        "position_friction",
        "warmup",
    ),
    "viscous friction": (
        "viscous",
        "viscous_asymmetry",
        "quadratic_viscous",
        "power_viscous",
    ),
    "gear": ("load_friction", "coupled_friction", "elasticity", "backlash", "ripple"),
    "inertia": ("rotor_inertia", "link_inertia", "payload"),
    "static": ("offset", "spring", "balancer", "base_tilt", "tool_force"),
    "sensor": (
        "torque_gain",
        "saturation",
        "delay",
        "encoder_offset",
        "encoder_eccentricity",
    ),
}


def case_figures(rows: Mapping[str, Rows], deciding: bool) -> Figures:
    """Return the figures of all groups that were run.

    Args:
        deciding: Whether these are the seeds and the counts that the bars are for.
    """
    makers: Mapping[str, Callable[[Rows], Figures]] = {
        "singles": _singles,
        "detection": _detection,
        "nulls": _nulls,
        "unknown": _unknown,
        "pairs": _pairs,
        "forms": _forms,
    }
    figures = group_figures(rows, makers) | _across(rows) | crash_figures(rows)
    return figures if deciding else undecided(figures)


def _singles(rows: Rows) -> Figures:
    clear = [r for r in rows if is_clear(r)]
    usual = [r for r in rows if r["multiple"] is None]
    return {
        "singles_right": _least(clear, is_right, 0.95) | _by_effect(clear),
        # Their torque is in proportion to no parameter: no multiple can be drawn.
        "singles_of_usual_size_right": _least(usual, is_right, 0.95)
        | _by_effect(usual),
        "singles_joint_right": _least(clear, lambda r: bool(r["joint_right"]), None),
        "singles_too_small_for_three_times": figure(
            len(rows) - len(clear) - len(usual), None, len(rows), why=_NO_BAR
        ),
    }


def _detection(rows: Rows) -> Figures:
    out: Figures = {}
    known = {e: family for family, names in FAMILIES.items() for e in names}
    small = [r for r in rows if r["multiple"] is not None and r["multiple"] <= 1.2]
    for family in (*FAMILIES, "other"):
        own = [r for r in small if known.get(r["effect"], "other") == family]
        if own:
            entry = _rate(own, is_right)
            inside = 0.35 <= entry["value"] <= 0.65
            name = f"detection_at_1x_{family.replace(' ', '_')}"
            out[name] = {**entry, "bar": 0.65, "low": 0.35, "ok": inside}
    return out


def _nulls(rows: Rows) -> Figures:
    alarms = sum(r["named"] > 0 for r in rows)
    # Four in two hundred.
    share = _most(rows, lambda r: r["named"] > 0, 0.02)
    flagged = _most(rows, lambda r: bool(r["unexplained"]), None)
    return {"false_alarms": {**share, "alarms": alarms}, "nulls_flagged": flagged}


def _unknown(rows: Rows) -> Figures:
    flagged = [r for r in rows if r["unexplained"]]
    return {
        "unknown_flagged": _least(rows, lambda r: bool(r["unexplained"]), 0.95)
        | _by_effect(rows, lambda r: bool(r["unexplained"])),
        "unknown_joint": _least(
            flagged, lambda r: bool(set(r["joints"]) & set(r["unexplained"])), 0.90
        ),
        "unknown_named": _most(rows, lambda r: r["named"] > 0, 0.02),
    }


def _pairs(rows: Rows) -> Figures:
    clear = [r for r in rows if both_clear(r)]
    return {
        "pairs_both_named": _least(clear, lambda r: r["found"] == 2, 0.80),
        "pairs_false_third": _most(rows, lambda r: r["extra"] > 0, 0.03),
        "pairs_with_a_small_one": figure(
            len(rows) - len(clear), None, len(rows), why=_NO_BAR
        ),
    }


def _forms(rows: Rows) -> Figures:
    each: dict[str, list[bool]] = {}
    for row in rows:
        each.setdefault(row["what"], []).append(is_right(row))
    shares = {form: round(float(np.mean(hits)), 3) for form, hits in each.items()}
    return {"forms_right": _least(rows, is_right, 0.90) | {"per_form": shares}}


def _across(rows: Mapping[str, Rows]) -> Figures:
    """Figures of all cases with something to name: names, errors, coverage."""
    groups = ("singles", "detection", "pairs")
    some = [r for g in groups for r in rows.get(g, ()) if "outcome" in r]
    named = [r for r in some if r["named"]]
    out: Figures = {}
    if named:
        right = _least(named, lambda r: r["outcome"] != WRONG, 0.99)
        if len(named) < 300:
            right |= {"ok": None, "why": f"{len(named)} named, 300 are needed"}
        out["named_right"] = right
        out["no_name_false"] = _least(named, lambda r: not r["extra"], None)
    ratios = [r["error_after"] / r["error_oracle"] for r in some if r["error_oracle"]]
    if ratios:
        out["error_over_oracle"] = figure(float(np.median(ratios)), 1.15, len(ratios))
        out["error_over_oracle"] |= {"quantiles": _quantiles(ratios)}
    gaps = [r["gap_closed"] for r in some if r["gap_closed"] is not None]
    if gaps:
        value = float(np.median(gaps))
        out["gap_closed"] = figure(value, None, len(gaps), why=_NO_BAR)
    return out | _coverage(rows)


def _coverage(rows: Mapping[str, Rows]) -> Figures:
    own = [r for r in rows.get("singles", ()) if r.get("z") is not None]
    if not own:
        return {}
    entry = _rate(own, lambda r: abs(r["z"]) <= 2)
    each: dict[str, list[float]] = {}
    for row in own:
        each.setdefault(row["effect"], []).append(round(row["z"], 2))
    inside = 0.90 <= entry["value"] <= 0.99
    return {
        "coverage_2_sigma": {**entry, "bar": 0.99, "low": 0.90, "ok": inside}
        | {"z_per_effect": each}
    }


def _rate(rows: Rows, hit: Callable[[Mapping], bool]) -> dict:
    """Return a rate with its interval, and its counts on either kind of arm."""
    n, hits = len(rows), sum(bool(hit(r)) for r in rows)
    entry = figure(hits / n if n else None, None, n, interval=wilson(hits, n))
    kinds = sorted({r["data"] for r in rows})
    of = {k: [bool(hit(r)) for r in rows if r["data"] == k] for k in kinds}
    return entry | {"data": {k: [sum(v), len(v)] for k, v in of.items()}}


def _least(rows: Rows, hit: Callable[[Mapping], bool], bar: float | None) -> dict:
    entry = _rate(rows, hit)
    if bar is None:
        return entry | {"why": _NO_BAR}
    ok = None if entry["value"] is None else bool(entry["value"] >= bar)
    return entry | {"bar": bar, "ok": ok, "at_least": True}


def _most(rows: Rows, hit: Callable[[Mapping], bool], bar: float | None) -> dict:
    entry = _rate(rows, hit)
    if bar is None:
        return entry | {"why": _NO_BAR}
    ok = None if entry["value"] is None else bool(entry["value"] <= bar)
    return entry | {"bar": bar, "ok": ok}


def _by_effect(rows: Rows, hit: Callable[[Mapping], bool] = is_right) -> dict:
    each: dict[str, list[bool]] = {}
    for row in rows:
        each.setdefault(row["effect"], []).append(bool(hit(row)))
    return {"per_effect": {k: [sum(v), len(v)] for k, v in sorted(each.items())}}


def _quantiles(values: Sequence[float]) -> list[float]:
    return [round(float(q), 4) for q in np.quantile(values, (0.1, 0.5, 0.9))]
