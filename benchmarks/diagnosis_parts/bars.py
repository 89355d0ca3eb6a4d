"""What must be reached, as figures of the rows of all groups."""

from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.harness.cases import crash_figures, group_figures
from benchmarks.harness.figures import NO_BAR, Figures, figure, missing, undecided
from benchmarks.harness.rates import (
    Hit,
    Rows,
    at_least,
    at_most,
    between,
    counts,
    rate,
    rounded,
    within_two_deviations,
)
from flows.blind.score import WRONG, both_clear, is_clear, is_right

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
    makers: Mapping[str, Callable[[Rows], Figures]] = {
        "singles": _singles,
        "detection": _detection,
        "nulls": _nulls,
        "unknown": _unknown,
        "pairs": _pairs,
        "forms": _forms,
        "known": _known,
    }
    figures = group_figures(rows, makers) | _powers(rows)
    figures |= _across(rows) | crash_figures(rows)
    return figures if deciding else undecided(figures)


def _least(rows: Rows, hit: Hit, bar: float | None) -> dict:
    return at_least(rate(rows, hit, "data"), bar)


def _most(rows: Rows, hit: Hit, bar: float | None) -> dict:
    return at_most(rate(rows, hit, "data"), bar)


def _named(row: Mapping) -> bool:
    return row["named"] > 0


def _flagged(row: Mapping) -> bool:
    return bool(row["unexplained"])


def _singles(rows: Rows) -> Figures:
    clear = [r for r in rows if is_clear(r)]
    usual = [r for r in rows if r["multiple"] is None]
    return {
        "singles_right": _least(clear, is_right, 0.95)
        | {"per_effect": counts(clear, is_right, "effect")},
        # Their torque is in proportion to no parameter: no multiple can be drawn.
        "singles_of_usual_size_right": _least(usual, is_right, 0.95)
        | {"per_effect": counts(usual, is_right, "effect")},
        "singles_joint_right": _least(clear, lambda r: bool(r["joint_right"]), None),
        "singles_too_small_for_three_times": figure(
            len(rows) - len(clear) - len(usual), None, len(rows), why=NO_BAR
        ),
    }


def _detection(rows: Rows) -> Figures:
    out: Figures = {}
    known = {e: family for family, names in FAMILIES.items() for e in names}
    small = [r for r in rows if r["multiple"] is not None and r["multiple"] <= 1.2]
    for family in (*FAMILIES, "other"):
        own = [r for r in small if known.get(r["effect"], "other") == family]
        if own:
            name = f"detection_at_1x_{family.replace(' ', '_')}"
            out[name] = between(rate(own, is_right, "data"), 0.35, 0.65)
    return out


def _nulls(rows: Rows) -> Figures:
    alarms = sum(r["named"] > 0 for r in rows)
    # Four in two hundred.
    share = _most(rows, _named, 0.02)
    flagged = _most(rows, _flagged, None)
    return {"false_alarms": {**share, "alarms": alarms}, "nulls_flagged": flagged}


def _unknown(rows: Rows) -> Figures:
    flagged = [r for r in rows if r["unexplained"]]
    return {
        "unknown_flagged": _least(rows, _flagged, 0.95)
        | {"per_effect": counts(rows, _flagged, "effect")},
        "unknown_joint": _least(
            flagged, lambda r: bool(set(r["joints"]) & set(r["unexplained"])), 0.90
        ),
        "unknown_named": _most(rows, _named, 0.02),
    }


def _pairs(rows: Rows) -> Figures:
    clear = [r for r in rows if both_clear(r)]
    return {
        "pairs_both_named": _least(clear, lambda r: r["found"] == 2, 0.85),
        "pairs_false_third": _most(rows, lambda r: r["extra"] > 0, 0.03),
        "pairs_with_a_small_one": figure(
            len(rows) - len(clear), None, len(rows), why=NO_BAR
        ),
    }


def _forms(rows: Rows) -> Figures:
    each = counts(rows, is_right, "what")
    shares = {form: round(hits / n, 3) for form, (hits, n) in each.items()}
    return {"forms_right": _least(rows, is_right, 0.90) | {"per_form": shares}}


def _known(rows: Rows) -> Figures:
    """What a load's known mass makes of the deviation of its centre."""
    if not rows:
        return {"known_over_unknown": missing(0.5, "the full run decides")}
    # A load that is named in one of the two only is no narrower.
    parts = [1.0 if r["narrowed"] is None else r["narrowed"] for r in rows]
    entry = figure(max(parts), 0.5, len(rows), all=rounded(parts))
    return {"known_over_unknown": entry}


def _powers(rows: Mapping[str, Rows]) -> Figures:
    """Return what was found of the cases that one sees who is told form and shape."""
    out: Figures = {}
    one = [r for g in ("singles", "detection") for r in rows.get(g, ())]
    of = {e: family for family, names in FAMILIES.items() for e in names}
    groups: dict[str, tuple[list, Hit]] = {
        f"found_of_seen_{family.replace(' ', '_')}": (
            [r for r in one if of.get(r.get("effect"), "other") == family],
            is_right,
        )
        for family in (*FAMILIES, "other")
    }
    groups["found_of_seen_forms"] = list(rows.get("forms", ())), is_right
    groups["found_of_seen_pairs"] = (
        list(rows.get("pairs", ())),
        lambda r: r["found"] == 2,
    )
    groups["flagged_of_seen"] = list(rows.get("unknown", ())), _flagged
    for name, (all_of, hit) in groups.items():
        told = [r for r in all_of if "oracle_sees" in r]
        seen = [r for r in told if r["oracle_sees"]]
        if told:
            by = "what" if name.endswith("forms") else "effect"
            out[name] = _least(seen, hit, None) | {
                "per_effect": counts(seen, hit, by),
                "seen": counts(told, lambda r: r["oracle_sees"], by),
            }
    for name, (group, effects, hit, bar) in _HARD.items():
        some = [r for r in rows.get(group, ()) if r.get("effect") in effects]
        if seen := [r for r in some if r.get("oracle_sees")]:
            out[name] = _least(seen, hit, bar)
        elif some:
            out[name] = missing(bar, f"of {len(some)} cases none can be seen")
    return out


# What is hard to find, where one who is told form and shape would find it.
_HARD: Mapping[str, tuple[str, tuple[str, ...], Hit, float]] = {
    "backlash_found_of_seen": ("singles", ("backlash",), is_right, 0.70),
    "encoder_found_of_seen": (
        "singles",
        ("encoder_offset", "encoder_eccentricity"),
        is_right,
        0.80,
    ),
    "dead_zone_flagged_of_seen": ("unknown", ("x_dead_zone",), _flagged, 0.90),
}


def _across(rows: Mapping[str, Rows]) -> Figures:
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
        out["error_over_oracle"] |= {
            "quantiles": rounded(np.quantile(ratios, (0.1, 0.5, 0.9)), 4)
        }
    gaps = [r["gap_closed"] for r in some if r["gap_closed"] is not None]
    if gaps:
        value = float(np.median(gaps))
        out["gap_closed"] = figure(value, None, len(gaps), why=NO_BAR)
    own = [r for r in rows.get("singles", ()) if r.get("z") is not None]
    if own:
        out["coverage_2_sigma"] = within_two_deviations(own, "data", 0.90, 0.99)
    return out | _coverage(some)


_ENOUGH = 10  # deviations of an effect that say how good they are


def _coverage(rows: Rows) -> Figures:
    """The worst coverage of two deviations, of effects with enough of them."""
    told = [{"effect": n, "z": z} for r in rows for n, z in r.get("deviations", ())]
    known = [one for one in told if one["z"] is not None]
    each = counts(known, lambda one: abs(one["z"]) <= 2, "effect")
    shares = {e: hits / n for e, (hits, n) in each.items() if n >= _ENOUGH}
    if not shares:
        why = f"no effect has {_ENOUGH} deviations"
        return {"coverage_2_sigma_worst_effect": missing(0.90, why)} if known else {}
    worst = figure(min(shares.values()), None, len(shares), per_effect=each)
    return {"coverage_2_sigma_worst_effect": at_least(worst, 0.90)}
