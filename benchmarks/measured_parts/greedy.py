"""A peer that names effects: greedy forward selection by left-out blocks.

Inertial parameters, rotors, viscous and Coulomb friction and constants are least
squares with a small ridge. Named columns enter one by one while the best of them lowers
the error of left-out blocks on its joint by a share ``GAIN``, and in most blocks.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from residual.recording import Recording
from residual.robot.dynamics import compute_inertial_regressor
from residual.robot.robot import Robot
from residual.signals.track import FilterSettings, Track, build_tracks

Array = np.ndarray
Name = tuple[str, int]  # effect and joint from 1

GAIN, MOST, BLOCKS = 0.03, 14, 6  # of the error; names; of each log
MOST_BLOCKS = 0.6
RIDGE = 2e-5
STANDSTILL = 0.02  # rad/s
ORDERS = (3, 4, 6, 8, 10, 12, 16, 20, 24, 30, 36, 40, 48, 50, 60)
STRIBECK = (0.02, 0.05, 0.15, 0.4)  # rad/s


def names(robot: Robot, logs: Sequence[Recording]) -> list[Name]:
    """Return the names in the order in which they enter."""
    plain = PlainFit.of(robot, logs)
    torque = [
        compute_inertial_regressor(robot.model, t.q, t.qd, t.qdd) @ plain.body for t in plain.tracks
    ]
    pairs = zip(plain.tracks, torque, strict=True)
    columns = [{n: t.filter(x) for n, x in _named(t, load)} for t, load in pairs]
    selection = Selection.of(plain, columns, [track.tau for track in plain.tracks])
    chosen: list[int] = []
    error = selection.left_out(chosen)
    while len(chosen) < MOST:
        best = None
        for k, now in selection.left_out_with_one_more(chosen):
            joint = selection.names[k][1]
            here, before = now[:, joint - 1], error[:, joint - 1]
            share = 1 - np.sqrt(here.sum() / before.sum())
            fall = error.sum() - now.sum()
            lowers = share > GAIN and (here < before).mean() > MOST_BLOCKS
            if lowers and fall > (best[0] if best else 0.0):
                best = fall, k, now
        if best is None:
            break
        _, k, error = best
        chosen.append(k)
    return [selection.names[k] for k in chosen]


@dataclass(frozen=True, eq=False, slots=True)
class PlainFit:
    """Least squares of what is always there."""

    tracks: Sequence[Track]
    base: list[Array]  # its columns on the rows of each log, (n, dof, p)
    moving: list[Array]  # which rows count, (n, dof)
    theta: Array  # (p,)

    @classmethod
    def of(cls, robot: Robot, logs: Sequence[Recording]) -> "PlainFit":
        """Fit logs of an arm."""
        tracks, _ = build_tracks(list(logs), FilterSettings())
        base = [base_columns(robot, track) for track in tracks]
        moving = [abs(t.qd[:: t.step]) > STANDSTILL for t in tracks]
        return cls(tracks, base, moving, plain_fit(base, tracks, moving))

    @property
    def body(self) -> Array:
        """Inertial parameters. Shape (10 dof,)."""
        return self.theta[: 10 * self.tracks[0].tau.shape[1]]

    @property
    def noise(self) -> Array:
        """What it leaves of each joint [N m]. Shape (dof,)."""
        left, moves, tau = (
            np.concatenate(each)
            for each in (
                [t.tau - x @ self.theta for x, t in zip(self.base, self.tracks, strict=True)],
                self.moving,
                [t.tau for t in self.tracks],
            )
        )
        size = np.sqrt((left**2 * moves).sum(axis=0) / np.maximum(moves.sum(axis=0), 1))
        return np.maximum(size, 0.02 * np.sqrt(np.mean(tau**2, axis=0)))


@dataclass(frozen=True, eq=False, slots=True)
class Selection:
    """Normal equations of every block: base columns, then those of each name."""

    names: tuple[Name, ...]
    slots: tuple[Array, ...]  # columns of each name
    base: int  # number of the columns that are always there
    gram: Array  # (blocks, joints, p, p)
    cross: Array  # (blocks, joints, p)
    power: Array  # (blocks, joints)
    rows: int
    scale: Array  # (p,)

    @classmethod
    def of(
        cls, plain: PlainFit, columns: Sequence[dict[Name, Array]], torque: Sequence[Array]
    ) -> "Selection":
        """Sum blocks of logs, from filtered columns of each name and torques."""
        each = zip(plain.tracks, plain.base, columns, torque, plain.moving, strict=True)
        blocks = [
            (x[part], every, part, tau[part], moves[part])
            for track, x, every, tau, moves in each
            for part in np.array_split(np.flatnonzero(track.valid), BLOCKS)
        ]
        keys = tuple(columns[0])
        width = [columns[0][key].shape[1] for key in keys]
        first, noise = plain.base[0].shape[2], plain.noise
        ends = first + np.cumsum([0, *width])
        slots = tuple(np.arange(a, b) for a, b in pairwise(ends))
        dof, p = len(noise), int(ends[-1])
        gram = np.zeros((len(blocks), dof, p, p))
        cross, power = np.zeros((len(blocks), dof, p)), np.zeros((len(blocks), dof))
        for b, (x, every, part, tau, moves) in enumerate(blocks):
            for j in range(dof):
                weight = moves[:, j] / noise[j]
                own = np.zeros((len(part), p))
                own[:, :first] = x[:, j]
                for key, place in zip(keys, slots, strict=True):
                    if key[1] == j + 1:
                        own[:, place] = every[key][part]
                own *= weight[:, None]
                y = tau[:, j] * weight
                gram[b, j], cross[b, j] = own.T @ own, own.T @ y
                power[b, j] = y @ y
        rows = sum(len(part) for _, _, part, _, _ in blocks) * dof
        size = np.einsum("bjpp->p", gram) / rows
        scale = 1 / np.sqrt(np.maximum(size, 1e-12))
        return cls(keys, slots, first, gram, cross, power, rows, scale)

    def left_out(self, chosen: Sequence[int]) -> Array:
        """Squared error of each block, fitted to the others. Shape (blocks, joints)."""
        own = self._columns(chosen)
        gram, cross = self.gram[:, :, own[:, None], own], self.cross[:, :, own]
        left, right = self._others(gram.sum(axis=1), cross.sum(axis=1), own, own)
        left += RIDGE * self.rows * np.eye(len(own))
        theta = self.scale[own] * np.linalg.solve(left, right[..., None])[..., 0]
        miss = np.einsum("bp,bjpq,bq->bj", theta, gram, theta, optimize=True)
        return self.power - 2 * np.einsum("bjp,bp->bj", cross, theta) + miss

    def left_out_with_one_more(self, chosen: Sequence[int]) -> Iterator[tuple[int, Array]]:
        """Yield each further name and its `left_out`, by the Schur complement."""
        own = self._columns(chosen)
        gram, cross = self.gram[:, :, own[:, None], own], self.cross[:, :, own]
        left, right = self._others(gram.sum(axis=1), cross.sum(axis=1), own, own)
        inverse = np.linalg.inv(left + RIDGE * self.rows * np.eye(len(own)))
        alone = inverse @ right[..., None]
        more = [k for k in range(len(self.names)) if k not in chosen]
        fits = [self._with(k, own, inverse, alone) for k in more]
        theta = np.concatenate([of_own for of_own, _ in fits], axis=2)  # (b, p, more)
        errors = self.power[..., None] - 2 * cross @ theta
        for j in range(gram.shape[1]):
            errors[:, j] += np.einsum("bpk,bpk->bk", theta, gram[:, j] @ theta)
        for i, k in enumerate(more):
            slot, j = self.slots[k], self.names[k][1] - 1
            of_own, of_name = fits[i]
            both = np.swapaxes(self.gram[:, j, own[:, None], slot], 1, 2) @ of_own
            both += self.gram[:, j, slot[:, None], slot] @ of_name / 2
            both -= self.cross[:, j, slot, None]
            errors[:, j, i] += 2 * (of_name * both).sum(axis=(1, 2))
            yield k, errors[:, :, i]

    def _with(self, k: int, own: Array, inverse: Array, alone: Array) -> tuple[Array, Array]:
        """Coefficients of the columns so far and of one more name. (blocks, n, 1)."""
        slot, j = self.slots[k], self.names[k][1] - 1
        gram, cross = self.gram[:, j], self.cross[:, j, slot]
        across, right = self._others(gram[:, own[:, None], slot], cross, own, slot)
        inner, _ = self._others(gram[:, slot[:, None], slot], cross, slot, slot)
        inner += RIDGE * self.rows * np.eye(len(slot))
        turned, seen = np.swapaxes(across, 1, 2), inverse @ across
        of_name = np.linalg.solve(inner - turned @ seen, right[..., None] - turned @ alone)
        of_own = alone - seen @ of_name
        return self.scale[own][:, None] * of_own, self.scale[slot][:, None] * of_name

    def _columns(self, chosen: Sequence[int]) -> Array:
        return np.concatenate([np.arange(self.base), *(self.slots[k] for k in chosen)])

    def _others(
        self, gram: Array, cross: Array, rows: Array, columns: Array
    ) -> tuple[Array, Array]:
        """Sums over all blocks but each in turn, of columns scaled to size 1."""
        scale = self.scale
        left = (gram.sum(axis=0) - gram) * scale[rows][:, None] * scale[columns]
        return left, scale[columns] * (cross.sum(axis=0) - cross)


def base_columns(robot: Robot, track, width: float = STANDSTILL) -> Array:
    """Columns that are always there, on the rows of a log. Shape (n, dof, p).

    Args:
        width: Speed over which dry friction turns round [rad/s].
    """
    y = compute_inertial_regressor(robot.model, track.q, track.qd, track.qdd)
    way = np.tanh(track.qd / width) if width else np.sign(track.qd)
    each = (track.qdd, track.qd, way, np.ones_like(track.q))
    own = [values[:, :, None] * np.eye(robot.dof) for values in each]
    return track.filter(np.concatenate([y, *own], axis=2))


def plain_fit(base, tracks, moving) -> Array:
    rms = np.sqrt(np.mean(np.concatenate([t.tau for t in tracks]) ** 2, axis=0))
    pairs = zip(base, moving, strict=True)
    x = np.concatenate([(b * (m / rms)[:, :, None]) for b, m in pairs])
    y = np.concatenate([t.tau * m / rms for t, m in zip(tracks, moving, strict=True)])
    x, y = x.reshape(-1, x.shape[2]), y.ravel()
    size = np.maximum(np.linalg.norm(x, axis=0) / np.sqrt(len(x)), 1e-9)
    gram = (x / size).T @ (x / size) + RIDGE * len(x) * np.eye(x.shape[1])
    return np.linalg.solve(gram, (x / size).T @ y) / size


def _named(track, load: Array) -> Iterator[tuple[Name, Array]]:
    """Columns of each name at the rate of the log. Shapes (n, k)."""
    q, qd, qdd = track.q, track.qd, track.qdd
    for j in range(q.shape[1]):
        x, y, way = q[:, j], qd[:, j], np.tanh(qd[:, j] / STANDSTILL)
        columns: dict[str, tuple[Array, ...]] = {
            "coulomb_asymmetry": (abs(way),),
            "viscous_asymmetry": (abs(y),),
            "quadratic_viscous": (y * abs(y),),
            "power_viscous": (np.sign(y) * np.sqrt(abs(y)),),
            "load_friction": (abs(load[:, j]) * way,),
            "position_friction": (way * np.sin(x), way * np.cos(x)),
            "spring": (x,),
            "balancer": (np.sin(x), np.cos(x)),
            "torque_gain": (load[:, j],),
            "delay": (np.gradient(load[:, j]),),
        }
        for v in STRIBECK:
            columns[f"stribeck {v}"] = (way * np.exp(-abs(y) / v),)
        for order in ORDERS:
            columns[f"ripple {order}"] = (np.sin(order * x), np.cos(order * x))
        for i in (j - 1, j + 1):
            if 0 <= i < q.shape[1]:
                other = np.tanh(qd[:, i] / STANDSTILL)
                columns[f"coupling {i + 1}"] = (other, qd[:, i], qdd[:, i])
        for name, own in columns.items():
            yield (name, j + 1), np.stack(own, axis=1)
