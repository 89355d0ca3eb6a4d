"""Filtered columns of every candidate on the rows that count, and their Gram.

Rows of joint j are its moving samples, all fit logs stacked. The search needs but the
Gram matrices per fold; columns, kept for residuals, are only ever appended.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from residual.effects.base import Effect, Joints, Shape, State
from residual.evidence.folds import fold_labels
from residual.evidence.group import Group
from residual.model.model import Model
from residual.recording import Array
from residual.signals.track import Track

AMPLITUDE = 0.3  # prior size of an effect's torque, as a share of torque rms


class Design:
    """Columns and Gram of the nominal model and of every candidate.

    Attributes:
        dof, model: Number of joints, and the nominal model.
        speed: 95 % quantile of each joint's |qd| [rad/s]. Shape (dof,).
        nominal: Column numbers of the nominal model's coefficients. Shape (p,).
        rms, peak: Torque of each joint on its rows, rms and largest [N m]. (dof,).
        rows: Rows of each joint. Shape (dof,).
        target: Filtered torque minus nominal torque on the rows, one per joint.
        folds: Number of folds.
        fold_rows: Rows of each fold and joint. Shape (folds, dof).
    """

    _background: tuple = ()  # tables of each joint; none, or not yet

    def __init__(self, logs: Sequence[tuple[Track, State]], model: Model) -> None:
        self.dof, self.model = model.robot.dof, model
        self._logs = list(logs)
        self._use = [
            [t.moving[:, j] & (np.ptp(t.tau[:, j]) > 0) for t, _ in self._logs]
            for j in range(self.dof)
        ]
        self._fold = self._assign_folds()
        self.folds = 1 + max(int(f.max(initial=0)) for f in self._fold)
        qd = np.concatenate([s.qd for _, s in self._logs])
        self.speed = np.quantile(np.abs(qd), 0.95, axis=0)
        self.tau = tau = self.stacked([track.tau for track, _ in self._logs])
        self.rows = np.array([max(len(x), 1) for x in tau], dtype=float)
        rms = [np.sqrt(np.mean(x**2)) if len(x) else 1.0 for x in tau]
        self.rms = np.maximum(rms, 1e-9)
        self.peak = np.array([np.abs(x).max(initial=0.0) for x in tau])
        gaps = (t.tau - t.filter(model.torque_of_state(s)) for t, s in self._logs)
        self.target = self.stacked(list(gaps))
        self._x = [np.zeros((len(y), 0)) for y in self.target]
        self.place = [np.zeros(0, dtype=int) for _ in range(self.dof)]
        self.gram = [np.zeros((self.folds, 0, 0)) for _ in range(self.dof)]
        self.cross = [np.zeros((self.folds, 0)) for _ in range(self.dof)]
        self._buffers = list(zip(self._x, self.gram, self.cross, strict=True))
        self.fold_rows = self._per_fold([np.ones_like(y) for y in self.target])
        self.power = self._per_fold(self.target)
        self.tau_power = self._per_fold(tau)
        self._sums: list = [None] * self.dof
        self.size = 0
        self._add_nominal(model)

    # -- building -----------------------------------------------------------------

    def _assign_folds(self) -> list[Array]:
        """Fold of each row: its log, or a block of it where logs are few."""
        labels = fold_labels([track for track, _ in self._logs])
        return [
            np.concatenate([x[u] for x, u in zip(labels, use, strict=True)])
            for use in self._use
        ]

    def stacked(self, per_log: Sequence[Array]) -> list[Array]:
        """Signals of every log on the rows of each joint."""
        return [
            np.concatenate([x[u, j] for x, u in zip(per_log, use, strict=True)])
            for j, use in enumerate(self._use)
        ]

    def _per_fold(self, values: Sequence[Array]) -> Array:
        """Sum of squares per fold and joint. Shape (folds, dof)."""
        sums = [
            np.bincount(f, x**2, minlength=self.folds)
            for f, x in zip(self._fold, values, strict=True)
        ]
        return np.stack(sums, axis=1)

    def _add_nominal(self, model: Model) -> None:
        everyone = tuple(range(self.dof))
        ids = [self._append([s.regressor for _, s in self._logs], everyone)]
        for term in model.terms:
            columns = [
                term.effect.columns(s, term.joints, term.shape) for _, s in self._logs
            ]
            ids.append(self._append(columns, term.effect.rows(term.joints, self.dof)))
        self.nominal = np.concatenate(ids)
        self.inertial = ids[0]

    def show_torque(self, states: Sequence[State]) -> None:
        """From now on let effects see the logs with another model's torque."""
        tracks = [track for track, _ in self._logs]
        self._logs = list(zip(tracks, states, strict=True))

    def add(self, candidates: Sequence[tuple[Effect, Joints, Shape]]) -> list[Group]:
        """Append candidates and return their groups, in order.

        Args:
            candidates: Effect, joints from 0 and shape of each.
        """
        groups: dict[int, Group] = {}
        for rows, members in self._by_rows(candidates).items():
            per_log = [
                [e.columns(s, js, sh) for e, js, sh in (candidates[i] for i in members)]
                for _, s in self._logs
            ]
            sizes = [c.shape[2] for c in per_log[0]]
            ids = self._append([np.concatenate(c, axis=2) for c in per_log], rows)
            parts = np.split(ids, np.cumsum(sizes)[:-1])
            for i, own in zip(members, parts, strict=True):
                groups[i] = self._group(candidates[i], rows, own)
        return [groups[i] for i in range(len(candidates))]

    def _by_rows(self, candidates) -> dict[Joints, list[int]]:
        """Numbers of the candidates that act on the same joints."""
        out: dict[Joints, list[int]] = {}
        for i, (effect, joints, _) in enumerate(candidates):
            out.setdefault(effect.rows(joints, self.dof), []).append(i)
        return out

    def _append(self, per_log: Sequence[Array], rows: Joints) -> Array:
        """Filter columns (n, rows, k) of every log and extend the Gram."""
        k = per_log[0].shape[2]
        filtered = [
            track.filter(c) for (track, _), c in zip(self._logs, per_log, strict=True)
        ]
        ids = np.arange(self.size, self.size + k)
        self.size += k
        for j in range(self.dof):
            place = np.full(k, -1)
            if j in rows:
                r = rows.index(j)
                use = self._use[j]
                new = np.concatenate(
                    [c[u, r] for c, u in zip(filtered, use, strict=True)]
                )
                new = self.calmed(j, new)
                place = np.arange(self._x[j].shape[1], self._x[j].shape[1] + k)
                self._extend(j, new)
            self.place[j] = np.concatenate([self.place[j], place])
        return ids

    def _extend(self, j: int, new: Array) -> None:
        old = self._x[j].shape[1]
        size = old + new.shape[1]
        x, gram, cross = self._room(j, size)
        x[:, old:size] = new
        for f in range(self.folds):
            own = self._fold[j] == f
            block = x[own, :size].T @ new[own]
            gram[f, :size, old:size] = block
            gram[f, old:size, :size] = block.T
            cross[f, old:size] = new[own].T @ self.target[j][own]
        self._x[j], self.cross[j] = x[:, :size], cross[:, :size]
        self.gram[j] = gram[:, :size, :size]

    def _room(self, j: int, size: int) -> tuple[Array, Array, Array]:
        """Buffers of joint j's columns, Gram and cross product, grown by halves."""
        old = self._x[j].shape[1]
        if size > self._buffers[j][0].shape[1]:
            wide = max(size, old + old // 2)
            x = np.empty((len(self.target[j]), wide))
            gram = np.zeros((self.folds, wide, wide))
            cross = np.zeros((self.folds, wide))
            x[:, :old], cross[:, :old] = self._x[j], self.cross[j]
            gram[:, :old, :old] = self.gram[j]
            self._buffers[j] = x, gram, cross
        return self._buffers[j]

    def _group(self, candidate, rows: Joints, ids: Array) -> Group:
        """Zellner's g-prior: 30 % of torque rms in every direction of the columns."""
        effect, joints, shape = candidate
        if effect.prior_sd is not None:
            sd = effect.prior_sd(self._logs[0][1].robot)
            precision = np.diag(1 / sd**2)
        else:
            precision = self.unit_information(ids, rows) / AMPLITUDE**2
        scale = np.sqrt(np.maximum(np.diag(precision), 1e-12))
        precision = precision + 1e-6 * np.diag(scale**2)
        log_det = 2 * np.log(scale).sum()
        log_det += np.linalg.slogdet(precision / np.outer(scale, scale))[1]
        return Group(effect, joints, shape, ids, precision, float(log_det))

    def unit_information(self, ids: Array, rows: Joints) -> Array:
        """Mean square of the columns in units of torque rms. Shape (k, k)."""
        out = np.zeros((len(ids), len(ids)))
        for j in rows:
            p = self.place[j][ids]
            total = self.total(j)[0][np.ix_(p, p)]
            out += total / self.rows[j] / self.rms[j] ** 2
        return out

    def calm(self, background: Sequence) -> None:
        """From now on see target and columns without what tables account for.

        Args:
            background: Tables of each joint, None for a joint without; empty for none.
        """
        if not background:
            return
        self._background = tuple(background)
        for j, old in enumerate(self._x):
            self.target[j] = self.calmed(j, self.target[j])
            self._x[j] = np.zeros((len(old), 0))
            self.gram[j] = np.zeros((self.folds, 0, 0))
            self.cross[j] = np.zeros((self.folds, 0))
            self._buffers[j] = self._x[j], self.gram[j], self.cross[j]
            self._extend(j, self.calmed(j, old))
        self.power = self._per_fold(self.target)
        self._sums = [None] * self.dof

    def calmed(self, j: int, values: Array) -> Array:
        """Row values of joint j without what the tables account for. Shape as given."""
        own = self._tables_of(j)
        return values if own is None else own.whiten(values)

    def as_logged(self, j: int, values: Array) -> Array:
        """Row values of joint j with what the tables account for. Shape as given."""
        own = self._tables_of(j)
        return values if own is None else own.restore(values)

    def usual(self, j: int) -> float:
        """Size of the tables of joint j, as a share of torque rms; 0 without."""
        return getattr(self._tables_of(j), "size", 0.0)

    def _tables_of(self, j: int):
        return self._background[j] if self._background else None

    # -- reading ------------------------------------------------------------------

    def present(self, j: int, ids: Array) -> tuple[Array, Array]:
        """Places of the columns that act on joint j, and which of ``ids`` they are."""
        place = self.place[j][ids]
        have = np.flatnonzero(place >= 0)
        return place[have], have

    def total(self, j: int, folds: Array | None = None) -> tuple[Array, Array]:
        """Gram and cross product of joint j, summed over folds. (p, p), (p,)."""
        if folds is not None:
            return self.gram[j][folds].sum(axis=0), self.cross[j][folds].sum(axis=0)
        if self._sums[j] is None or len(self._sums[j][1]) != self.cross[j].shape[1]:
            self._sums[j] = self.gram[j].sum(axis=0), self.cross[j].sum(axis=0)
        return self._sums[j]

    def columns(self, j: int, place: Array) -> Array:
        """Filtered columns of joint j. Shape (rows, len(place))."""
        return self._x[j][:, place]

    def chunks(self, j: int, place: Array) -> Iterator[tuple[Array, Array]]:
        """Columns and target of joint j, of all rows: (rows, len(place)), (rows,)."""
        yield self.columns(j, place), self.target[j]

    def residual(self, j: int, ids: Array, theta: Array) -> Array:
        """What the columns leave of joint j's target [N m]. Shape (rows,)."""
        place, have = self.present(j, ids)
        return self.target[j] - self._x[j][:, place] @ theta[have]

    def on_rows(self, per_log: Sequence[Array], j: int) -> Array:
        """Filtered values of every log on the rows of joint j. Shape (rows, k)."""
        pairs = zip(self._logs, per_log, self._use[j], strict=True)
        return np.concatenate([track.filter(x)[use] for (track, _), x, use in pairs])

    def series(self, j: int, values: Array) -> list[Array]:
        """Row values of joint j put back on each log's time line, 0 where masked."""
        out, start = [], 0
        for use in self._use[j]:
            line = np.zeros(len(use))
            stop = start + int(use.sum())
            line[use] = values[start:stop]
            out.append(line)
            start = stop
        return out

    def folds_of(self, j: int) -> Array:
        """Fold of each row of joint j. Shape (rows,)."""
        return self._fold[j]

    @property
    def states(self) -> list[State]:
        """What the effects see of each fit log."""
        return [s for _, s in self._logs]

    @property
    def tracks(self) -> list[Track]:
        """Signals of the logs that rows and residuals are of."""
        return [t for t, _ in self._logs]
