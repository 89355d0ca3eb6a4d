"""Figures of measured arms: held-out errors, names that repeat, and added effects."""

import argparse
from collections.abc import Mapping, Sequence
from itertools import permutations
from operator import itemgetter

import numpy as np

from benchmarks.harness.figures import NO_BAR, NO_LOGS, Figures, figure, missing
from benchmarks.harness.rates import Line, Rows, at_least, at_most, lines, rate
from benchmarks.measured_parts import arms, files

WORSE = 1.10  # times plain least squares on one joint: more than a log decides
REPEATED, CONSTANT = 0.7, "offset"
LOADED_JOINTS, DAYS_NAMED, HALVED = (2, 3), 4, 0.7
FRICTION = "load_friction"
WEIGHED, LOAD_ERROR = 2.805, 0.08  # kg; share
FIRST, ANOTHER = 0.70, 0.06  # of the effects that the logs show; of the cases
PRICE = 5  # right first names that another name costs


def all_figures(rows: Rows, args: argparse.Namespace) -> Figures:
    failed = [row["error"] for row in rows if "error" in row]
    if failed:
        raise SystemExit("; ".join(failed))
    figures: Figures = {}
    of = recorded(rows)
    if "splits" in args.groups:
        figures |= split_figures(of["splits"])
    if of["added"]:
        figures |= added_figures(of["added"])
    return figures | (files.figures(args.quick) if "files" in args.groups else {})


def recorded(rows: Rows) -> dict[str, list]:
    added = [row for row in rows if "truth" in row]
    return {"splits": [row for row in rows if "truth" not in row], "added": added}


def split_figures(rows: Rows) -> Figures:
    """Return the figures of diagnosed splits; null without measured logs."""
    if not rows:
        return {"measured_worse_than_least_squares": missing(0, NO_LOGS)}
    by_name = {row["split"]: row for row in rows}
    compared = [row for row in rows if row["peer"]]
    # Our error over a peer's, by joint; NaN where a torque is too small.
    squares, paper = (
        np.concatenate(
            [np.array(row["filtered"]["augmented"], dtype=float) / row[peer] for row in compared]
            or [[]]
        )
        for peer in ("peer", "plsr")
    )
    n, harmed = len(squares), sum(len(row["worse"]) for row in rows)
    out = {
        "measured_worse_than_least_squares": figure(int((squares > WORSE).sum()), 0, n),
        "measured_over_least_squares": _mean(squares),
        "measured_over_plsr": _mean(paper),
        "measured_joints_harmed": figure(harmed, 0, n),
    }
    return out | _repeats(rows) | _friction(by_name) | _load(by_name)


def _mean(ratios: np.ndarray) -> dict:
    good = ratios[np.isfinite(ratios)]
    value = float(np.exp(np.log(good).mean())) if len(good) else None
    return figure(value, None, len(good), why=NO_BAR)


def _repeats(rows: Rows) -> Figures:
    """Return how many names of one split another split of the same logs has too.

    A name is an effect on one joint. It repeats as itself, or if one of the two states
    the other as an equivalent. All pairs of splits of one arm and torque count.
    """
    twins = [
        (name, any(_is_twin(name, other) for other in _places(b)))
        for a, b in permutations(rows, 2)
        if arms.same_logs(a["split"], b["split"])
        for name in _places(a)
    ]
    some = (twin for name, twin in twins if name[0] != CONSTANT)
    return {
        "names_repeat": at_least(rate(twin for _, twin in twins), REPEATED),
        "names_repeat_no_constants": at_least(rate(some), None),
    }


def _places(row: Mapping) -> list[tuple[str, int, tuple[str, ...]]]:
    """Return effect, joint (0 for the whole arm) and its equivalents there."""
    return [
        (name, j, tuple(a for a, on in alike if j in (*on, 0)))
        for (name, joints), alike in zip(row["named"], row["alike"], strict=True)
        for j in joints or (0,)
    ]


def _is_twin(one: Sequence, other: Sequence) -> bool:
    same = {one[0], *one[2]} & {other[0], *other[2]}
    return one[1] == other[1] and bool({one[0], other[0]} & same)


def _friction(by_name: Mapping[str, Mapping]) -> Figures:
    """Return figures of friction that grows with load, on the UR10e."""
    days = [by_name[n] for d in arms.DAYS if (n := f"ur10e {d} | other days") in by_name]
    if not days:
        return {}
    named = [
        row
        for row in days
        if {*LOADED_JOINTS} <= {j for name, j, alike in _places(row) if FRICTION in (name, *alike)}
    ]
    ratios = [
        row["moving"]["augmented"][j - 1] / row["moving"]["identified"][j - 1]
        for row in named
        for j in LOADED_JOINTS
    ]
    bar = DAYS_NAMED if len(days) == len(arms.DAYS) else len(days)
    largest = figure(max(ratios, default=None), HALVED, len(ratios))
    return {
        "ur10e_days_named": at_least(figure(len(named), None, len(days)), bar),
        "ur10e_error_over_refit": largest,
    }


def _load(by_name: Mapping[str, Mapping]) -> Figures:
    """Return mass of the weighed load, its error, and what is named without it."""
    row, days = by_name.get(arms.LOADED), [f"ur10e {d} | other days" for d in arms.DAYS]
    if row is None:
        return {}
    mass = row["mass"][0] if row["mass"] else None
    error = None if mass is None else abs(mass / WEIGHED - 1)
    entry = at_most(figure(error, None, 1, mass=mass), LOAD_ERROR)
    alone = mass is not None and len(row["named"]) == 1
    unloaded = [by_name[d] for d in days if d in by_name]
    false = sum(bool(each["mass"]) for each in unloaded)
    return {
        "ur10e_load_error": entry if alone else entry | {"ok": False},
        "ur10e_load_without_one": figure(false, 0, len(unloaded)),
    }


def added_figures(rows: Rows) -> Figures:
    """Return how many added effects are named, by the program and by the greedy peer.

    A name is new if nothing that blocks cannot tell from it stands on its joint in the
    logs without the effect. Constants, which the oracle fits too, and effects that the
    logs without them have already stand apart.
    """
    if not rows:
        return {}
    ours, peer = (_added(judged(rows, keys)) for keys in (OURS, PEER))
    of_peer = {
        f"{name}_of_peer": entry | {"bar": None, "ok": None, "why": "greedy selection"}
        for name, entry in peer.items()
        if entry["n"] and name != _SUSPECTED
    }
    return ours | of_peer


# Where the names of an answer stand; the first are what it is sure of.
OURS, PEER = ("named", "suspected"), ("peer",)


def judged(rows: Rows, keys: Sequence[str]) -> list[dict]:
    """Return of each added effect whether it is first, named, and another name new."""
    before = {
        row["split"]: [x for key in keys for x in row[key]] for row in rows if row["truth"] is None
    }
    return [_judged(row, before[row["split"]], keys) for row in rows if row["truth"]]


def _judged(row: Mapping, before: list, keys: Sequence[str]) -> dict:
    places, truth, names = set().union(*map(_class_of, before)), row["truth"], row[keys[0]]
    new = [x for x in names if not _class_of(x) & places]
    right = [_is_truth(x, truth) for x in new]
    known = any(_is_truth(x, truth) for x in before)
    return {
        "constant": truth[0] == CONSTANT,
        "known": known,
        "heard": row["heard"] and truth[0] != CONSTANT and not known,
        "first": bool(right and right[0]),
        "named": any(_is_truth(x, truth) for x in names) if known else any(right),
        "suspected": any(_is_truth(x, truth) for key in keys[1:] for x in row[key]),
        "another": not all(right),
    }


def _class_of(name: Sequence) -> set[tuple[str, int]]:
    effect, joint, alike, _ = name
    return {(one, joint) for one in (effect, *alike)}


def _is_truth(name: Sequence, truth: Sequence) -> bool:
    return tuple(truth[:2]) in _class_of(name)


_SUSPECTED = "added_suspected"  # the peer suspects nothing
_LINES = (
    Line("added_first", itemgetter("first"), FIRST, itemgetter("heard")),
    Line("added_named", itemgetter("named"), of=itemgetter("heard")),
    Line(_SUSPECTED, itemgetter("suspected"), of=itemgetter("heard")),
    Line("added_another", itemgetter("another"), ANOTHER, itemgetter("heard"), most=True),
    Line("added_another_of_all", itemgetter("another"), ANOTHER, most=True),
    Line("added_constant_first", itemgetter("first"), of=itemgetter("constant")),
    Line("added_known_named", itemgetter("named"), of=itemgetter("known")),
)


def _added(answers: Rows) -> Figures:
    heard = [row for row in answers if row["heard"]]
    worth = sum(row["first"] - PRICE * row["another"] for row in heard)
    value = worth / len(heard) if heard else None
    score = figure(value, None, len(heard), why=NO_BAR)
    return lines(_LINES, answers) | {"added_first_less_another": score}
