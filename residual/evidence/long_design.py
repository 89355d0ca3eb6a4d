"""The design of logs that are too long for memory: sums over pieces, and a sketch.

Gram matrices are added up piece by piece, of all rows. Residuals, which tell how long
noise remembers and what is left, are those of pieces evenly spread, seven minutes.
Columns of all rows wait in a file for those that are added later.
"""

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from residual.effects.base import Effect, Joints, Shape, State
from residual.evidence.design import Design
from residual.evidence.folds import fold_labels
from residual.evidence.group import Group
from residual.evidence.spool import Spool
from residual.model.model import Model
from residual.model.observed import is_long, observed, with_regressor
from residual.recording import Array
from residual.signals.pieces import logs_of, spread
from residual.signals.track import Track

Made = Callable[[State], list[tuple[Joints, Array]]]


def design_of(
    tracks: Sequence[Track], model: Model, seen: Model | None = None
) -> Design:
    """Columns of a model on logs, in memory where they are short enough for that.

    Args:
        tracks: Signals of the logs.
        model: The nominal model.
        seen: Model whose torque effects see; the nominal one where None.
    """
    states = observed(seen or model, tracks)
    if is_long(tracks):
        return LongDesign(tracks, states, model)
    return Design(list(zip(tracks, states, strict=True)), model)


def _rows_that_count(tracks: Sequence[Track]) -> list[Array]:
    """Rows on which each joint moves, in logs of a live torque. Shapes (m, dof)."""
    out = []
    for pieces in logs_of([t.id for t in tracks]):
        own = [tracks[i] for i in pieces]
        alive = np.any([np.ptp(t.tau, axis=0) > 0 for t in own], axis=0)
        out += [t.moving & alive for t in own]
    return out


class LongDesign(Design):
    """A design whose rows, but for a sketch of them, are not kept.

    Rows, sums and folds are those of all logs; ``target``, ``tau``, ``columns``,
    ``residual``, ``series``, ``states`` and ``tracks`` those of the sketch.
    """

    def __init__(
        self, tracks: Sequence[Track], states: Sequence[State], model: Model
    ) -> None:
        self.dof, self.model = model.robot.dof, model
        self._every, self._seen, self._spool = list(tracks), states, Spool()
        self._shown = spread([t.seconds for t in tracks])
        self._rows_of = _rows_that_count(tracks)
        self._labels = fold_labels(tracks)
        self.folds = 1 + max(int(x.max(initial=0)) for x in self._labels)
        self.speed = np.quantile(
            np.abs(np.concatenate([t.qd for t in tracks])), 0.95, axis=0
        )
        self._measure_torque()
        self._target: list[list[Array]] = []
        self._x: list[Array | None] = [None] * self.dof
        self.place = [np.zeros(0, dtype=int) for _ in range(self.dof)]
        self.gram = [np.zeros((self.folds, 0, 0)) for _ in range(self.dof)]
        self.cross = [np.zeros((self.folds, 0)) for _ in range(self.dof)]
        self._sums: list = [None] * self.dof
        self.size = 0
        self._logs, self._use = [], [[] for _ in range(self.dof)]
        self._take_nominal(model)

    def _measure_torque(self) -> None:
        """Sizes of the torque, of all rows."""
        per_fold = np.zeros((2, self.folds, self.dof))
        self.peak = np.zeros(self.dof)
        for _, j, labels, tau in self._lines([t.tau for t in self._every]):
            per_fold[0, :, j] += np.bincount(labels, minlength=self.folds)
            per_fold[1, :, j] += np.bincount(labels, tau**2, minlength=self.folds)
            self.peak[j] = max(self.peak[j], np.abs(tau).max(initial=0.0))
        self.fold_rows, self.tau_power = per_fold
        self.rows = np.maximum(self.fold_rows.sum(axis=0), 1.0)
        some = self.fold_rows.sum(axis=0) > 0
        rms = np.sqrt(self.tau_power.sum(axis=0) / self.rows)
        self.rms = np.maximum(np.where(some, rms, 1.0), 1e-9)

    def _lines(
        self, values: Sequence[Array]
    ) -> Iterator[tuple[int, int, Array, Array]]:
        """Number, joint, folds and values of each piece's rows."""
        for c, (x, use) in enumerate(zip(values, self._rows_of, strict=True)):
            for j in range(self.dof):
                yield c, j, self._labels[c][use[:, j]], x[use[:, j], j]

    def _take_nominal(self, model: Model) -> None:
        everyone = tuple(range(self.dof))
        self.power = np.zeros((self.folds, self.dof))

        def made(state: State) -> list[tuple[Joints, Array]]:
            # The first look at a piece: its target comes with it.
            self._set_target(len(self._target), model.torque_of_state(state))
            terms = (
                (
                    t.effect.rows(t.joints, self.dof),
                    t.effect.columns(state, t.joints, t.shape),
                )
                for t in model.terms
            )
            return [(everyone, state.regressor), *terms]

        ids = self._take(made, whole=True)
        self.nominal, self.inertial = np.concatenate(ids), ids[0]
        self._show_sketch()

    def _set_target(self, c: int, torque: Array) -> None:
        track, use, labels = self._every[c], self._rows_of[c], self._labels[c]
        gap = track.tau - track.filter(torque)
        own = [gap[use[:, j], j] for j in range(self.dof)]
        self._target.append(own)
        for j, y in enumerate(own):
            folds = labels[use[:, j]]
            self.power[:, j] += np.bincount(folds, y**2, minlength=self.folds)

    def _show_sketch(self) -> None:
        """Let what is asked of rows be that of the sketch."""
        shown = self._shown
        self._use = [[self._rows_of[c][:, j] for c in shown] for j in range(self.dof)]
        labels = [
            [self._labels[c][u] for c, u in zip(shown, use, strict=True)]
            for use in self._use
        ]
        self._fold = [np.concatenate(own) for own in labels]
        self.target = [
            np.concatenate([self._target[c][j] for c in shown]) for j in range(self.dof)
        ]
        self.tau = self.stacked([self._every[c].tau for c in shown])
        self.show_torque(self._seen)

    def show_torque(self, states: Sequence[State]) -> None:
        """From now on let effects see the logs with another model's torque."""
        self._seen = states
        self._logs = [(self._every[c], states[c]) for c in self._shown]

    def add(self, candidates: Sequence[tuple[Effect, Joints, Shape]]) -> list[Group]:
        """Append candidates and return their groups, in order."""
        if not candidates:
            return []
        by_rows = self._by_rows(candidates)
        sizes: dict[int, int] = {}

        def made(state: State) -> list[tuple[Joints, Array]]:
            out = []
            for rows, members in by_rows.items():
                own = [
                    e.columns(state, js, sh)
                    for e, js, sh in (candidates[i] for i in members)
                ]
                sizes.update(zip(members, (c.shape[2] for c in own), strict=True))
                out.append((rows, np.concatenate(own, axis=2)))
            return out

        bodies = any(e.scope in ("link", "flange") for e, _, _ in candidates)
        ids = self._take(made, whole=bodies)
        groups: dict[int, Group] = {}
        for own, (rows, members) in zip(ids, by_rows.items(), strict=True):
            parts = np.split(own, np.cumsum([sizes[i] for i in members])[:-1])
            for i, columns in zip(members, parts, strict=True):
                groups[i] = self._group(candidates[i], rows, columns)
        return [groups[i] for i in range(len(candidates))]

    def _take(self, made: Made, whole: bool) -> list[Array]:
        """Append columns of all pieces, and return their numbers, part by part.

        Args:
            made: What makes the columns of a piece.
            whole: Whether it reads the regressor.
        """
        ids: list[Array] = []
        for c, track in enumerate(self._every):
            state = with_regressor(self._seen[c]) if whole else self._seen[c]
            parts = made(state)
            if not ids:
                ids = self._reserve([(rows, x.shape[2]) for rows, x in parts])
            fresh: list[list[Array]] = [[] for _ in range(self.dof)]
            for rows, columns in parts:
                filtered = track.filter(columns)
                for r, j in enumerate(rows):
                    fresh[j].append(filtered[self._rows_of[c][:, j], r])
            for j in (j for j in range(self.dof) if fresh[j]):
                self._extend_by(c, j, np.concatenate(fresh[j], axis=1))
        return ids

    def _reserve(self, parts: Sequence[tuple[Joints, int]]) -> list[Array]:
        """Number the columns of several parts, and make room for their sums."""
        ids = []
        for rows, k in parts:
            ids.append(np.arange(self.size, self.size + k))
            self.size += k
            for j in range(self.dof):
                have = int((self.place[j] >= 0).sum())
                own = np.arange(have, have + k) if j in rows else np.full(k, -1)
                self.place[j] = np.concatenate([self.place[j], own])
        for j in range(self.dof):
            more = int((self.place[j] >= 0).sum()) - self.cross[j].shape[1]
            self.gram[j] = np.pad(self.gram[j], ((0, 0), (0, more), (0, more)))
            self.cross[j] = np.pad(self.cross[j], ((0, 0), (0, more)))
        return ids

    def _extend_by(self, c: int, j: int, new: Array) -> None:
        """Add one piece's rows to the sums of new columns of a joint."""
        y = self._target[c][j]
        old = self._spool.read((j, c), len(y))
        first, size = len(old), len(old) + new.shape[1]
        self._spool.write((j, c), new)
        self._x[j] = None
        every = np.concatenate([old, new.T])
        labels = self._labels[c][self._rows_of[c][:, j]]
        for f in np.unique(labels):
            own = labels == f
            block = every[:, own] @ new[own]
            self.gram[j][f, :size, first:size] += block
            self.gram[j][f, first:size, :first] += block[:first].T
            self.cross[j][f, first:size] += new[own].T @ y[own]

    def _sketched(self, j: int) -> Array:
        """Columns of a joint on the rows of the sketch. Shape (rows, p)."""
        if self._x[j] is None:
            read = self._spool.read
            parts = [read((j, c), len(self._target[c][j])).T for c in self._shown]
            self._x[j] = np.concatenate(parts)
        return self._x[j]

    def columns(self, j: int, place: Array) -> Array:
        """Filtered columns of joint j on the sketch. Shape (rows, len(place))."""
        return self._sketched(j)[:, place]

    def residual(self, j: int, ids: Array, theta: Array) -> Array:
        """What the columns leave of joint j's target on the sketch [N m]. (rows,)."""
        self._sketched(j)
        return super().residual(j, ids, theta)

    def chunks(self, j: int, place: Array) -> Iterator[tuple[Array, Array]]:
        """Columns and target of joint j, of all rows, piece by piece."""
        for c in range(len(self._every)):
            y = self._target[c][j]
            yield self._spool.read((j, c), len(y))[place].T, y
