"""Does a curve of one state variable, drawn on some logs, predict a leftover on others?

A nonparametric look after Janot's state-dependent parameters: the leftover of a joint
is averaged in quantile bins of one variable at a time, plain or apart for the two
directions of motion (friction that depends on the variable), and over the sum and the
difference of two positions (what two joints share in a wrist). Whole logs, or blocks of
one, are left out; chance is drawn with the leftover's own spectrum (phase
randomisation: Theiler et al. 1992, Physica D 58).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from residual.model.corrected import DIFFERENCE
from residual.recording import Array
from residual.tables.components import randomise_phases

BINS = (8, 24, 72)  # from a slope to a ripple; the chance is drawn over all of them
DRAWS = 59  # surrogates: the best of them is a chance of 1 in 60
CHANCE = 0.05
MOST_FOLDS = 0.6  # share of left-out folds that must improve (as in the gate)
LEAST = 0.1  # share of the leftover under which a curve is not worth telling
MOST = 3  # curves per joint

PLAIN, DIRECTION, SUM = "curve", "by direction", "sum"


@dataclass(frozen=True, eq=False, slots=True)
class Variable:
    """Something that a leftover may depend on, on the rows of one joint.

    Attributes:
        on: "q", "qd", "qdd" or "tau" (the model's torque).
        of: Joints that it belongs to, from 0.
        form: One of the four constants of this module.
        values: Shape (n,).
        side: Direction of motion of the joint, 0 or 1; None where it does not matter.
            Shape (n,).
    """

    on: str
    of: tuple[int, ...]
    form: str
    values: Array
    side: Array | None = None

    @property
    def label(self) -> str:
        """Its name with the unit, for an axis: "q4 + q5 [rad]"."""
        sign = " - " if self.form == DIFFERENCE else " + "
        unit = {"q": "rad", "qd": "rad/s", "qdd": "rad/s²", "tau": "N m"}[self.on]
        return f"{sign.join(f'{self.on}{k + 1}' for k in self.of)} [{unit}]"

    def codes(self, bins: int) -> tuple[Array, int]:
        """Cell of each row, and the number of cells."""
        edges = np.quantile(self.values, np.linspace(0, 1, bins + 1)[1:-1])
        codes = np.searchsorted(edges, self.values)
        if self.side is None:
            return codes, bins
        return codes + bins * self.side, 2 * bins


@dataclass(frozen=True, eq=False, slots=True)
class Curve:
    """A dependence that holds on left-out folds.

    Attributes:
        variable: What it is over.
        share: Fall of the left-out squared error, as a share of the structured
            leftover.
        fitted: The curve on the rows [N m]. Shape (n,).
    """

    variable: Variable
    share: float
    fitted: Array


@dataclass(frozen=True, eq=False, slots=True)
class Rows:
    """The leftover of one joint on the rows on which that joint moves.

    Attributes:
        left: Leftover [N m]. Shape (n,).
        fold: Fold of each row, from 0. Shape (n,).
        log: Log of each row, from 0, increasing. Shape (n,).
        memory: Rows after which the leftover forgets itself (autocorrelation time).
        power: Squared leftover beyond the noise, summed over the rows [N^2 m^2].
    """

    left: Array
    fold: Array
    log: Array
    memory: float
    power: float


def curves(rows: Rows, variables: Sequence[Variable]) -> tuple[list[Curve], Array]:
    """Take the best curve while one beats chance; each is drawn on what is left.

    Returns:
        The curves, and what they leave [N m]. Shape (n,).
    """
    left, found = rows.left, []
    tables = [_Table.of(rows, v, bins) for v in variables for bins in BINS]
    while tables and len(found) < MOST:
        # A mean is no dependence: what it explains is no curve's merit.
        mean = _Table.of(rows, None, 1)
        falls = np.array([t.fall(left[:, None]) for t in tables])[:, :, 0]
        falls -= mean.fall(left[:, None])[:, 0]
        gains = falls.sum(axis=1)
        best = int(np.argmax(gains))
        share = gains[best] / max(rows.power, 1e-300)
        if share < LEAST or np.mean(falls[best] > 0) < MOST_FOLDS:
            break
        block = surrogates(rows, left)
        most = np.max([t.fall(block).sum(axis=0) for t in tables], axis=0)
        most -= mean.fall(block).sum(axis=0)
        if (1 + np.sum(most >= gains[best])) / (1 + DRAWS) > CHANCE:
            break
        fitted = tables[best].curve(left)
        found.append(Curve(tables[best].variable, min(float(share), 1.0), fitted))
        left = left - fitted
        tables = [t for t in tables if t.variable is not tables[best].variable]
    return found, left


def surrogates(rows: Rows, left: Array) -> Array:
    """Leftovers of the same spectrum in every log that know nothing of the motion.

    Returns:
        Shape (n, DRAWS); the same for the same leftover.
    """
    rng = np.random.default_rng(0)
    out = np.empty((len(left), DRAWS))
    for log in np.unique(rows.log):
        own = rows.log == log
        line = left[own] - left[own].mean()
        spectrum = np.repeat(np.fft.rfft(line)[:, None], DRAWS, axis=1)
        out[own] = left[own].mean() + randomise_phases(spectrum, len(line), rng)
    return out


@dataclass(frozen=True, eq=False, slots=True)
class _Table:
    """Cells of one variable in one width, and who is in them.

    Attributes:
        variable: The variable; None for a constant.
        codes: Cell of each row. Shape (n,).
        gather: Sums rows into (fold, cell). Shape (folds cells, n).
        counts: Rows of each fold and cell. Shape (folds, cells).
        memory: Weight of the belief that a cell's mean is zero, in rows.
    """

    variable: Variable | None
    codes: Array
    gather: csr_array
    counts: Array
    memory: float

    @classmethod
    def of(cls, rows: Rows, variable: Variable | None, bins: int) -> "_Table":
        """Sort the rows into cells."""
        n, folds = len(rows.left), int(rows.fold.max()) + 1
        codes, cells = np.zeros(n, dtype=int), 1
        if variable is not None:
            codes, cells = variable.codes(bins)
        place = rows.fold * cells + codes
        shape = (folds * cells, n)
        gather = csr_array((np.ones(n), (place, np.arange(n))), shape=shape)
        counts = np.bincount(place, minlength=folds * cells).reshape(folds, cells)
        return cls(variable, codes, gather, counts.astype(float), rows.memory)

    def fall(self, block: Array) -> Array:
        """Fall of each fold's squared error by the curve of the other folds.

        Args:
            block: Leftovers side by side. Shape (n, b).

        Returns:
            Shape (folds, b).
        """
        sums = (self.gather @ block).reshape(*self.counts.shape, -1)
        others = sums.sum(axis=0) - sums
        rows = self.counts.sum(axis=0) - self.counts + self.memory
        mean = others / rows[:, :, None]
        return (2 * mean * sums - mean**2 * self.counts[:, :, None]).sum(axis=1)

    def curve(self, left: Array) -> Array:
        """The curve of all folds on the rows [N m]. Shape (n,)."""
        sums = np.bincount(self.codes, left, minlength=self.counts.shape[1])
        return (sums / (self.counts.sum(axis=0) + self.memory))[self.codes]
