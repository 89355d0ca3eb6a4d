"""Figures from rows: shares with intervals, and their bars.

Apart from `figures`, which loads no NumPy.
"""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter, process_time

from scipy.stats import binomtest

from benchmarks.harness.figures import NO_BAR, Figures, figure

Rows = Sequence[Mapping]
Hit = Callable[[Mapping], bool]


def wilson(hits: int, n: int) -> list[float]:
    """Return the 95 % Wilson interval of a rate, to four digits; of nothing [0, 1]."""
    if n == 0:
        return [0.0, 1.0]
    interval = binomtest(hits, n).proportion_ci(method="wilson")
    return [round(float(interval.low), 4), round(float(interval.high), 4)]


def share(hits: int, n: int, **extra: object) -> dict:
    """Return a share with its interval; null of nothing."""
    value = hits / n if n else None
    return figure(value, None, n, interval=wilson(hits, n), **extra)


def rate(rows: Rows, hit: Hit, by: str = "") -> dict:
    """Return the share of rows that hit; with `by`, its counts by that key of a row."""
    hits = [bool(hit(row)) for row in rows]
    entry = share(sum(hits), len(rows))
    return entry | ({"data": counts(rows, hit, by)} if by else {})


def counts(rows: Rows, hit: Hit, by: str) -> dict[str, list[int]]:
    """Return hits and rows by a key of the rows."""
    each: dict[str, list[int]] = {}
    for row in rows:
        of = each.setdefault(row[by], [0, 0])
        of[0] += bool(hit(row))
        of[1] += 1
    return dict(sorted(each.items()))


def at_least(entry: dict, bar: float | None) -> dict:
    """Return a figure that must reach its bar; None for one without a bar."""
    if bar is None:
        return entry | {"why": NO_BAR}
    ok = None if entry["value"] is None else bool(entry["value"] >= bar)
    return entry | {"bar": bar, "ok": ok, "at_least": True}


def at_most(entry: dict, bar: float | None) -> dict:
    """Return a figure that may not exceed its bar; None for one without a bar."""
    if bar is None:
        return entry | {"why": NO_BAR}
    return entry | {"bar": bar, "ok": figure(entry["value"], bar, 0)["ok"]}


def between(entry: dict, low: float, high: float) -> dict:
    """Return a figure that must lie between two bars, both included."""
    value = entry["value"]
    ok = None if value is None else bool(low <= value <= high)
    return entry | {"bar": high, "low": low, "ok": ok}


@dataclass(frozen=True, slots=True)
class Line:
    """One figure of rows: how many of which of them hit, and the bar of that."""

    key: str
    hit: Hit
    bar: float | None = None
    of: Hit | None = None  # rows that it is of, None for all
    most: bool = False  # whether the bar is the most that it may be, not the least
    low: float | None = None  # with it a share lies between this and the bar
    count: bool = False  # whether it is a number of rows, not a share, without a bar
    beside: Callable[[Rows], Mapping] = lambda rows: {}  # what else the entry holds


def lines(table: Iterable[Line], rows: Rows, by: str = "") -> Figures:
    """Return the figures of a table, each with its counts by a key of the rows."""
    out: Figures = {}
    for line in table:
        own = [row for row in rows if line.of is None or line.of(row)]
        entry = rate(own, line.hit, by)
        if line.count:
            hits = sum(bool(line.hit(row)) for row in own)
            entry = figure(hits, None, len(own), why=NO_BAR)
        elif line.low is not None:
            entry = between(entry, line.low, line.bar)
        else:
            entry = (at_most if line.most else at_least)(entry, line.bar)
        out[line.key] = entry | dict(line.beside(own))
    return out


def per(hit: Hit, key: str = "effect") -> Callable[[Rows], dict]:
    """Return what puts hits and rows by a key of theirs beside a figure."""
    return lambda rows: {f"per_{key}": counts(rows, hit, key)}


def within_two_deviations(rows: Rows, by: str, low: float, high: float) -> dict:
    """Return how often a stated deviation from the truth is two or less."""
    sized = [row for row in rows if row.get("z") is not None]
    each: dict[str, list[float]] = {}
    for row in sized:
        each.setdefault(row["effect"], []).append(round(row["z"], 2))
    entry = between(rate(sized, lambda row: abs(row["z"]) <= 2, by), low, high)
    return entry | {"z_per_effect": dict(sorted(each.items()))}


def counted(names: Iterable[str]) -> dict[str, int]:
    return dict(Counter(names).most_common())


def rounded(values: Iterable[float], digits: int = 3) -> list[float]:
    return [round(float(value), digits) for value in values]


def wall(job: Callable[[], object]) -> float:
    """Return how long a call takes on the clock [s]."""
    start = perf_counter()
    job()
    return perf_counter() - start


def cpu(job: Callable[[], object]) -> float:
    """Return the processor time of a call: other processes do not count [s]."""
    start = process_time()
    job()
    return process_time() - start
