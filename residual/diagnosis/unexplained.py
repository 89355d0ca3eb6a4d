"""The residual after the findings: its dependences, its correction, and sentences on it.

The default form of the data-driven tables
(`residual/calibration/correction_choice.py`): nothing, PLSR, least squares, tables,
whichever predicts left-out fit logs best. The variables are the joint's own state and the
variables that its residual was found to depend on. "Nothing" means not correctable from
the state. The held-out logs are not used (G2017 eq. 31, on top of the named effects).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array

from residual.calibration.correction_choice import (
    TrainingRows,
    choose_table_levels,
    fit_chosen_tables,
)
from residual.diagnosis.adequacy import Adequacy, find_motion_period
from residual.diagnosis.outcome import Outcome
from residual.errors import format_joint_numbers
from residual.evidence.columns import label_folds
from residual.evidence.design import Design
from residual.evidence.fit import Fit
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import FindingScatter
from residual.model.lookup import (
    DIFFERENCE,
    CorrectedModel,
    JointCorrection,
    TableVariable,
    compute_table_variables,
)
from residual.model.model import Model
from residual.quantity import convert_to_sliding_unit
from residual.recording import Array
from residual.signals.filters import randomise_phases
from residual.signals.splitting import group_pieces_by_log
from residual.signals.track import Track
from residual.verdict.result import Dependence

# Does a curve of one state variable, fitted to some logs, predict the residual on others?
#
# A nonparametric test after Janot's state-dependent parameters: the residual of a joint is
# averaged in quantile bins of one variable at a time, plain or separately for the two
# directions of motion (friction that depends on the variable), and over the sum and the
# difference of two positions (gearing shared by two wrist joints). Logs, or blocks of one,
# are left out; chance is estimated from surrogates with the same spectrum (phase
# randomization: Theiler et al. 1992, Physica D 58).


BINS = (8, 24, 72)  # from a slope to a ripple; chance is estimated over all of them
DRAWS = 59  # number of surrogates: exceeding all of them has a chance of 1 in 60
MOST_FOLDS = 0.6  # share of left-out folds that must improve (as in the gate)

PLAIN, DIRECTION, SUM = "curve", "by direction", "sum"


@dataclass(frozen=True, eq=False, slots=True)
class StateVariable:
    """A variable that a residual may depend on, on the rows of one joint."""

    on: str  # "q", "qd", "qdd" or "tau" (the model's torque)
    of: tuple[int, ...]  # its joints, from 0
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
        unit = convert_to_sliding_unit(unit) if self.slides else unit
        return f"{sign.join(f'{self.on}{k + 1}' for k in self.of)} [{unit}]"

    def codes(self, bins: int) -> tuple[Array, int]:
        """Cell of each row, and the number of cells."""
        edges = np.quantile(self.values, np.linspace(0, 1, bins + 1)[1:-1])
        codes = np.searchsorted(edges, self.values)
        if self.side is None:
            return codes, bins
        return codes + bins * self.side, 2 * bins


@dataclass(frozen=True, eq=False, slots=True)
class ResidualCurve:
    """A dependence that holds on left-out folds."""

    variable: StateVariable  # its variable
    # Fall of the left-out squared error, as a share of the structured residual.
    share: float
    fitted: Array  # the curve on the rows [N m], (n,)


@dataclass(frozen=True, eq=False, slots=True)
class JointResidual:
    """The residual of one joint on the rows on which that joint moves."""

    residual: Array  # residual [N m], (n,)
    fold: Array  # fold of each row, from 0, (n,)
    log: Array  # log of each row, from 0, increasing, (n,)
    memory: float  # autocorrelation time of the residual, in rows
    power: float  # squared residual beyond the noise, summed over the rows [N^2 m^2]


def fit_residual_curves(
    joint_residual: JointResidual, variables: Sequence[StateVariable]
) -> tuple[list[ResidualCurve], Array]:
    """Add the best curve while one is significant, each fitted to the remaining residual.

    Returns:
        The curves, and the remaining residual [N m]. Shape (n,).
    """
    residual, found_curves = joint_residual.residual, []
    tables = [_CellTable.of(joint_residual, v, bins) for v in variables for bins in BINS]
    while tables and len(found_curves) < THRESHOLDS.max_curves:
        # A mean is no dependence: the part that it explains does not count.
        mean = _CellTable.of(joint_residual, None, 1)
        falls = np.array([t.fall(residual[:, None]) for t in tables])[:, :, 0]
        falls -= mean.fall(residual[:, None])[:, 0]
        gains = falls.sum(axis=1)
        best = int(np.argmax(gains))
        share = gains[best] / max(joint_residual.power, 1e-300)
        if share < THRESHOLDS.min_curve_share or np.mean(falls[best] > 0) < MOST_FOLDS:
            break
        block = draw_surrogate_residuals(joint_residual, residual)
        most = np.max([t.fall(block).sum(axis=0) for t in tables], axis=0)
        most -= mean.fall(block).sum(axis=0)
        if (1 + np.sum(most >= gains[best])) / (1 + DRAWS) > THRESHOLDS.curve_chance:
            break
        fitted = tables[best].curve(residual)
        found_curves.append(ResidualCurve(tables[best].variable, min(float(share), 1.0), fitted))
        residual = residual - fitted
        tables = [t for t in tables if t.variable is not tables[best].variable]
    return found_curves, residual


def draw_surrogate_residuals(rows: JointResidual, residual: Array) -> Array:
    """Surrogate residuals with the same spectrum in every log, independent of the motion.

    Returns:
        Shape (n, DRAWS); the same for the same residual.
    """
    rng = np.random.default_rng(0)
    out = np.empty((len(residual), DRAWS))
    for log in np.unique(rows.log):
        rows_of_log = rows.log == log
        line = residual[rows_of_log] - residual[rows_of_log].mean()
        spectrum = np.repeat(np.fft.rfft(line)[:, None], DRAWS, axis=1)
        out[rows_of_log] = residual[rows_of_log].mean() + randomise_phases(spectrum, len(line), rng)
    return out


@dataclass(frozen=True, eq=False, slots=True)
class _CellTable:
    """Cells of one variable in one width, and their rows."""

    variable: StateVariable | None  # the variable; None for a constant
    codes: Array  # cell of each row, (n,)
    gather: csr_array  # sums rows into (fold, cell), (folds cells, n)
    counts: Array  # rows of each fold and cell, (folds, cells)
    memory: float  # prior weight of a zero mean of a cell, in rows

    @classmethod
    def of(cls, rows: JointResidual, variable: StateVariable | None, bins: int) -> "_CellTable":
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
            block: Residuals side by side. Shape (n, b).

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


PIECE = 20.0  # s: longest interval with an assumed constant phase
PARTS = 5  # blocks of a piece, left out in turn
SLOWEST = 3.0  # least number of periods in a piece
FINE = 0.5  # step of the frequencies, in units of 1 / piece


@dataclass(frozen=True, eq=False, slots=True)
class ResidualTimeSeries:
    """A residual over time."""

    t: Array  # time of each row [s], (n,)
    residual: Array  # residual [N m], (n,)
    log: Array  # log of each row, from 0, (n,)
    power: float  # squared residual beyond the noise, summed over the rows [N^2 m^2]
    cutoff: float  # highest frequency of the search [Hz]


@dataclass(frozen=True, slots=True)
class SpectralLine:
    """A spectral line of a residual."""

    share: float  # fall of the left-out squared error, as a share of the residual
    frequency: float  # [Hz]


def find_spectral_line(series: ResidualTimeSeries) -> SpectralLine | None:
    """Find a frequency that predicts left-out blocks better than red noise does."""
    pieces = _pieces(series)
    span = max(np.ptp(series.t[p]) for p in pieces)
    low, high = SLOWEST / span, series.cutoff
    if not low < high:
        return None
    grid = np.arange(low, high, FINE / span)
    block = np.column_stack([series.residual, _red_noise(series)])
    fall, chosen = _left_out_line(series, pieces, grid, block)
    total = fall.sum(axis=0)
    chance = np.mean(np.append(total[1:], np.inf) >= total[0])
    share = total[0] / max(series.power, 1e-300)
    logs = np.array([series.log[p[0]] for p in pieces])
    if (
        share < THRESHOLDS.min_curve_share
        or chance > THRESHOLDS.curve_chance
        or np.mean([fall[logs == k, 0].sum() > 0 for k in np.unique(logs)]) < MOST_FOLDS
    ):
        return None
    return SpectralLine(min(float(share), 1.0), float(grid[chosen]))


def _pieces(line: ResidualTimeSeries) -> list[Array]:
    """Rows of each log, in pieces of 20 s or less."""
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
    line: ResidualTimeSeries, pieces: list[Array], grid: Array, block: Array
) -> tuple[Array, int]:
    """Fall of the squared error of every piece, and the best frequency of all rows.

    In each round one block of each piece is left out; the frequency is the best for the
    other blocks of all pieces, with a separate phase per piece.

    Returns:
        Shape (pieces, b), and an index into the grid.
    """
    sums = [_sums(line.t[p], block[p], grid) for p in pieces]
    falls = np.zeros((len(pieces), block.shape[1]))
    for out in range(PARTS):
        train = [(g.sum(0) - g[out], c.sum(0) - c[out]) for g, c in sums]
        fits = [_amplitudes(g, c) for g, c in train]
        served = sum(
            np.einsum("ifb,ifb->fb", theta, c) for theta, (_, c) in zip(fits, train, strict=True)
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
    """Amplitudes of cosine and sine, regularized by one per cent. (2, f, b)."""
    size = 0.01 * np.trace(gram, axis1=1, axis2=2) / 2 + 1e-12
    inverse = np.linalg.inv(gram + size[:, None, None] * np.eye(2))
    return np.einsum("fij,jfb->ifb", inverse, cross)


def _red_noise(line: ResidualTimeSeries) -> Array:
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


REPEATABLE, TIME_DRIVEN = "repeatable", "time-driven"


# The residual after the findings: its dependences, joint by joint.
#
# States come first (`curves`), since a function of the motion oscillates with it; a wave
# in time is searched in the remaining residual (`find_spectral_line`). Only dependences
# that are significant on left-out rows are reported.


@dataclass(frozen=True, eq=False, slots=True)
class JointRemainder:
    """The residual of one joint after the findings, on the rows on which it moves."""

    joint: int  # from 0
    # State variables that predict it on left-out folds, best first.
    curves: tuple[ResidualCurve, ...]
    wave: SpectralLine | None  # a spectral line of the residual after the curves
    kind: str | None  # "repeatable", "time-driven", or None if unknown
    cloud: FindingScatter  # residual over the variable that it depends on most


def list_dependences(remainders: Sequence[JointRemainder]) -> tuple[Dependence, ...]:
    """The dependences of each joint's residual, the largest share of a joint first."""
    out = []
    for leftover in remainders:
        joint, entries = leftover.joint + 1, []
        for c in leftover.curves:
            v = c.variable
            of = tuple(k + 1 for k in v.of)
            entries.append(Dependence(joint, v.on, of, v.form, c.share, None))
        if (wave := leftover.wave) is not None:
            entries.append(Dependence(joint, "frequency", (), PLAIN, wave.share, wave.frequency))
        out += sorted(entries, key=lambda entry: -entry.share)
    return tuple(out)


def analyze_joint_remainders(
    design: Design, tracks: Sequence[Track], fitted: Fit, adequacy: Adequacy
) -> tuple[JointRemainder, ...]:
    """Analyze every joint with a residual above noise."""
    out, folds = [], label_folds(tracks)
    for j in adequacy.doubted:
        residual = design.residual(j, fitted.ids, fitted.theta)
        power = (adequacy.structured_share[j] * design.rms[j]) ** 2 * len(residual)
        log = _stack(tracks, j, [np.full(len(t.tau), k) for k, t in enumerate(tracks)])
        rows = JointResidual(
            residual, _stack(tracks, j, folds), log, design.rows[j] / fitted.counted[j], power
        )
        found_curves, remaining = fit_residual_curves(rows, _variables(design, tracks, j))
        times = [s.t[:: t.step] for s, t in zip(design.states, tracks, strict=True)]
        cutoff = min(t.cutoff for t in tracks)
        line = ResidualTimeSeries(_stack(tracks, j, times), remaining, log, power, cutoff)
        wave = find_spectral_line(line)
        kind = _kind(adequacy.kind[j], found_curves, wave, tracks)
        # Over the variable that it depends on most, else over time.
        x, y, drawn, label = line.t, residual, np.zeros(len(line.t)), "t [s]"
        if found_curves and (wave is None or found_curves[0].share >= wave.share):
            x, drawn = found_curves[0].variable.values, found_curves[0].fitted
            label = found_curves[0].variable.label
        elif wave is not None:
            y = line.residual
            x, drawn = _folded(line, wave.frequency)
            label = f"turns of {wave.frequency:.3g} Hz"
        names = np.array([t.id for t in tracks])
        cloud = FindingScatter("", j + 1, label, x, y, drawn, names[log])
        out.append(JointRemainder(j, tuple(found_curves), wave, kind, cloud))
    return tuple(out)


def _variables(design: Design, tracks: Sequence[Track], j: int) -> list[StateVariable]:
    """Variables of a joint's residual: its state, its load, other joints."""

    def read(name: str) -> list[Array]:
        """Values of every joint on the rows of this one."""
        states = zip(design.states, tracks, strict=True)
        lines = [getattr(s, name)[:: t.step] for s, t in states]
        return list(_stack(tracks, j, lines).T)

    q, qd, qdd, tau = map(read, ("q", "qd", "qdd", "tau_model"))
    side = (qd[j] > 0).astype(int)
    own = [("q", q[j]), ("qdd", qdd[j]), ("tau", tau[j])]
    out = [StateVariable("qd", (j,), PLAIN, qd[j])]
    out += [StateVariable(on, (j,), PLAIN, x) for on, x in own]
    out += [StateVariable(on, (j,), DIRECTION, x, side) for on, x in own]
    for k in range(design.dof):
        if k != j:
            out += [
                StateVariable(on, (k,), PLAIN, x[k])
                for on, x in (("q", q), ("qd", qd), ("qdd", qdd))
            ]
            out.append(StateVariable("q", (j, k), SUM, q[j] + q[k]))
            out.append(StateVariable("q", (j, k), DIFFERENCE, q[j] - q[k]))
    slides = design.states[0].robot.prismatic
    return [
        replace(v, slides=slides[v.of[0]])
        for v in out
        # An angle and a length have no sum.
        if np.ptp(v.values) > 0 and len({slides[k] for k in v.of}) == 1
    ]


def _kind(
    repeats: str | None,
    curves_found: Sequence[ResidualCurve],
    wave: SpectralLine | None,
    tracks: Sequence[Track],
) -> str | None:
    """Return "repeatable" if left-out logs are predicted from the state, else by time.

    For a periodic motion, the part that does not repeat decides. A line common to logs
    of different motion follows time, even if it fits a harmonic of one motion: in other
    logs it is no harmonic.
    """
    if wave is None or sum(c.share for c in curves_found) >= wave.share:
        return repeats or (REPEATABLE if curves_found else None)
    turns = [
        wave.frequency * period * track.step / track.rate
        for track in tracks
        if (period := find_motion_period(track)) is not None
    ]
    free = len(turns) < len(tracks) or any(
        abs(x - round(x)) > THRESHOLDS.off_harmonic_turns for x in turns
    )
    return TIME_DRIVEN if len(tracks) > 1 and free else repeats


def _folded(line: ResidualTimeSeries, frequency: float) -> tuple[Array, Array]:
    """Phase of a wave from its crest in each log, in turns, and its fit to all logs [N m]."""
    turns = line.t * frequency
    for log in np.unique(line.log):
        own = line.log == log
        wave = line.residual[own] @ np.exp(2j * np.pi * turns[own])
        turns[own] -= np.angle(wave) / (2 * np.pi)
    wave = np.cos(2 * np.pi * turns)
    return turns % 1, wave * (wave @ line.residual) / (wave @ wave)


def _stack(tracks: Sequence[Track], j: int, lines: Sequence[Array]) -> Array:
    pairs = zip(tracks, lines, strict=True)
    return np.concatenate([x[t.moving[:, j]] for t, x in pairs])


MOST_ROWS = 12_000  # more rows of the same logs only take more time


def fit_correction(
    model: Model, tracks: Sequence[Track], remainders: Sequence[JointRemainder]
) -> CorrectedModel | None:
    """Fit the correction to the residual of a model on the fit logs.

    Returns:
        None if no joint moves enough for a test on left-out logs or blocks.
    """
    if not remainders:
        return None
    states = [model.observe(t) for t in tracks]
    torque = [model.torque_of_state(s) for s in states]
    logs = list(zip(tracks, states, torque, strict=True))
    tables = [_tables(logs, one) for one in remainders]
    kept = tuple(t for t in tables if t is not None)
    return CorrectedModel(model, kept) if kept else None


def _tables(logs, leftover: JointRemainder) -> JointCorrection | None:
    j = leftover.joint
    columns = _columns(leftover)
    X, Y, tau, second, seconds = [], [], [], [], 0
    for track, state, torque in logs:
        rows = slice(None, None, track.step)
        load = track.filter(torque[:, j])[track.valid]
        X.append(np.column_stack(compute_table_variables(state, columns))[rows][track.valid])
        tau.append(track.tau[track.valid, j])
        Y.append(tau[-1] - load)
        t = track.t[rows][: len(track.valid)][track.valid]
        second.append(seconds + (t - track.t[0]).astype(int))
        seconds = 1 + max(seconds, int(second[-1].max(initial=0)))
    fold = _folds([track for track, _, _ in logs])
    thin = slice(None, None, 1 + len(fold) // MOST_ROWS)
    X, Y, tau, second = (np.concatenate(part)[thin] for part in (X, Y, tau, second))
    # Every variable must vary in all folds except any one.
    folds = np.unique(fold[thin])
    spread = [np.ptp(X[fold[thin] != f], axis=0) for f in folds]
    if len(folds) < 2 or not (np.array(spread) > 1e-9).all():
        return None
    loads = (tau - Y)[:, None]
    names = [f"{on}{'-' if f == DIFFERENCE else '+'}{of}" for on, of, f in columns]
    speeds = [i for i, (on, _, _) in enumerate(columns) if on == "qd"]
    tables = choose_table_levels(X, loads, (0,), (*names, "load"), speeds)
    Z = tables.encode(X, loads)
    training = TrainingRows(X, Y[:, None], tau[:, None], second, Z)
    lookup, (option,) = fit_chosen_tables(training, fold[thin], tables)
    return JointCorrection(j, columns, lookup, option.kind)


def _folds(tracks: Sequence[Track]) -> Array:
    """Log of each row; blocks if there is a single log.

    Blocks of one log are adjacent, and a table may memorize the path: a second log is a
    better test.
    """
    logs = group_pieces_by_log([t.id for t in tracks])
    if len(logs) > 1:
        of = {i: k for k, pieces in enumerate(logs) for i in pieces}
        labels = [np.full(len(t.tau), of[i]) for i, t in enumerate(tracks)]
    else:
        labels = label_folds(tracks)
    return np.concatenate([f[t.valid] for f, t in zip(labels, tracks, strict=True)])


def _columns(leftover: JointRemainder) -> tuple[TableVariable, ...]:
    """Own speed, position and acceleration, then the variables of the curves."""
    state_columns = [(on, (leftover.joint,), "") for on in ("qd", "q", "qdd")]
    used = {(on, of) for on, of, _ in state_columns}
    variables = [c.variable for c in leftover.curves if c.variable.on != "tau"]
    more = [(v.on, v.of, v.form) for v in variables if (v.on, v.of) not in used]
    return tuple(state_columns + more)


@dataclass(frozen=True, eq=False, slots=True)
class UnexplainedAnalysis:
    """The analysis of the residual."""

    joints: tuple[JointRemainder, ...]  # one entry per unexplained joint
    # The model with a statistical correction; None without a residual, or if no joint
    # can be tested.
    correction: CorrectedModel | None
    sentences: tuple[str, ...]  # sentences


def analyze_unexplained(outcome: Outcome, fitted: Fit, augmented: Model) -> UnexplainedAnalysis:
    """Analyze the residual of the findings on the fit logs, without held-out logs."""
    adequacy, tracks = outcome.adequacy, outcome.logs.tracks
    found = analyze_joint_remainders(outcome.design, tracks, fitted, adequacy)
    correction = fit_correction(augmented, tracks, found)
    sentences = ()
    if correction is not None and correction.uncorrected_joints:
        on = format_joint_numbers([j + 1 for j in correction.uncorrected_joints])
        sentences = (
            f"{on}: not correctable from state: tables of position, speed, "
            "acceleration and load do not help on logs left out",
        )
    return UnexplainedAnalysis(found, correction, sentences)
