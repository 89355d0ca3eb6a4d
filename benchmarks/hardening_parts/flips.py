"""One flipped bit at many places of the committed records of a store."""

from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.figures import Figures, figure, partial
from benchmarks.hardening_parts.made import (
    answers,
    committed,
    damaged,
    filled,
    without_index,
)
from benchmarks.store_parts.made import folder
from residual.errors import InputError

FULL = 500


def flip_figures(places: int) -> Figures:
    """Flip bits one at a time; ask `verify`, and ask SQL for all rows of all views.

    Args:
        places: How many. Half of them meet a store without its index, so that the
            records themselves are read.
    """
    rng = np.random.default_rng(16)
    with folder() as place:
        store = place / "store"
        filled(store)
        wanted = answers(store)
        missed, wrong, errors = [], [], Counter()
        paths = committed(store)
        for number in range(places):
            # Every file equally often: small ones are as easily damaged as looked at.
            path = paths[number % len(paths)]
            good = path.read_bytes()
            at, bit = int(rng.integers(len(good))), int(rng.integers(8))
            path.write_bytes(_flipped(good, at, bit))
            where = f"{path.relative_to(store)}:{at}.{bit}"
            if number // len(paths) % 2:
                without_index(store)
            if not damaged(store):
                missed.append(where)
            outcome = _asked(store, wanted)
            errors[outcome] += 1
            if outcome == "changed":
                wrong.append(where)
            path.write_bytes(good)
        whole = not damaged(store)
        without_index(store)
        whole = whole and _asked(store, wanted) == "same"
    figures = {
        "flips_not_found": figure(len(missed), 0, places, told=missed[:5]),
        "flips_other_answer": figure(
            len(wrong), 0, places, told=wrong[:5], sql_refused=errors["refused"]
        ),
        "flips_undone_not_whole": figure(int(not whole), 0, 1),
    }
    if places >= FULL:
        return figures
    why = f"{places} places instead of {FULL}"
    return {name: partial(entry, why) for name, entry in figures.items()}


def _flipped(data: bytes, at: int, bit: int) -> bytes:
    return data[:at] + bytes([data[at] ^ 1 << bit]) + data[at + 1 :]


def _asked(store: Path, wanted: dict) -> str:
    try:
        given = answers(store)
    except InputError:
        return "refused"
    same = all(given[view].equals(rows) for view, rows in wanted.items())
    return "same" if same else "changed"
