"""Figures of added effects: how many of those that the logs show are named.

A name is new if the logs without the effect do not have it. Constants, which the
oracle fits too, and effects that the logs without them have already stand apart.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from benchmarks.harness.figures import NO_BAR, Figures, figure
from benchmarks.harness.rates import Line, Rows, counts, lines

CONSTANT = "offset"
FIRST, ANOTHER = 0.70, 0.06  # of the effects that the logs show; of the cases
PRICE = 5  # right first names that another name costs
OURS, PEER = ("named", "suspected"), ("peer",)
_POINTS = 12  # of the curve, beside the probabilities that decide today
_DECIDING = (0.5, 0.9)


def added_figures(rows: Rows) -> Figures:
    """Return the figures of the program and of the greedy peer."""
    ours, peer = _figures(judged(rows, OURS)), _figures(judged(rows, PEER))
    of_peer = {
        f"{name}_of_peer": entry | {"bar": None, "ok": None, "why": "greedy selection"}
        for name, entry in peer.items()
        if entry["n"] and name != _SUSPECTED
    }
    return ours | of_peer


def judged(rows: Rows, keys: Sequence[str], least: float | None = None) -> list[dict]:
    """Return of each added effect whether it is first, named, and another name new.

    Args:
        keys: Where the names of an answer stand; the first are what it is sure of.
        least: Probability from which a name of any key counts, the most probable
            first; None for the names that the answer is sure of, in its order.
    """
    before = {
        row["split"]: [x for key in keys for x in row[key]]
        for row in rows
        if row["truth"] is None
    }
    return [
        _judged(row, before[row["split"]], _names(row, keys, least), keys)
        for row in rows
        if row["truth"]
    ]


def _names(row: Mapping, keys: Sequence[str], least: float | None) -> list:
    if least is None:
        return row[keys[0]]
    some = [x for key in keys for x in row[key] if (x[3] or 0.0) >= least]
    return sorted(some, key=lambda x: -x[3])


def _judged(row: Mapping, before: list, names: list, keys: Sequence[str]) -> dict:
    places, truth = {tuple(x[:2]) for x in before}, row["truth"]
    new = [x for x in names if tuple(x[:2]) not in places]
    right = [_is_truth(x, truth) for x in new]
    known = any(_is_truth(x, truth) for x in before)
    return {
        "effect": truth[0],
        "size": f"{100 * row['target']:g} %",
        "constant": truth[0] == CONSTANT,
        "known": known,
        "heard": row["heard"] and truth[0] != CONSTANT and not known,
        "first": bool(right and right[0]),
        "named": any(_is_truth(x, truth) for x in names) if known else any(right),
        "suspected": any(_is_truth(x, truth) for key in keys[1:] for x in row[key]),
        "another": not all(right),
    }


def _is_truth(name: Sequence, truth: Sequence) -> bool:
    effect, joint, alike, _ = name
    return joint == truth[1] and truth[0] in (effect, *alike)


def _is(*keys: str) -> Callable[[Mapping], bool]:
    return lambda row: all(row[key] for key in keys)


def _per_size(key: str) -> Callable[[Rows], dict]:
    return lambda rows: {"per_size": counts(rows, _is(key), "size")}


_SUSPECTED = "added_suspected"  # the peer suspects nothing
_LINES = (
    Line("added_first", _is("first"), FIRST, _is("heard"), beside=_per_size("first")),
    Line("added_named", _is("named"), of=_is("heard"), beside=_per_size("named")),
    Line(_SUSPECTED, _is("suspected"), of=_is("heard")),
    Line("added_another", _is("another"), ANOTHER, _is("heard"), most=True),
    Line("added_another_of_all", _is("another"), ANOTHER, most=True),
    Line("added_constant_first", _is("first"), of=_is("constant")),
    Line("added_known_named", _is("named"), of=_is("known")),
)


def _figures(answers: Rows) -> Figures:
    out = lines(_LINES, answers, "effect")
    heard = [row for row in answers if row["heard"]]
    right, wrong = (sum(row[k] for row in heard) for k in ("first", "another"))
    value = (right - PRICE * wrong) / len(heard) if heard else None
    more = {"first": right, "another": wrong, "another_of_all": _all(answers)}
    score = figure(value, None, len(heard), why=NO_BAR, **more)
    return out | {"added_first_less_another": score}


def _all(answers: Rows) -> int:
    return sum(row["another"] for row in answers)


def curve(rows: Rows) -> dict:
    """Return a table of first against another name over the least probability.

    Title and rows of texts. Effects and suspected ones count alike, the most probable
    first.
    """
    every = [x[3] for row in rows for key in OURS for x in row[key] if x[3] is not None]
    levels = np.linspace(0.0, 1.0, _POINTS)
    own = np.quantile(every, levels, method="nearest") if every else ()
    out = [["least probability", "first", "named", "another", "another, of all"]]
    for least in sorted({*_DECIDING, *map(float, own)}):
        answers = judged(rows, OURS, least)
        heard = [row for row in answers if row["heard"]]
        cells = [
            f"{sum(row[key] for row in heard)} of {len(heard)}"
            for key in ("first", "named", "another")
        ]
        all_cases = f"{_all(answers)} of {len(answers)}"
        out.append([f"{least:.4g}", *cells, all_cases])
    return {"title": "Added effects by probability", "rows": out}
