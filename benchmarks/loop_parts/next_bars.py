"""Figures of the experiments that were designed: settled or not, and how soon."""

from collections.abc import Mapping, Sequence

import numpy as np

from benchmarks.figures import Figures, figure
from benchmarks.seeded import FEW
from flows.blind.sums import wilson

SECONDS = 20.0  # of an experiment
SETTLED, FASTER_RANDOM, FASTER_D = 0.80, 3.0, 1.5
DESIGNED, RANDOM, D_OPTIMAL = "designed", "random", "d_optimal"
FAST_RANDOM, FAST_D = "random of short periods", "d_optimal of short periods"


def figures_of(rows: Sequence[Mapping], deciding: bool) -> Figures:
    """Return the figures of some rows.

    Args:
        deciding: Whether these are the seeds that decide.
    """
    done = [r for r in rows if r.get("open")]
    hits = sum(r["settled"] for r in done)
    value = hits / len(done) if done else None
    entry = figure(value, SETTLED, len(done), interval=wilson(hits, len(done)))
    entry |= {"ok": None if value is None else value >= SETTLED, "at_least": True}
    figures = {
        "next_settled": entry,
        "next_random_over_designed": _ratio(done, RANDOM, FASTER_RANDOM),
        "next_d_optimal_over_designed": _ratio(done, D_OPTIMAL, FASTER_D),
        "next_random_of_short_periods": _ratio(done, FAST_RANDOM, None),
        "next_d_optimal_of_short_periods": _ratio(done, FAST_D, None),
        "next_chance_said": figure(
            float(np.mean([r["chance"] for r in done])) if done else None,
            None,
            len(done),
            why="beside the share that was settled",
        ),
        "next_crashes": figure(sum("error" in r for r in rows), 0, len(rows)),
    }
    if deciding:
        return figures
    return {k: v | {"ok": None, "why": v.get("why", FEW)} for k, v in figures.items()}


def _ratio(rows: Sequence[Mapping], name: str, bar: float | None) -> dict:
    """Median seconds of a usual motion over those of the designed one.

    A motion that never has enough counts with its length: the ratio is a least one.
    """
    told = [r["seconds"] for r in rows if r["seconds"][DESIGNED] is not None]
    if not told:
        return figure(None, bar, 0, why="no case whose truth is a rival")
    ours, theirs = (float(np.median([s[n] for s in told])) for n in (DESIGNED, name))
    value = theirs / ours
    never = sum(s[name] >= SECONDS for s in told)
    entry = figure(value, bar, len(told), medians=[ours, theirs], never=never)
    if bar is None:
        return entry | {"why": "beside those with a bar"}
    return entry | {"ok": value >= bar, "at_least": True}
