"""Rows for the data-driven correction: states X, residual Y, torque Y*.

Two modes. The paper's: X(t) is the reference of joints 1 to 3 with its derivatives,
Y(t + 1) the torque of the arm minus that of its simulated twin (section 2.4). Ours: X
is the measured motion of all joints, Y the residual of a nominal model that was
identified without the held-out runs.

With few runs, blocks within them are left out. Of three runs one can be left out, but
then only two remain to choose tables, and two agree by chance. Consecutive blocks of each
run are more, but weaker evidence: the other blocks of the run share the motion, the
temperature of the drives and the payload.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from residual.errors import InputError
from residual.model.model import Model
from residual.quantity import (
    check_block,
    check_column_names,
    check_count,
    check_varying,
    make_read_only,
)
from residual.recording import Array, Recording
from residual.signals.filters import randomise_phases
from residual.signals.splitting import slice_recording
from residual.signals.track import FilterSettings, Track, estimate_sample_rate, interpolate_signals

BLOCKS = 4  # of a run
FEW = 4  # least number of runs of which three remain when one is left out
GUARD = 0.25  # s, next to a left-out block: filters and friction have memory
PAPER, MEASURED = "paper", "measured"
PAPER_JOINTS = 3  # section 2.4 of the paper
PAPER_HZ, MEASURED_HZ = 125.0, 60.0  # a higher rate repeats rows and changes nothing
_ENOUGH = 10  # least number of moving rows per variable
PARTS = 5  # of a single log
MOST = 900.0  # s of logs in all


def name_state_columns(joints: Sequence[int]) -> tuple[str, ...]:
    """Names of the columns of X for joints counted from 1 (paper, eq. 13 and 28)."""
    return tuple(f"{kind}{j}" for kind in ("q", "qd", "qdd") for j in joints)


@dataclass(frozen=True, eq=False, slots=True)
class RunBlocks:
    """Blocks of all runs, numbered consecutively; each row has a place in one.

    A place is 3 times the block's number, and 0, 1 or 2 for rows close to the block
    before, to none and to the block after.
    """

    cut_times: tuple[Array, ...]  # edges of the blocks of each run, on the log's own clock [s]

    @property
    def runs(self) -> Array:
        """Run of each block."""
        return np.repeat(np.arange(len(self.cut_times)), [len(c) + 1 for c in self.cut_times])

    def places(self, run: int, t: Array) -> Array:
        """Place of rows of a run, at times on the log's own clock [s]. Shape (n,)."""
        cuts = self.cut_times[run]
        begin, end = np.r_[-np.inf, cuts], np.r_[cuts, np.inf]
        block = np.searchsorted(cuts, t, side="right")
        first = int(np.searchsorted(self.runs, run))
        beside = (t >= end[block] - GUARD).astype(int) - (t < begin[block] + GUARD)
        return 3 * (first + block) + 1 + beside

    def kept(self, left_out: Collection[int]) -> Array:
        """Return the places outside of the left-out blocks and not close to them."""
        gone, runs = np.isin(np.arange(len(self.runs)), list(left_out)), self.runs
        same = runs[1:] == runs[:-1]
        before = np.r_[False, gone[:-1] & same]
        after = np.r_[gone[1:] & same, False]
        free = ~np.column_stack([gone | before, gone, gone | after])
        return np.flatnonzero(free.ravel())

    def mask_kept_rows(self, places: Array, left_out: Collection[int]) -> Array:
        """Return which rows remain when some blocks are left out. Shape (n,), bool."""
        return np.isin(places, self.kept(left_out))


def cut_runs_into_blocks(times: Sequence[Array]) -> RunBlocks:
    """Cut every run into blocks with equal numbers of rows, given their times [s]."""
    inner = [t[np.arange(1, BLOCKS) * len(t) // BLOCKS] for t in times]
    return RunBlocks(tuple(map(make_read_only, inner)))


def compute_row_times(track: Track) -> Array:
    """Times of a track's rows on the log's own clock [s]. Shape (m,)."""
    return track.t[:: track.step][: len(track.tau)]


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationRun:
    """One log of a calibration, with its family and twin.

    Attributes:
        log: The measured log.
        family: Kind of motion, None if unknown.
        twin: Errors against the simulated twin, by name. Shapes (n, dof).
    """

    log: Recording
    family: str | None = None
    twin: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class CalibrationRows:
    """Rows of all runs, stacked.

    Attributes:
        mode: "paper" or "measured".
        joints: Joints of Y, from 1.
        names: Columns of X, as q1, qd1, qdd1.
        X: States [rad, rad/s, rad/s^2]. Shape (n, d).
        Y: Residual of the model [N m]. Shape (n, j).
        tau: Measured torque Y* [N m]. Shape (n, j).
        run: Number of the run of each row. Shape (n,).
        labels: Name of each run.
        families: Kind of motion of each run; "" if unknown.
        rates: Rows per second of each run [Hz].
        blocks: Blocks of the runs.
        place: Place of each row in the blocks. Shape (n,).
        moving: Whether a joint moves on a row, so that it counts. Shape (n, j), bool.
    """

    mode: str
    joints: tuple[int, ...]
    names: tuple[str, ...]
    X: Array
    Y: Array
    tau: Array
    run: Array
    labels: tuple[str, ...]
    families: tuple[str, ...]
    rates: tuple[float, ...]
    blocks: RunBlocks
    place: Array
    moving: Array

    @property
    def velocity_columns(self) -> tuple[int, ...]:
        """Columns of X that hold velocities."""
        third = len(self.names) // 3
        return tuple(range(third, 2 * third))

    @property
    def second(self) -> Array:
        """Second of its run of each row, numbered over all runs. (n,)."""
        out, start = np.zeros(len(self.run), int), 0
        for number, rate in enumerate(self.rates):
            in_run = self.run == number
            out[in_run] = start + (np.arange(in_run.sum()) / rate).astype(int)
            start = out[in_run].max(initial=start) + 1
        return out


def build_paper_rows(
    runs: Sequence[CalibrationRun], joints: Sequence[int] | None = None, thinning_factor: int = 1
) -> CalibrationRows:
    """Return the rows of the paper: X of the reference, Y the twin's error one ahead.

    For given joints (from 1), or the paper's first three.
    """
    for run in runs:
        lacks = [] if run.log.q_ref is not None else ["reference (q_ref)"]
        lacks += [] if "e_tau" in run.twin else ["torque of a simulated twin (e_tau)"]
        if lacks:
            raise InputError(
                f"--paper: {run.log.id} has no {' and no '.join(lacks)}. Take runs "
                "that modelgap experiment made or logs with q_ref1 and so on, or leave "
                "--paper out."
            )
    joints = _joints(joints, runs[0].log.dof, PAPER_JOINTS)
    columns = [j - 1 for j in joints]
    parts, rates = [], []
    for run in runs:
        log, rate = run.log, estimate_sample_rate(run.log.t)
        q = log.q_ref[:, columns]
        qd = np.gradient(q, log.t, axis=0)
        X = np.hstack([q, qd, np.gradient(qd, log.t, axis=0)])
        both = np.hstack([run.twin["e_tau"][:, columns], log.tau[:, columns]])
        step = thinning_factor * _step(rate, PAPER_HZ)
        ahead = np.hsplit(np.ascontiguousarray(both[1:])[::step], 2)
        now = np.ascontiguousarray(X[:-1])[::step]
        everywhere = np.ones(ahead[0].shape, bool)
        parts.append((now, *ahead, everywhere, log.t[:-1:step]))
        rates.append(rate / step)
    return _stacked(PAPER, joints, parts, runs, rates)


def build_measured_rows(
    runs: Sequence[CalibrationRun],
    tracks: Sequence[Track],
    model: Model,
    joints: Sequence[int] | None = None,
    thinning_factor: int = 1,
) -> CalibrationRows:
    """Return rows on measured motion, for given joints (from 1) or all.

    Args:
        model: The model whose residual is Y.
        thinning_factor: Take every k-th row, if there are more than tables can use.
    """
    joints = _joints(joints, runs[0].log.dof, runs[0].log.dof)
    columns = [j - 1 for j in joints]
    parts, rates = [], []
    for run, track in zip(runs, tracks, strict=True):
        chosen = select_row_samples(track, thinning_factor)
        moving = np.repeat(track.moving, track.step, axis=0)[: len(track.t)]
        torque = interpolate_signals(track.t, run.log.t, run.log.tau)
        residual = torque - model.torque_on(track)
        signals = (track.q, track.qd, track.qdd, residual, torque, moving)
        *states, Y, tau, moves = (signal[chosen][:, columns] for signal in signals)
        parts.append((np.hstack(states), Y, tau, moves, track.t[chosen]))
        rates.append(track.rate / _step(track.rate, MEASURED_HZ) / thinning_factor)
    return _stacked(MEASURED, joints, parts, runs, rates)


def select_row_samples(track: Track, thinning_factor: int = 1) -> Array:
    """Return the indices of the samples of a track used as rows: no ends, no gaps."""
    inner = np.repeat(track.valid, track.step)[: len(track.t)]
    edge = round(FilterSettings().edge * track.rate)
    inner[:edge] = inner[len(inner) - edge :] = False
    return np.flatnonzero(inner)[:: thinning_factor * _step(track.rate, MEASURED_HZ)]


def _joints(joints: Sequence[int] | None, dof: int, default: int) -> tuple[int, ...]:
    if joints is None:
        return tuple(range(1, min(default, dof) + 1))
    if not joints or any(not 1 <= j <= dof for j in joints):
        listed = ", ".join(map(str, joints)) or "none"
        raise InputError(f"joints {listed}: expected some of 1 to {dof}, each once.")
    return tuple(sorted(set(joints)))


def _step(rate: float, target: float) -> int:
    return max(1, round(rate / target))


def _stacked(
    mode: str,
    joints: tuple[int, ...],
    of_runs: Sequence[Sequence[Array]],
    runs: Sequence[CalibrationRun],
    rates: Sequence[float],
) -> CalibrationRows:
    """Stack the rows of all runs: X, Y, torque, moving joints, and times of each."""
    *sides, times = zip(*of_runs, strict=True)
    X, Y, tau, moving = map(np.concatenate, sides)
    # For a joint that hardly moves, use its rows at standstill.
    moving = moving | (moving.sum(axis=0) < _ENOUGH * X.shape[1])
    run = np.repeat(np.arange(len(runs)), [len(t) for t in times])
    blocks = cut_runs_into_blocks(times)
    places = [blocks.places(number, t) for number, t in enumerate(times)]
    return CalibrationRows(
        mode,
        joints,
        name_state_columns(joints),
        *map(make_read_only, (X, Y, tau, run)),
        tuple(r.log.id for r in runs),
        tuple(r.family or "" for r in runs),
        tuple(rates),
        blocks,
        make_read_only(np.concatenate(places)),
        make_read_only(moving),
    )


def cut_single_run(runs: Sequence[CalibrationRun]) -> tuple[CalibrationRun, ...]:
    """Cut a single log into parts, so that parts can be left out."""
    if len(runs) != 1:
        return tuple(runs)
    (run,) = runs
    ends = np.linspace(0, len(run.log.t), PARTS + 1).astype(int)
    parts = []
    for i, (a, b) in enumerate(pairwise(ends), 1):
        log = replace(slice_recording(run.log, a, b), id=f"{run.log.id} part {i}")
        twin = {name: values[a:b] for name, values in run.twin.items()}
        parts.append(replace(run, log=log, twin=twin))
    return tuple(parts)


def choose_thinning_factor(runs: Sequence[CalibrationRun]) -> tuple[int, tuple[str, ...]]:
    """Return the thinning factor k of the rows of tables, and a note on it.

    The model is identified from all of them, piece by piece.
    """
    total = sum(run.log.duration for run in runs)
    thin = max(1, int(np.ceil(total / MOST)))
    if thin == 1:
        return 1, ()
    return thin, (f"{total / 60:.3g} min of logs: tables take one row in {thin}",)


# Principal components of the rows (paper, eq. 12, figures 4 to 6).


LEAST_DRAWS = 20  # a 95 % limit from fewer is their maximum
_QUANTILE = 0.95  # quantile of the surrogates, the limit of chance
INPUT, TWIN, WHITE, LEFT = "input", "twin error", "white noise", "residual"
_DRAWS, _MOST_ROWS = 40, 1500  # rows of surrogates; more do not change the limit
_TWIN_STATE = ("e_q", "e_qd", "e_qdd")


@dataclass(frozen=True, eq=False, slots=True)
class PrincipalComponents:
    """Principal components of centred, scaled columns (paper, eq. 12, figures 4 to 6).

    Attributes:
        names: The columns.
        loadings: Orthonormal loadings P, by column. Shape (k, k).
        explained: Share of the variance per component [%]. Shape (k,).
        limit: 95 % quantile of surrogates with the same spectra [%]. (k,).
        family, block: Kind of motion and block of a calibration.
    """

    names: tuple[str, ...]
    loadings: Array
    explained: Array
    limit: Array
    family: str = ""
    block: str = ""

    @property
    def real(self) -> int:
        """Number of leading components with more variance than chance gives.

        In a correlation matrix a first component too large makes the others small, so
        only an unbroken start is a count.
        """
        return int(np.logical_and.accumulate(self.explained > self.limit).sum())

    def strongest(self, component: int) -> tuple[tuple[str, float], ...]:
        """The three variables with the largest loadings of a component, with sign."""
        column = self.loadings[:, component]
        order = np.argsort(-np.abs(column), kind="stable")[:3]
        return tuple((self.names[i], float(column[i])) for i in order)


def fit_pca(
    X: Array,
    rng: np.random.Generator,
    names: Sequence[str] | None = None,
    *,
    run_of_row: Array | None = None,
    surrogate_count: int = 100,
) -> PrincipalComponents:
    """Return all principal components of signals as columns, in any units.

    The columns are centred and scaled to unit variance first (paper, below eq. 12):
    angles, speeds and accelerations have different units. The largest loading of each
    component is positive. Surrogates are drawn within runs.

    The number of components beyond chance: parallel analysis (Horn 1965,
    Psychometrika 30) compares with white noise. Rows of a log are autocorrelated: two
    unrelated slow signals correlate by chance. So the surrogates keep the spectrum
    of every variable (Theiler et al. 1992, Physica D 58).
    """
    X = check_block(X, "X")
    least = max(2, X.shape[1])
    check_count(len(X), least, 2**62, "rows of X", "Take a longer log.")
    names = check_column_names(names, X.shape[1], "x")
    check_varying(X, names)
    check_count(surrogate_count, LEAST_DRAWS, 10**6, "draws", "100 are usual.")
    run_of_row = np.zeros(len(X), int) if run_of_row is None else np.asarray(run_of_row)
    if run_of_row.shape != (len(X),):
        raise InputError(f"run has shape {run_of_row.shape}, expected ({len(X)},).")
    parts = [np.flatnonzero(run_of_row == label) for label in np.unique(run_of_row)]
    shortest = min(map(len, parts))
    check_count(shortest, 4, len(X), "rows of a run", "Leave short runs out.")
    from sklearn.decomposition import PCA
    from sklearn.preprocessing import StandardScaler

    scaled = StandardScaler().fit_transform(X)
    pca = PCA(svd_solver="covariance_eigh").fit(scaled)
    spectra = [np.fft.rfft(X[rows] - X[rows].mean(0), axis=0) for rows in parts]
    means = np.concatenate([np.repeat(X[r].mean(0)[None], len(r), 0) for r in parts])
    drawn = np.empty((surrogate_count, X.shape[1]))
    for i in range(surrogate_count):
        pairs = zip(spectra, parts, strict=True)
        new = [randomise_phases(s, len(rows), rng) for s, rows in pairs]
        correlation = np.corrcoef((np.concatenate(new) + means).T).reshape(X.shape[1], -1)
        drawn[i] = np.linalg.eigvalsh(correlation)[::-1]
    limit = np.quantile(drawn, _QUANTILE, axis=0)
    # Variances of n rows are over n, as in a correlation matrix, and not over n - 1.
    values = pca.explained_variance_ * (len(X) - 1) / len(X)
    shares = (100 * v / X.shape[1] for v in (values, limit))
    ordered = pca.components_.T.copy(), *shares
    return PrincipalComponents(names, *map(make_read_only, ordered))


def analyze_principal_components(
    rows: CalibrationRows, runs: Sequence[CalibrationRun], rng: np.random.Generator
) -> tuple[PrincipalComponents, ...]:
    """Principal components of input, error and white noise, family by family.

    Logs without a family count as one family.
    """
    out = []
    families = rows.families if all(rows.families) else ("all runs",) * len(runs)
    for family in dict.fromkeys(families):
        members = [i for i, f in enumerate(families) if f == family]
        taken = [np.flatnonzero(rows.run == i) for i in members]
        step = max(1, sum(map(len, taken)) // _MOST_ROWS)
        taken = [part[::step] for part in taken]
        chosen = np.concatenate(taken)
        X = rows.X[chosen]
        blocks = {
            INPUT: (X, rows.names),
            **_error_block(rows, runs, dict(zip(members, taken, strict=True))),
            WHITE: (rng.normal(size=X.shape), rows.names),
        }
        for name, (values, names) in blocks.items():
            options = {"run_of_row": rows.run[chosen], "surrogate_count": _DRAWS}
            pca = fit_pca(values, rng, names, **options)
            out.append(replace(pca, family=family, block=name))
    return tuple(out)


def _error_block(
    rows: CalibrationRows, runs: Sequence[CalibrationRun], taken: Mapping[int, Array]
) -> dict[str, tuple[Array, tuple[str, ...]]]:
    """Return the twin's errors of state, at as many times as each run has rows.

    Without a twin, return the residual of the model on these rows.
    """
    if not all(set(_TWIN_STATE) <= set(runs[i].twin) for i in taken):
        residual = rows.Y[np.concatenate([*taken.values()])]
        return {LEFT: (residual, tuple(f"residual{j}" for j in rows.joints))}
    joints, errors = [j - 1 for j in rows.joints], []
    for i, part in taken.items():
        at = np.linspace(0, len(runs[i].log.t) - 1, len(part)).astype(int)
        parts = (runs[i].twin[name][at][:, joints] for name in _TWIN_STATE)
        errors.append(np.hstack([*parts]))
    names = tuple(f"e_{name}" for name in name_state_columns(rows.joints))
    return {TWIN: (np.concatenate(errors), names)}
