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


def share(hits: int, n: int, **extra: object) -> dict:
    """Return a share with its 95 % Wilson interval; null of nothing."""
    interval = [0.0, 1.0]
    if n:
        known = binomtest(hits, n).proportion_ci(method="wilson")
        interval = [round(float(end), 4) for end in (known.low, known.high)]
    return figure(hits / n if n else None, None, n, interval=interval, **extra)


def rate(hits: Iterable[object], **extra: object) -> dict:
    """Return the share of cases that hit."""
    every = [bool(hit) for hit in hits]
    return share(sum(every), len(every), **extra)


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


def at_most(entry: dict, bar: float) -> dict:
    """Return a figure that may not exceed its bar."""
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
    beside: Callable[[Rows], Mapping] = lambda rows: {}  # what else the entry holds


def lines(table: Iterable[Line], rows: Rows) -> Figures:
    """Return the figures of a table."""
    out: Figures = {}
    for line in table:
        own = [row for row in rows if line.of is None or line.of(row)]
        entry = rate(map(line.hit, own))
        if line.low is not None:
            entry = between(entry, line.low, line.bar)
        else:
            entry = (at_most if line.most else at_least)(entry, line.bar)
        out[line.key] = entry | dict(line.beside(own))
    return out


def per(hit: Hit, key: str = "effect") -> Callable[[Rows], dict]:
    """Return what puts hits and rows by a key of theirs beside a figure."""
    return lambda rows: {f"per_{key}": counts(rows, hit, key)}


def within_two_deviations(rows: Rows, low: float, high: float) -> dict:
    """Return how often a stated deviation from the truth is two or less."""
    return between(rate(abs(row["z"]) <= 2 for row in rows), low, high)


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
