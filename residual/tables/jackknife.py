"""How far fitted numbers depend on any one run (jack-knife; paper, section 2.5).

Over random rows every row left out has a neighbour that stays, and almost any cell
looks significant; over runs the motion itself is left out.
"""

from dataclasses import dataclass

import numpy as np
from scipy import stats

from residual.recording import Array
from residual.tables.blocks import check_count, frozen

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
    """Return standard errors from fits that leave one group out each.

    s^2 = (G - 1) / G sum_g (b_g - b)^2    (Martens and Martens 2001)

    Args:
        left_out: Fitted numbers without each group. Shape (G, ...).
        full: The same fitted to all rows. Shape (...).

    Raises:
        InputError: If there are fewer than two groups.
    """
    left_out, full = np.asarray(left_out, float), np.asarray(full, float)
    groups = check_count(len(left_out), 2, 2**62, "groups", "Take more runs.")
    spread = ((left_out - full) ** 2).sum(axis=0)
    errors = np.sqrt((groups - 1) / groups * spread)
    return Jackknife(frozen(full.copy()), frozen(errors), groups)
