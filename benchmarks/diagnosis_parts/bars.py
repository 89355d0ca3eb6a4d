"""Figures and bars of the rows of all groups."""

import argparse
from collections.abc import Callable, Mapping
from operator import itemgetter

import numpy as np

from benchmarks.diagnosis_parts.cases import COST
from benchmarks.diagnosis_parts.cost import cost_figures
from benchmarks.harness.cases import by_group, crash_figures
from benchmarks.harness.figures import NO_BAR, Figures, figure, missing, undecided
from benchmarks.harness.rates import Line, Rows, at_least, counts, lines, per, within_two_deviations
from benchmarks.hidden.score import WRONG, is_right
from tests.synthetic.sized import CLEAR, SHARES

# Families that detection is pooled over; a new effect is in "other" until it is here.
_NAMES = {
    "dry friction": "coulomb coulomb_asymmetry stribeck presliding position_friction warmup",
    "viscous friction": "viscous viscous_asymmetry quadratic_viscous power_viscous",
    "gear": "load_friction coupled_friction elasticity backlash ripple",
    "inertia": "rotor_inertia link_inertia payload",
    "static": "offset spring balancer base_tilt tool_force",
    "sensor": "torque_gain saturation delay encoder_offset encoder_eccentricity",
}
FAMILIES = (*_NAMES, "other")
_FAMILY = {name: family for family, names in _NAMES.items() for name in names.split()}


def all_figures(rows: Rows, args: argparse.Namespace) -> Figures:
    figures = cost_figures(args.quick) if COST in args.groups else {}
    return figures | (_case_figures(by_group(rows), args.deciding) if rows else {})


def _case_figures(rows: Mapping[str, Rows], deciding: bool) -> Figures:
    figures: Figures = {}
    for group, of_group in rows.items():
        good = [row for row in of_group if "outcome" in row]
        figures |= lines(_TABLES.get(group, ()), good)
        figures |= _detection(good) if group == "detection" else {}
    if "singles" in rows:
        more = sum("left_out" in row for row in rows["singles"])
        entry = figure(more, None, len(rows["singles"]), why=NO_BAR)
        figures["singles_more_than_an_arm_has"] = entry
    every = [row for of_group in rows.values() for row in of_group]
    figures |= _across(rows) | crash_figures(every)
    return figures if deciding else undecided(figures)


_named, _flagged = itemgetter("named"), itemgetter("unexplained")


def _both(row: Mapping) -> bool:
    return row["found"] == 2


def _of_share(share: float | None) -> Callable[[Mapping], bool]:
    """Of a size; None for a torque in proportion to no parameter, of usual size."""
    return lambda row: row["share"] == share


_TABLES: Mapping[str, tuple[Line, ...]] = {
    "singles": (
        *(
            Line(
                f"singles_of_{100 * share:g}_right",
                is_right,
                0.95 if share in CLEAR else None,
                _of_share(share),
                beside=per(is_right),
            )
            for share in reversed(SHARES)
        ),
        Line("singles_of_usual_size_right", is_right, 0.95, _of_share(None), beside=per(is_right)),
        Line("singles_joint_right", itemgetter("joint_right"), of=lambda r: r["share"] in CLEAR),
    ),
    "nulls": (
        Line("false_alarms", _named, 0.02, most=True),  # four in two hundred
        Line("nulls_flagged", _flagged),
    ),
    "unknown": (
        Line("unknown_flagged", _flagged, 0.95),
        Line(
            "unknown_joint",
            lambda r: bool(set(r["joints"]) & set(r["unexplained"])),
            0.90,
            _flagged,
        ),
        Line("unknown_named", _named, 0.02, most=True),
    ),
    "pairs": (
        Line("pairs_both_named", _both, 0.85),
        Line("pairs_false_third", itemgetter("extra"), 0.03, most=True),
    ),
    "forms": (Line("forms_right", is_right, 0.90),),
}


def _detection(rows: Rows) -> Figures:
    out: Figures = {}
    for family in FAMILIES:
        own = [r for r in rows if _FAMILY.get(r["effect"], "other") == family]
        name = f"detection_at_1x_{family.replace(' ', '_')}"
        line = Line(name, is_right, 0.65, low=0.35)
        out |= lines([line] if own else [], own)
    return out


def _across(rows: Mapping[str, Rows]) -> Figures:
    groups = ("singles", "detection", "pairs")
    some = [r for g in groups for r in rows.get(g, ()) if "outcome" in r]
    named = [r for r in some if r["named"]]
    out: Figures = {}
    if named:
        out |= lines(_OF_NAMES, named)
        if len(named) < 300:
            why = f"{len(named)} named, 300 are needed"
            out["named_right"] |= {"ok": None, "why": why}
    ratios = [r["error_after"] / r["error_oracle"] for r in some if r["error_oracle"]]
    if ratios:
        out["error_over_oracle"] = figure(float(np.median(ratios)), 1.15, len(ratios))
    own = _deviations(rows.get("singles", ()))
    if own:
        out["coverage_2_sigma"] = within_two_deviations(own, 0.90, 0.99)
    return out | _coverage(_deviations(some))


_OF_NAMES = (
    Line("named_right", lambda r: r["outcome"] != WRONG, 0.99),
    Line("no_name_false", lambda r: not r["extra"]),
)
_ENOUGH = 10  # deviations of an effect that say how good they are


def _deviations(rows: Rows) -> Rows:
    return [{"effect": n, "z": z} for r in rows for n, z in r.get("deviations", ())]


def _coverage(known: Rows) -> Figures:
    """The worst coverage of two deviations, of effects with enough of them."""
    each = counts(known, lambda one: abs(one["z"]) <= 2, "effect")
    shares = {e: hits / n for e, (hits, n) in each.items() if n >= _ENOUGH}
    if not shares:
        why = f"no effect has {_ENOUGH} deviations"
        return {"coverage_2_sigma_worst_effect": missing(0.90, why)} if known else {}
    worst = figure(min(shares.values()), None, len(shares), per_effect=each)
    return {"coverage_2_sigma_worst_effect": at_least(worst, 0.90)}
