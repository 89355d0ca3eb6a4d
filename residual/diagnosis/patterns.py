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

from residual.evidence.thresholds import THRESHOLDS
from residual.model.lookup import DIFFERENCE
from residual.quantity import along
from residual.recording import Array
from residual.signals.filters import randomise_phases

BINS = (8, 24, 72)  # from a slope to a ripple; the chance is drawn over all of them
DRAWS = 59  # surrogates: the best of them is a chance of 1 in 60
MOST_FOLDS = 0.6  # share of left-out folds that must improve (as in the gate)

PLAIN, DIRECTION, SUM = "curve", "by direction", "sum"


@dataclass(frozen=True, eq=False, slots=True)
class Variable:
    """Something that a leftover may depend on, on the rows of one joint."""

    on: str  # "q", "qd", "qdd" or "tau" (the model's torque)
    of: tuple[int, ...]  # joints that it belongs to, from 0
    form: str  # one of the four constants of this module
    values: Array  # , (n,)
    # Direction of motion of the joint, 0 or 1; None where it does not matter, (n,).
    side: Array | None = None
    slides: bool = False  # whether those joints move along their axis

    @property
    def label(self) -> str:
        """Its name with the unit, for an axis: "q4 + q5 [rad]"."""
        sign = " - " if self.form == DIFFERENCE else " + "
        unit = {"q": "rad", "qd": "rad/s", "qdd": "rad/s²", "tau": "N m"}[self.on]
        unit = along(unit) if self.slides else unit
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
    """A dependence that holds on left-out folds."""

    variable: Variable  # what it is over
    # Fall of the left-out squared error, as a share of the structured leftover.
    share: float
    fitted: Array  # the curve on the rows [N m], (n,)


@dataclass(frozen=True, eq=False, slots=True)
class JointResidual:
    """The leftover of one joint on the rows on which that joint moves."""

    residual: Array  # leftover [N m], (n,)
    fold: Array  # fold of each row, from 0, (n,)
    log: Array  # log of each row, from 0, increasing, (n,)
    memory: float  # rows after which the leftover forgets itself (autocorrelation time)
    power: float  # squared leftover beyond the noise, summed over the rows [N^2 m^2]


def curves(
    rows: JointResidual, variables: Sequence[Variable]
) -> tuple[list[Curve], Array]:
    """Take the best curve while one beats chance; each is drawn on what is left.

    Returns:
        The curves, and what they leave [N m]. Shape (n,).
    """
    residual, found_curves = rows.residual, []
    tables = [_CellTable.of(rows, v, bins) for v in variables for bins in BINS]
    while tables and len(found_curves) < THRESHOLDS.max_curves:
        # A mean is no dependence: what it explains is no curve's merit.
        mean = _CellTable.of(rows, None, 1)
        falls = np.array([t.fall(residual[:, None]) for t in tables])[:, :, 0]
        falls -= mean.fall(residual[:, None])[:, 0]
        gains = falls.sum(axis=1)
        best = int(np.argmax(gains))
        share = gains[best] / max(rows.power, 1e-300)
        if share < THRESHOLDS.min_curve_share or np.mean(falls[best] > 0) < MOST_FOLDS:
            break
        block = surrogates(rows, residual)
        most = np.max([t.fall(block).sum(axis=0) for t in tables], axis=0)
        most -= mean.fall(block).sum(axis=0)
        if (1 + np.sum(most >= gains[best])) / (1 + DRAWS) > THRESHOLDS.curve_chance:
            break
        fitted = tables[best].curve(residual)
        found_curves.append(
            Curve(tables[best].variable, min(float(share), 1.0), fitted)
        )
        residual = residual - fitted
        tables = [t for t in tables if t.variable is not tables[best].variable]
    return found_curves, residual


def surrogates(rows: JointResidual, residual: Array) -> Array:
    """Leftovers of the same spectrum in every log that know nothing of the motion.

    Returns:
        Shape (n, DRAWS); the same for the same leftover.
    """
    rng = np.random.default_rng(0)
    out = np.empty((len(residual), DRAWS))
    for log in np.unique(rows.log):
        rows_of_log = rows.log == log
        line = residual[rows_of_log] - residual[rows_of_log].mean()
        spectrum = np.repeat(np.fft.rfft(line)[:, None], DRAWS, axis=1)
        out[rows_of_log] = residual[rows_of_log].mean() + randomise_phases(
            spectrum, len(line), rng
        )
    return out


@dataclass(frozen=True, eq=False, slots=True)
class _CellTable:
    """Cells of one variable in one width, and who is in them."""

    variable: Variable | None  # the variable; None for a constant
    codes: Array  # cell of each row, (n,)
    gather: csr_array  # sums rows into (fold, cell), (folds cells, n)
    counts: Array  # rows of each fold and cell, (folds, cells)
    memory: float  # weight of the belief that a cell's mean is zero, in rows

    @classmethod
    def of(
        cls, rows: JointResidual, variable: Variable | None, bins: int
    ) -> "_CellTable":
        """Sort the rows into cells."""
        n, folds = len(rows.residual), int(rows.fold.max()) + 1
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

    def curve(self, residual: Array) -> Array:
        """The curve of all folds on the rows [N m]. Shape (n,)."""
        sums = np.bincount(self.codes, residual, minlength=self.counts.shape[1])
        return (sums / (self.counts.sum(axis=0) + self.memory))[self.codes]


PIECE = 20.0  # s: longest stretch over which a phase is believed to hold
PARTS = 5  # of a piece, left out in turn
SLOWEST = 3.0  # periods that a piece must hold at least
FINE = 0.5  # step of the frequencies, in units of 1 / piece


@dataclass(frozen=True, eq=False, slots=True)
class TimeLine:
    """A leftover on its time line."""

    t: Array  # time of each row [s], (n,)
    residual: Array  # leftover [N m], (n,)
    log: Array  # log of each row, from 0, (n,)
    power: float  # squared leftover beyond the noise, summed over the rows [N^2 m^2]
    cutoff: float  # highest frequency to look at [Hz]


@dataclass(frozen=True, slots=True)
class Wave:
    """A spectral line of a leftover."""

    share: float  # fall of the left-out squared error, as a share of the leftover
    frequency: float  # [Hz]


def wave_of(line: TimeLine) -> Wave | None:
    """A frequency that predicts left-out blocks, beyond red noise that does not."""
    pieces = _pieces(line)
    span = max(np.ptp(line.t[p]) for p in pieces)
    low, high = SLOWEST / span, line.cutoff
    if not low < high:
        return None
    grid = np.arange(low, high, FINE / span)
    block = np.column_stack([line.residual, _red_noise(line)])
    fall, chosen = _left_out_line(line, pieces, grid, block)
    total = fall.sum(axis=0)
    chance = np.mean(np.append(total[1:], np.inf) >= total[0])
    share = total[0] / max(line.power, 1e-300)
    logs = np.array([line.log[p[0]] for p in pieces])
    if (
        share < THRESHOLDS.min_curve_share
        or chance > THRESHOLDS.curve_chance
        or np.mean([fall[logs == k, 0].sum() > 0 for k in np.unique(logs)]) < MOST_FOLDS
    ):
        return None
    return Wave(min(float(share), 1.0), float(grid[chosen]))


def _pieces(line: TimeLine) -> list[Array]:
    """Rows of each log, in stretches of 20 s or less."""
    out = []
    for log in np.unique(line.log):
        rows = np.flatnonzero(line.log == log)
        count = max(1, int(np.ceil(np.ptp(line.t[rows]) / PIECE)))
        at = (line.t[rows] - line.t[rows[0]]) / max(np.ptp(line.t[rows]), 1e-9)
        part = np.minimum((at * count).astype(int), count - 1)
        own = [rows[part == k] for k in range(count)]
        out += [r for r in own if len(r) >= 10 * PARTS]
    return out or [np.arange(len(line.t))]


def _left_out_line(
    line: TimeLine, pieces: list[Array], grid: Array, block: Array
) -> tuple[Array, int]:
    """Fall of the squared error of every piece, and the frequency all rows choose.

    For every turn one block of each piece is left out; the frequency is the one that
    serves the other blocks of all pieces best, the phase each piece's own.

    Returns:
        Shape (pieces, b), and an index into the grid.
    """
    sums = [_sums(line.t[p], block[p], grid) for p in pieces]
    falls = np.zeros((len(pieces), block.shape[1]))
    for out in range(PARTS):
        train = [(g.sum(0) - g[out], c.sum(0) - c[out]) for g, c in sums]
        fits = [_amplitudes(g, c) for g, c in train]
        served = sum(
            np.einsum("ifb,ifb->fb", theta, c)
            for theta, (_, c) in zip(fits, train, strict=True)
        )
        best = np.argmax(served, axis=0)
        every = np.arange(block.shape[1])
        for k, (theta, (g, c)) in enumerate(zip(fits, sums, strict=True)):
            own, gram, cross = theta[:, best, every], g[out][best], c[out]
            bend = np.einsum("ib,bij,jb->b", own, gram, own)
            falls[k] += 2 * (own * cross[:, best, every]).sum(0) - bend
    whole = [(g.sum(0), c.sum(0)[:, :, :1]) for g, c in sums]
    served = sum((_amplitudes(g, c) * c).sum(axis=(0, 2)) for g, c in whole)
    return falls, int(np.argmax(served))


def _sums(t: Array, block: Array, grid: Array) -> tuple[Array, Array]:
    """Gram and cross products of cosine and sine in each part of a piece.

    Returns:
        Shapes (parts, f, 2, 2) and (parts, 2, f, b).
    """
    angle = 2 * np.pi * np.outer(t - t[0], grid)
    waves = np.stack([np.cos(angle), np.sin(angle)])
    grams, crosses = [], []
    for rows in np.array_split(np.arange(len(t)), PARTS):
        own = waves[:, rows]
        grams.append(np.einsum("irf,jrf->fij", own, own))
        crosses.append(own.transpose(0, 2, 1) @ block[rows])
    return np.array(grams), np.array(crosses)


def _amplitudes(gram: Array, cross: Array) -> Array:
    """Amplitudes of cosine and sine, stiffened by one part in a hundred. (2, f, b)."""
    size = 0.01 * np.trace(gram, axis1=1, axis2=2) / 2 + 1e-12
    inverse = np.linalg.inv(gram + size[:, None, None] * np.eye(2))
    return np.einsum("fij,jfb->ifb", inverse, cross)


def _red_noise(line: TimeLine) -> Array:
    """Noise with the residual's variance and lag-1 correlation. (n, DRAWS)."""
    rng = np.random.default_rng(0)
    left = line.residual - line.residual.mean()
    near = (np.diff(line.log) == 0) & (np.diff(line.t) < 2 * np.median(np.diff(line.t)))
    a = float(left[1:][near] @ left[:-1][near] / max(left @ left, 1e-300))
    a = min(max(a, 0.0), 0.9999)
    out = rng.normal(size=(len(left), DRAWS))
    scale = np.sqrt(1 - a**2)
    for i in range(1, len(out)):
        out[i] = a * out[i - 1] + scale * out[i]
    return out * left.std()
