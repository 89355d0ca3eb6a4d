"""Filtered columns of every candidate on the rows that count, and their Gram.

Rows of joint j are its moving samples, all fit logs stacked, at some 33 a second.
"""

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import replace

import numpy as np

from residual.effects.base import Joints, PlacedEffect, State
from residual.evidence.angle_noise import AngleNoise
from residual.evidence.columns import (
    CandidateColumns,
    ColumnCache,
    FoldGrams,
    GramSums,
    KnownPrior,
    label_folds,
    regularize_precision,
    select_moving_rows,
    slice_folds,
    sum_squares_per_fold,
)
from residual.evidence.thresholds import THRESHOLDS
from residual.model.model import Model, Term
from residual.model.nominal import compute_known_value_information, select_effect_values
from residual.recording import Array
from residual.robot.dynamics import split_regressor_by_link
from residual.signals.track import Track

LAGS = 80  # largest lag of the noise autocorrelation, in rows
QUICK = 256  # time lines of a multiple of this length have a fast Fourier transform

# From the state of a log to the joints on which columns act, and the columns.
Made = Callable[[State], list[tuple[Joints, Array]]]


class Design:
    """Columns and Gram of the nominal model and of every candidate.

    Attributes:
        dof, model: Number of joints, and the nominal model.
        speed: 95 % quantile of each joint's |qd| [rad/s]. Shape (dof,).
        nominal: Column numbers of the nominal model's coefficients. Shape (p,).
        inertial: The inertial parameters among them.
        rms, peak: Torque of each joint on its rows, rms and largest [N m]. (dof,).
        rows: Rows of each joint. Shape (dof,).
        target: Filtered torque minus nominal torque on the rows, one per joint.
        tau: Filtered torque there.
        folds: Number of folds.
        fold_rows: Rows of each fold and joint. Shape (folds, dof).
        tau_power: Sum of squares of the torque. Shape (folds, dof).
        flat, stacks: Flat priors and stacks of groups, computed once
            (``evidence.priors``).
    """

    # Differences between logs beyond noise, if measured, (dof,).
    unrest: Array | None = None
    _kept: Array | None = None  # the folds of a part; None for all
    _alone = False  # whether a part uses its own rows only

    def __init__(
        self,
        tracks: Sequence[Track],
        model: Model,
        states: Sequence[State] = (),
        seen_with: Model | None = None,
        labels: Sequence[Array] = (),
        shaken: Sequence[Track] = (),
    ) -> None:
        """Compute the nominal model's columns.

        Args:
            states: Their states, if known already.
            seen_with: The model whose torque effects depend on; None for the nominal.
            labels: Fold of each row of each log, in ascending order; None for logs, or
                blocks if logs are few. Shapes (m,).
            shaken: The logs with redrawn noise of their angles, to correct the bias of
                products with the target.
        """
        self.dof, self.model = model.robot.dof, model
        self._tracks = list(tracks)
        self._seen_with = seen_with or model
        self._states: list = list(states) or [None] * len(tracks)
        self._use = select_moving_rows(tracks)
        self._labels = list(labels) or label_folds(tracks)
        self.folds = 1 + max(int(x.max(initial=0)) for x in self._labels)
        qd = np.concatenate([t.qd for t in tracks])
        self.speed = np.quantile(np.abs(qd), 0.95, axis=0)
        self._columns, self._sums = ColumnCache(), GramSums(self.dof, self.folds)
        self._totals: list = [None] * self.dof
        self._blocks: list[FoldGrams] = []
        self._lines: dict[int, tuple[Array, int]] = {}
        self.flat, self.stacks = {}, {}
        self._noise = AngleNoise(self.dof, dict(enumerate(shaken)))
        self._measure_torque()
        self._take_nominal()
        self._take_noise_torque(model)

    # -- building -----------------------------------------------------------------

    def _measure_torque(self) -> None:
        self.tau = self.stacked([t.tau for t in self._tracks])
        self._rows_folds = [
            np.concatenate([x[use[:, j]] for x, use in zip(self._labels, self._use, strict=True)])
            for j in range(self.dof)
        ]
        ones = [np.ones_like(x) for x in self.tau]
        self.fold_rows = sum_squares_per_fold(ones, self._rows_folds, self.folds)
        self.tau_power = sum_squares_per_fold(self.tau, self._rows_folds, self.folds)
        count = self.fold_rows.sum(axis=0)
        self.rows = np.maximum(count, 1.0)
        rms = np.sqrt(self.tau_power.sum(axis=0) / self.rows)
        self.rms = np.maximum(np.where(count > 0, rms, 1.0), 1e-9)
        self.peak = np.array([np.abs(x).max(initial=0.0) for x in self.tau])

    def _take_nominal(self) -> None:
        """Compute the columns of the nominal model, and its residual."""
        dof, model = self.dof, self.model

        def columns_of(state: State) -> list[tuple[Joints, Array]]:
            links = split_regressor_by_link(state.regressor, dof)
            out = [(tuple(range(x.shape[1])), x) for x in links]
            for t in model.terms:
                columns = t.effect.columns(state, t.joints, t.shape)
                out.append((t.effect.rows(t.joints, dof), columns))
            return out

        gaps = []
        for i, track in enumerate(self._tracks):
            torque = self.model.torque_of_state(self._state_of(i))
            gaps.append(track.tau - track.filter(torque))
        self._take_target(self.stacked(gaps))
        ids = self._append(columns_of, bodies=False)
        self.nominal = np.concatenate(ids)
        self.inertial = self.nominal[: len(model.inertial)]
        self._blocks = [self._fold_grams(j) for j in range(self.dof)]

    def _fold_grams(self, j: int) -> FoldGrams:
        lead = int((self._sums.place[j][self.nominal] >= 0).sum())
        return FoldGrams(self._columns, j, self._rows_folds[j], self.folds, lead)

    def _take_target(self, target: Sequence[Array]) -> None:
        self.target = list(target)
        self._squares = sum_squares_per_fold(self.target, self._rows_folds, self.folds)

    def _state_of(self, i: int) -> State:
        if self._states[i] is None:
            self._states[i] = self._seen_with.observe(self._tracks[i])
        return self._states[i]

    def _append(
        self, columns_of: Made, bodies: bool, widths: Callable[[int], Sequence[int]] = lambda j: ()
    ) -> list[Array]:
        """Append columns of all logs, and return their numbers part by part.

        Args:
            widths: Number of columns of each group that acts on a joint, once known.
        """
        ids: list[Array] = []
        fresh: list[list[Array]] = [[] for _ in range(self.dof)]
        for i in range(len(self._tracks)):
            state = self._state_of(i)
            if bodies:  # read for every body
                state = replace(state, regressor=np.asarray(state.regressor))
            parts = columns_of(state)
            if not ids:
                ids = self._sums.reserve([(on, x.shape[2]) for on, x in parts])
            for j, columns in self._filtered(i, parts):
                fresh[j].append(columns)
            self._take_noise(i, columns_of, bodies, fresh)
        for j in (j for j in range(self.dof) if fresh[j]):
            columns = np.concatenate(fresh[j], axis=1)
            fresh[j].clear()  # they double the memory
            self._extend(j, columns, widths(j))
        return ids

    def _take_noise(self, i: int, columns_of: Made, bodies: bool, fresh) -> None:
        """Append the shifts of a log's columns by redrawn noise of the angles.

        Args:
            fresh: Columns of each joint, the last of this log.
        """
        track = self._noise.tracks.get(i)
        if track is None:
            return
        state = self._seen_with.observe(track)
        if bodies:
            state = replace(state, regressor=np.asarray(state.regressor))
        for j, columns in self._filtered(i, columns_of(state)):
            self._noise.extend(i, j, columns - fresh[j][-1])

    def _take_noise_torque(self, model: Model) -> None:
        """Shift of model and logged torque by redrawn noise of the angles."""
        for i, track in self._noise.tracks.items():
            pair = [model.torque_on(t) for t in (track, self._tracks[i])]
            both = track.filter(pair[0] - pair[1]), track.tau - self._tracks[i].tau
            own = ([x[use, j] for j, use in enumerate(self._use[i].T)] for x in both)
            self._noise.take_torque(i, *own)
        self._totals = [None] * self.dof

    def _filtered(self, i: int, parts) -> Iterator[tuple[int, Array]]:
        """Filtered columns of one log on the rows of each joint. Shapes (k, rows)."""
        track = self._tracks[i]
        rows = [np.flatnonzero(use) for use in self._use[i].T]
        by_joint: list[list[Array]] = [[] for _ in range(self.dof)]
        for on, columns in parts:
            filtered = track.filter(columns).transpose(1, 2, 0)
            for own, j in zip(filtered, on, strict=True):
                by_joint[j].append(own[:, rows[j]])
        for j, own in enumerate(by_joint):
            if own:
                yield j, np.concatenate(own)

    def _extend(self, j: int, new: Array, widths: Sequence[int]) -> None:
        y = self.target[j]
        first = self._columns.count(j)
        self._columns.write(j, new)
        self._sums.add(j, self._columns.read(j, len(y)), first, y, self._rows_folds[j])

    def add(self, candidates: Sequence[PlacedEffect]) -> list[CandidateColumns]:
        """Append candidates and return their groups, in order."""
        if not candidates:
            return []
        by_rows: dict[Joints, list[int]] = {}
        for i, (effect, joints, _) in enumerate(candidates):
            by_rows.setdefault(effect.rows(joints, self.dof), []).append(i)
        sizes: dict[int, int] = {}

        def of_rows(state: State, members: list[int]) -> Array:
            picked = (candidates[i] for i in members)
            own = [e.columns(state, js, x).transpose(1, 2, 0) for e, js, x in picked]
            sizes.update(zip(members, (c.shape[1] for c in own), strict=True))
            return np.concatenate(own, axis=1).transpose(2, 0, 1)

        def columns_of(state: State) -> list[tuple[Joints, Array]]:
            return [(rows, of_rows(state, own)) for rows, own in by_rows.items()]

        bodies = any(e.scope in ("link", "flange") for e, _, _ in candidates)
        groups: dict[int, CandidateColumns] = {}

        def widths(j: int) -> list[int]:
            return [sizes[i] for rows, own in by_rows.items() if j in rows for i in own]

        ids = self._append(columns_of, bodies, widths)
        for own, (rows, members) in zip(ids, by_rows.items(), strict=True):
            parts = np.split(own, np.cumsum([sizes[i] for i in members])[:-1])
            for i, columns in zip(members, parts, strict=True):
                groups[i] = self._group(candidates[i], rows, columns)
        return [groups[i] for i in range(len(candidates))]

    def drop_newest_columns(self, size: int) -> None:
        """Remove the columns beyond the first ``size``."""
        for j, count in enumerate(self._sums.cut(size)):
            self._noise.cut(j, count)
            self._blocks[j].cut(count)
            self._columns.cut(j, count)
            self._totals[j] = None

    def _group(self, candidate, rows: Joints, ids: Array) -> CandidateColumns:
        """Zellner's g-prior: 30 % of torque rms in every direction of the columns."""
        effect, joints, shape = candidate
        if effect.prior_sd is not None:
            precision = np.diag(1 / effect.prior_sd(self.model.robot) ** 2)
        else:
            flat = self.unit_information(ids, rows)
            precision = flat / THRESHOLDS.prior_torque_share**2
        prior = regularize_precision(precision)
        group = CandidateColumns(effect, joints, shape, ids, *prior)
        known = select_effect_values(self.model.robot, effect, joints)
        if not known:
            return group
        terms = [(t.effect.name, t.joints) for t in self.model.terms]
        added = compute_known_value_information(
            known, group.precision, (effect.name, joints) in terms
        )
        return replace(group, known_prior=KnownPrior.of(group.precision, *added))

    def unit_information(self, ids: Array, rows: Joints) -> Array:
        """Mean square of the columns in units of torque rms. Shape (k, k)."""
        out = np.zeros((len(ids), len(ids)))
        for j in rows:
            place, have = self.present(j, ids)
            gram, _ = self.sums(j, place)
            out[np.ix_(have, have)] += gram / self.rows[j] / self.rms[j] ** 2
        return out

    def group_columns(self, term: Term, ids: Array) -> CandidateColumns:
        """Return the group of an effect whose columns exist already."""
        placed = PlacedEffect(term.effect, term.joints, term.shape)
        return self._group(placed, term.effect.rows(term.joints, self.dof), ids)

    # -- other designs of the same columns ----------------------------------------

    def drop_last_terms(self, count: int) -> "Design":
        """Return the design without the last terms of the nominal model, which are zero."""
        out, terms = copy(self), self.model.terms
        width = sum(len(t.theta) for t in terms[-count:])
        out.nominal = self.nominal[:-width]
        out.model = replace(self.model, terms=terms[:-count])
        return out

    def set_torque_model(self, model: Model) -> None:
        """Use another model's torque for effects from now on."""
        self._seen_with, self._states = model, [None] * len(self._tracks)
        self._take_noise_torque(model)

    def set_states(self, states: Sequence[State]) -> None:
        """Use these states of the logs for effects from now on."""
        self._states = list(states)

    def keep_angle_noise(self) -> "Design":
        """Return the design with the bias of least squares by noise of the angles."""
        out = copy(self)
        out._noise, out._totals = AngleNoise(self.dof, {}), [None] * self.dof
        out.flat, out.stacks = {}, {}
        return out

    def part(self, folds: Array, detached: bool = False) -> "Design":
        """Return some folds (k,) as a separate design with shared columns.

        The autocorrelation of the noise comes from all rows, except for a ``detached``
        part, which must be independent of the others.
        """
        out = copy(self)
        out._alone = detached
        out._kept, out.folds = folds, len(folds)
        out._squares, out.tau_power = self._squares[folds], self.tau_power[folds]
        out.fold_rows = self.fold_rows[folds]
        out.rows = np.maximum(self.fold_rows[folds].sum(axis=0), 1.0)
        if detached:
            out.rms = np.maximum(np.sqrt(out.tau_power.sum(axis=0) / out.rows), 1e-9)
        out._totals, out.flat, out.stacks = [None] * self.dof, {}, {}
        return out

    def with_target(self, target: Sequence[Array]) -> "Design":
        """Return the same columns and rows with another target.

        Torque rms, the reference of tolerances and priors, is unchanged.

        Args:
            target: Filtered torque minus nominal torque on the rows, one per joint.
        """
        out = copy(self)
        out._totals, out.flat, out.stacks = [None] * self.dof, {}, {}
        out._columns, cross = self._columns.copy(), []
        for j, y in enumerate(target):
            x = self._columns.read(j, len(y))
            own = np.zeros_like(self._sums.cross[j])
            for fold, rows in slice_folds(self._rows_folds[j]):
                own[fold] = x[:, rows] @ y[rows]
            cross.append(own)
        out._sums = self._sums.with_cross(cross)
        out._blocks = [out._fold_grams(j) for j in range(self.dof)]
        out._take_target(target)
        return out

    # -- reading ------------------------------------------------------------------

    @property
    def size(self) -> int:
        """Number of columns."""
        return self._sums.size

    @property
    def power(self) -> Array:
        """Sum of squares of the target, corrected for noise of the angles."""
        if not self._noise.tracks:
            return self._squares
        return self._squares + self.fold_rows * self._noise.surplus()

    @property
    def place(self) -> list[Array]:
        """Per joint, index of each column; -1 if it does not act."""
        return self._sums.place

    def present(self, j: int, ids: Array) -> tuple[Array, Array]:
        """Indices of the columns that act on joint j, and their positions in ``ids``."""
        place = self._sums.place[j][ids]
        have = np.flatnonzero(place >= 0)
        return place[have], have

    def acts(self, j: int, group: CandidateColumns) -> bool:
        """Whether all columns of a group act on joint j."""
        return bool((self._sums.place[j][group.ids] >= 0).all())

    def total(self, j: int) -> tuple[Array, Array]:
        """Gram and cross product of joint j, summed over folds. (p, p), (p,)."""
        size, known = self._sums.cross[j].shape[1], self._totals[j]
        if known is None or len(known[1]) != size:
            known = self._totals[j] = self._sum_folds(j, size)
        return known

    def _sum_folds(self, j: int, size: int) -> tuple[Array, Array]:
        if self._kept is not None:
            gram, cross = self.fold_sums(j, np.arange(size))
            return gram.sum(axis=0), cross.sum(axis=0)
        pull = self._sums.cross[j].sum(axis=0)
        if self._noise.tracks:
            pull = pull + self.rows[j] * self._noise.pull(j)[:size]
        return self._sums.gram[j], pull

    def sums(self, j: int, place: Array) -> tuple[Array, Array]:
        """Gram and cross product of some columns of joint j. Shapes (k, k), (k,)."""
        if self._kept is not None:
            gram, cross = self.fold_sums(j, place)
            return gram.sum(axis=0), cross.sum(axis=0)
        gram, cross = self.total(j)
        return gram[place[:, None], place], cross[place]

    def fold_sums(self, j: int, place: Array) -> tuple[Array, Array]:
        """Gram and cross product of some columns of joint j in every fold.

        Returns:
            Shapes (folds, k, k), (folds, k).
        """
        gram = self._blocks[j].of(place)
        if self._kept is not None:
            gram = gram[self._kept]
        return gram, self._fold_cross(j, place)

    def fold_pulls(self, j: int, place: Array, theta: Array) -> Array:
        """Products of some columns with their residual, in every fold. (folds, k)."""
        torque = self._blocks[j].times(place, theta)
        if self._kept is not None:
            torque = torque[self._kept]
        return self._fold_cross(j, place) - torque

    def _fold_cross(self, j: int, place: Array) -> Array:
        cross = self._sums.cross[j][:, place]
        if self._kept is not None:
            cross = cross[self._kept]
        if self._noise.tracks:
            cross = cross + self.fold_rows[:, [j]] * self._noise.pull(j)[place]
        return cross

    def columns(self, j: int, place: Array) -> Array:
        """Filtered columns of joint j. Shape (rows, len(place))."""
        return self._columns.read(j, len(self.target[j]))[place].T

    def coefficients(self, theta: Array) -> Array:
        """Nominal coefficients after a fit. Shape (p,)."""
        return self.model.coefficients() + theta[: len(self.nominal)]

    def may_fall(self, group: CandidateColumns) -> bool:
        """Whether an effect may be smaller than in the model."""
        return False

    def acting(self, j: int) -> Array:
        """Rows of joint j on which candidates act. (rows,), bool."""
        return np.ones(len(self.target[j]), dtype=bool)

    def torque(self, group: CandidateColumns, theta: Array, j: int) -> Array:
        """Torque of a group on the rows of joint j on which it acts [N m]. (n,)."""
        place, have = self.present(j, group.ids)
        return self.columns(j, place) @ theta[have]

    def torque_shares(self, group: CandidateColumns, theta: Array) -> Array:
        """Rms torque of a group on each joint, as a share of torque rms. (dof,)."""
        out = np.zeros(self.dof)
        for j in range(self.dof):
            place, have = self.present(j, group.ids)
            power = theta[have] @ self.sums(j, place)[0] @ theta[have] / self.rows[j]
            out[j] = np.sqrt(max(power, 0.0)) / self.rms[j]
        return out

    def residual(self, j: int, ids: Array, theta: Array) -> Array:
        """Residual of joint j's target after the columns [N m]. (rows,)."""
        place, have = self.present(j, ids)
        # The nominal model's come first and contiguously: they are not copied.
        first = int(np.cumprod(place == np.arange(len(place))).sum())
        columns = self._columns.read(j, len(self.target[j]))
        torque = theta[have[:first]] @ columns[:first]
        if first < len(place):
            torque = torque + theta[have[first:]] @ columns[place[first:]]
        return self.target[j] - torque

    def stacked(self, per_log: Sequence[Array]) -> list[Array]:
        """Signals of the logs on the rows of each joint. Shapes (rows,)."""
        pairs = list(zip(per_log, self._use, strict=True))
        return [np.concatenate([x[use[:, j], j] for x, use in pairs]) for j in range(self.dof)]

    def series(self, j: int, values: Array) -> list[Array]:
        """Row values of joint j on each log's time line, 0 where masked."""
        out, start = [], 0
        for use in (own[:, j] for own in self._use):
            line = np.zeros(len(use))
            stop = start + int(use.sum())
            line[use] = values[start:stop]
            out.append(line)
            start = stop
        return out

    def line(self, j: int, values: Array) -> Array:
        """Row values of joint j on one time line of all logs.

        0 where masked; ``LAGS`` rows separate logs, and follow the last. Shape (n,).
        """
        if j not in self._lines:
            starts = np.cumsum([0, *(len(use) + LAGS for use in self._use)])
            at = [
                start + np.flatnonzero(use[:, j])
                for start, use in zip(starts[:-1], self._use, strict=True)
            ]
            size = -(-int(starts[-1]) // QUICK) * QUICK
            self._lines[j] = np.concatenate(at), size
        at, size = self._lines[j]
        out = np.zeros(size)
        if self._alone:
            labels = self.label_joint_folds(j)
            values = np.where(np.isin(labels, self._kept), values, 0.0)
        out[at] = values
        return out

    def label_logs(self) -> Array:
        """Log of each fold, or the part if logs are few. Shape (folds,)."""
        out = np.zeros(self.folds, dtype=int)
        for own, log in zip(self._labels, label_folds(self._tracks), strict=True):
            out[own] = log
        return out

    def label_joint_folds(self, j: int) -> Array:
        """Fold of each row of joint j. Shape (rows,)."""
        return self._rows_folds[j]

    @property
    def states(self) -> list[State]:
        """States of each log, the inputs of effects."""
        return [self._state_of(i) for i in range(len(self._tracks))]

    @property
    def tracks(self) -> list[Track]:
        """Signals of the logs."""
        return self._tracks
