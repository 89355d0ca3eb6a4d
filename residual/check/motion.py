"""Logs thinned to the rows by which their physics is judged."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.check.rules import CHECK
from residual.recording import Array, Recording
from residual.signals.track import Filters, Track, prepare, torque_later

_FILTERS = Filters(kinematics=5.0, torque=5.0, rate=60.0)


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """Filtered rows of all logs of one column map.

    Attributes:
        q, qd, qdd: Filtered kinematics [rad, rad/s, rad/s^2]. Shape (n, dof).
        tau: Torque behind the same filter [N m]. Shape (n, dof).
        moving: Joint moves, beyond what its noise does. Shape (n, dof), bool.
        spread: Independent rows for each row that is there.
        log: Number of the log of each row. Shape (n,).
    """

    q: Array
    qd: Array
    qdd: Array
    tau: Array
    moving: Array
    spread: float
    log: Array

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.q.shape[1]

    def split(self, parts: int) -> list["Motion"]:
        """Return the rows of each part of every log, in time."""
        every = [np.flatnonzero(self.log == number) for number in np.unique(self.log)]
        pieces = [np.array_split(rows, parts) for rows in every]
        return [self._at(np.concatenate(p)) for p in zip(*pieces, strict=True)]

    def _at(self, rows: Array) -> "Motion":
        names = ("q", "qd", "qdd", "tau", "moving", "log")
        return replace(self, **{name: getattr(self, name)[rows] for name in names})

    def with_angles(self, order: Sequence[int], scale: Array) -> "Motion":
        """Return the motion with other angles: channel ``order[j]``, times a factor.

        Args:
            order: Channel of each joint, from 0.
            scale: Factor on each joint's angle. Shape (dof,).
        """
        order = list(order)
        parts = {k: getattr(self, k)[:, order] * scale for k in ("q", "qd", "qdd")}
        return replace(self, moving=self.moving[:, order], **parts)


def thin_rows(recordings: Sequence[Recording]) -> Motion | None:
    """Filter and thin logs; None where nothing is left of them."""
    chosen = _chosen(recordings)
    if not chosen:
        return None
    parts: dict[str, list] = {k: [] for k in ("q", "qd", "qdd", "tau", "moving", "log")}
    seconds = 0.0
    for number, (_, track, use) in enumerate(chosen):
        for key in ("q", "qd", "qdd"):
            parts[key].append(getattr(track, key)[:: track.step][use])
        parts["tau"].append(track.tau[use])
        parts["moving"].append(track.moving[use])
        parts["log"].append(np.full(len(use), number))
        seconds += track.inner.sum() * track.step / track.rate
    rows = {key: np.concatenate(value) for key, value in parts.items()}
    count = len(rows["log"])
    return Motion(**rows, spread=min(1.0, seconds / CHECK.apart / count))


def later_torques(recordings: Sequence[Recording], ahead: Sequence[float]) -> Array:
    """Torque on the rows of ``thin_rows``, of moments that follow them.

    Args:
        ahead: By how much the moments follow [s].

    Returns:
        Torques [N m]. Shape (len(ahead), n, dof).
    """
    chosen = _chosen(recordings)
    torques = (
        [torque_later(r, track, _FILTERS, s)[use] for r, track, use in chosen]
        for s in ahead
    )
    return np.stack([np.concatenate(parts) for parts in torques])


def _chosen(
    recordings: Sequence[Recording],
) -> list[tuple[Recording, Track, Array]]:
    """Logs that are long enough, with the numbers of the rows that are looked at."""
    long = [r for r in recordings if len(r.t) > 20]
    tracks, _ = prepare(long, _FILTERS) if long else ((), None)
    total = sum(int(track.inner.sum()) for track in tracks)
    if total < 10:
        return []
    every = max(1, int(np.ceil(total / CHECK.most_rows)))
    return [
        (r, track, np.flatnonzero(track.inner)[::every])
        for r, track in zip(long, tracks, strict=True)
    ]
