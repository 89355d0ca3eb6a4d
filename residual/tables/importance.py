"""What each variable contributes to a correction, and how far one run decides it.

A pair table also holds main effects of its two variables. They are taken out first
(weighted two-way analysis of variance) and credited to the variables: what is left is
what only a table of both can say.

Over random rows every row left out has a neighbour that stays, and almost any cell
looks significant; over runs the motion itself is left out.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from residual.recording import Array
from residual.tables.blocks import as_block, check_count, frozen
from residual.tables.lookup import Lookup, Table


def table_importance(lookup: Lookup, X: Array) -> dict[str, Array]:
    """Return the size of each term's contribution about its mean on rows X (n, d).

    Returns:
        Variables in order, then every pair that has a table, as "q2 * qd3": [N m],
        shapes (j,).
    """
    X = as_block(X, "X")
    level = [a.edges.searchsorted(X[:, a.variable], side="right") for a in lookup.axes]
    main = {v: X[:, [v]] * lookup.slope[v] for v in range(len(lookup.names))}
    pairs: dict[tuple[int, ...], Array] = {}
    for table in lookup.tables:
        variables = tuple(lookup.axes[a].variable for a in table.axes)
        at = [level[a] for a in table.axes]
        if len(variables) == 1:
            main[variables[0]] = main[variables[0]] + table.values[at[0]]
            continue
        *own, both = split_pair(table, *at)
        for variable, effect, k in zip(variables, own, at, strict=True):
            main[variable] = main[variable] + effect[k]
        pairs[variables] = pairs.get(variables, 0.0) + both[at[0], at[1]]
    parts = {(v,): part for v, part in main.items()} | pairs
    return {
        " * ".join(lookup.names[v] for v in variables): part.std(axis=0)
        for variables, part in parts.items()
    }


def split_pair(table: Table, first: Array, second: Array) -> tuple[Array, ...]:
    """Split a pair table into two main effects and what only both can say.

    min over r, c of the sum over rows of (v_ab - r_a - c_b)^2, level by level, given
    the levels of the rows on either axis.

    Returns:
        r, c and v - r - c; they add up to the table. Shapes (k1, j), (k2, j) and
        (k1, k2, j). The last is zero in a cell without rows.
    """
    rows, columns = table.values.shape[:2]
    count = np.bincount(first * columns + second, minlength=rows * columns)
    N = count.reshape(rows, columns).astype(float)
    weighted = table.values * N[..., None]
    system = np.block([[np.diag(N.sum(1)), N], [N.T, np.diag(N.sum(0))]])
    right = np.concatenate([weighted.sum(axis=1), weighted.sum(axis=0)])
    # The two constants are not told apart, and empty levels not at all: least norm.
    solved = np.linalg.lstsq(system, right, rcond=1e-12)[0]
    r, c = solved[:rows], solved[rows:]
    both = table.values - r[:, None] - c[None]
    return r, c, np.where(N[..., None] > 0, both, 0.0)


ALPHA = 0.05


@dataclass(frozen=True, eq=False, slots=True)
class Jackknife:
    """Fitted numbers with their jack-knife standard errors.

    Attributes:
        values: Fit to all rows. Any shape.
        errors: Standard errors, in the same units. Same shape.
        groups: Groups left out, one at a time.
    """

    values: Array
    errors: Array
    groups: int

    @property
    def t(self) -> Array:
        """Value over standard error; 0 where both vanish. Same shape."""
        some = self.errors > 0
        ratio = self.values / np.where(some, self.errors, 1.0)
        return np.where(some, ratio, np.where(self.values == 0, 0.0, np.inf))

    @property
    def significant(self) -> Array:
        """Whether |t| exceeds the two-sided 5 % limit of Student's t. Same shape."""
        return np.abs(self.t) > stats.t.ppf(1 - ALPHA / 2, self.groups - 1)


def jackknife(left_out: Array, full: Array) -> Jackknife:
    """Return standard errors from fits (G, ...) that leave one group out each.

    s^2 = (G - 1) / G sum_g (b_g - b)^2    (Martens and Martens 2001)
    """
    left_out, full = np.asarray(left_out, float), np.asarray(full, float)
    groups = check_count(len(left_out), 2, 2**62, "groups", "Take more runs.")
    spread = ((left_out - full) ** 2).sum(axis=0)
    errors = np.sqrt((groups - 1) / groups * spread)
    return Jackknife(frozen(full.copy()), frozen(errors), groups)
