"""Figures of a blind study: sums over its rows, each with its count and interval."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy.stats import binomtest

from flows.blind.score import (
    CLASS,
    FLAGGED,
    NOTHING,
    PAIR,
    RIGHT,
    SINGLE,
    UNKNOWN,
    WRONG,
)


def wilson(hits: int, n: int) -> list[float]:
    """Return the 95 % Wilson interval of a rate, to four digits.

    Args:
        n: Of how many; 0 gives [0, 1].
    """
    if n == 0:
        return [0.0, 1.0]
    interval = binomtest(hits, n).proportion_ci(method="wilson")
    return [round(float(interval.low), 4), round(float(interval.high), 4)]


def rate(hits: int, n: int) -> dict:
    """Return a rate with its count and its 95 % interval, as JSON can hold it."""
    value = hits / n if n else None
    return {"value": value, "hits": hits, "n": n, "interval": wilson(hits, n)}


CLEAR = 3.0  # multiples of the minimum detectable size from which one ought to see it
_ROUNDING = 1e-6
# Where the multiples that were asked for lie, with what was capped between them.
BINS = ((0.0, 0.75), (0.75, 1.5), (1.5, 4.0), (4.0, 7.5), (7.5, np.inf))

Row = Mapping


def summary(rows: Sequence[Row]) -> dict:
    """Return the figures of a study, as JSON can hold them."""
    singles = _of(rows, SINGLE)
    clear = [r for r in singles if is_clear(r)]
    pairs = [r for r in _of(rows, PAIR) if both_clear(r)]
    named = [r for r in rows if r["named"]]
    return {
        "cases": dict(Counter(r["drawn"] for r in rows)),
        "outcomes": outcomes(rows),
        "confusion": confusion(rows),
        "singles_clear_right": _rate(clear, is_right),
        "singles_right": _rate(singles, is_right),
        "singles_of_usual_size_right": _rate(
            [r for r in singles if r["multiple"] is None], is_right
        ),
        "singles_by_name": _rate(singles, lambda r: r["outcome"] == RIGHT),
        "joint_right": _rate(
            [r for r in singles if r["named"]], lambda r: bool(r["joint_right"])
        ),
        "named_right": _rate(named, lambda r: r["outcome"] != WRONG),
        "names_none_false": _rate(named, lambda r: not r["extra"]),
        "false_alarms": _rate(_of(rows, NOTHING), lambda r: r["named"] > 0),
        "nulls_flagged": _rate(_of(rows, NOTHING), lambda r: r["outcome"] == FLAGGED),
        "unknown_flagged": _rate(_of(rows, UNKNOWN), lambda r: bool(r["unexplained"])),
        "unknown_named": _rate(_of(rows, UNKNOWN), lambda r: r["named"] > 0),
        "unknown_joint": _rate(
            [r for r in _of(rows, UNKNOWN) if r["unexplained"]],
            lambda r: bool(set(r["joints"]) & set(r["unexplained"])),
        ),
        "pairs_clear_both": _rate(pairs, lambda r: r["found"] == 2),
        "pairs_both": _rate(_of(rows, PAIR), lambda r: r["found"] == 2),
        "pairs_false_third": _rate(_of(rows, PAIR), lambda r: r["extra"] > 0),
        "detection": detection(singles),
        "coverage": coverage(rows),
        "parameter_error": parameter_error(rows),
        "errors": errors(rows),
        "seconds_median": _median(r["seconds"] for r in rows),
    }


def is_right(row: Row) -> bool:
    """Whether a case was named as it is, or in the class of what is there."""
    return row["outcome"] in (RIGHT, CLASS)


def is_clear(row: Row) -> bool:
    """Whether a hidden effect is so large that it ought to be seen."""
    return row["multiple"] is not None and row["multiple"] >= CLEAR - _ROUNDING


def both_clear(row: Row) -> bool:
    """Whether neither of a pair is known to be too small to be seen."""
    sizes = (row["multiple"], row["second_multiple"])
    return all(size is None or size >= CLEAR - _ROUNDING for size in sizes)


def outcomes(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return how often each kind of case came out how."""
    out: dict[str, Counter] = {}
    for row in rows:
        out.setdefault(row["drawn"], Counter())[row["outcome"]] += 1
    return {drawn: dict(counts) for drawn, counts in out.items()}


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Return what was said of each hidden effect: true effect, then first name.

    What is in the class of the first name counts as named. "none" stands for nothing
    hidden or nothing said, "unknown" for a flag without a name. Pairs are not in it.
    """
    out: dict[str, Counter] = {}
    for row in rows:
        if row["drawn"] == PAIR:
            continue
        true = row["effect"] or NOTHING
        said = true if row["outcome"] == CLASS else row["named_first"]
        if said is None:
            said = UNKNOWN if row["unexplained"] else NOTHING
        out.setdefault(true, Counter())[said] += 1
    return {true: dict(counts) for true, counts in sorted(out.items())}


def detection(singles: Sequence[Row]) -> list[dict]:
    """Return how often an effect was rightly named, by its size in detectable ones."""
    out = []
    for low, high in BINS:
        rows = [
            r
            for r in singles
            if r["multiple"] is not None and low <= r["multiple"] < high
        ]
        if rows:
            middle = float(np.exp(np.mean([np.log(r["multiple"]) for r in rows])))
            out.append({"multiple": middle, **_rate(rows, is_right)})
    return out


def coverage(rows: Sequence[Row]) -> dict:
    """Return how often the truth is within two standard deviations."""
    z = [r["z"] for r in rows if r["z"] is not None]
    return rate(sum(abs(v) <= 2 for v in z), len(z))


def parameter_error(rows: Sequence[Row]) -> dict:
    """Return the median relative error of what was rightly named, over all and each."""
    each: dict[str, list[float]] = {}
    for row in rows:
        if row["value"] is not None and row["truth"]:
            off = abs(row["value"] / row["truth"] - 1)
            each.setdefault(row["effect"], []).append(off)
    medians = {name: _median(values) for name, values in sorted(each.items())}
    every = [v for values in each.values() for v in values]
    return {"median": _median(every), "n": len(every), "per_effect": medians}


def errors(rows: Sequence[Row]) -> dict:
    """Return median held-out errors of cases with a named truth, and the gap closed."""
    known = [r for r in rows if r["drawn"] in (SINGLE, PAIR) and r["error_oracle"]]
    keys = ("error_before", "error_refit", "error_after", "error_oracle")
    ratios = [r["error_after"] / r["error_oracle"] for r in known]
    named = [r["error_after"] / r["error_oracle"] for r in known if is_right(r)]
    gaps = [r["gap_closed"] for r in known if r["gap_closed"] is not None]
    return {
        "n": len(known),
        **{key: _median(r[key] for r in known) for key in keys},
        "over_oracle": _median(ratios),
        "over_oracle_where_right": _median(named),
        "gap_closed": _median(gaps),
        "gaps": len(gaps),
    }


def _of(rows: Sequence[Row], drawn: str) -> list[Row]:
    return [r for r in rows if r["drawn"] == drawn]


def _rate(rows: Sequence[Row], hit) -> dict:
    return rate(sum(bool(hit(r)) for r in rows), len(rows))


def _median(values: Iterable[float | None]) -> float | None:
    known = [v for v in values if v is not None]
    return float(np.median(known)) if known else None
