"""Group sweep: levels 2 to 40 under three schemes, all component counts (figure 12)."""

import numpy as np

from benchmarks.figures import Figures, figure, partial
from benchmarks.plsr_parts.rows import repeated_rows, seconds
from residual.tables.crossval import leave_one_out, random_blocks, systematic
from residual.tables.nominal_choice import nominal_errors
from residual.tables.nominal_pls import NominalForm

_SECONDS = 60.0
_LEVELS = range(2, 41)
_COMPONENTS = 15


def sweep_figures(quick: bool) -> Figures:
    """Validate every number of levels on 20 000 rows; the quick run every sixth."""
    X, Y, run = repeated_rows()
    n = len(X)
    schemes = [
        leave_one_out(run),
        systematic(n),
        random_blocks(n, np.random.default_rng(1)),
    ]
    tried = _LEVELS[::6] if quick else _LEVELS
    nominal_errors(X[:4000:9], Y[:4000:9], [systematic(445)], Y[:4000:9], _form(3))

    def sweep() -> None:
        for levels in tried:
            nominal_errors(X, Y, schemes, Y, _form(levels))

    spent = seconds(sweep)
    whole = spent * len(_LEVELS) / len(tried)
    entry = figure(whole, _SECONDS, len(tried), rows=n, measured=spent)
    if quick:
        entry = partial(entry, f"scaled up from {len(tried)} of {len(_LEVELS)} levels")
    return {"sweep_seconds": entry}


def _form(levels: int) -> NominalForm:
    # Two levels of nine variables have 45 dimensions: enough for 15 components.
    return NominalForm(levels, _COMPONENTS)
