"""When a null holds for logs: the same robot and search, alike in motion and noise."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.effects import registry
from residual.evidence.fit import NOISE_FLOOR
from residual.evidence.priors import TINY
from residual.model.nominal import Logs, Nominal

LIKE = 1.5  # factor within which noise, speeds and durations count as the same
SHARE = 0.15  # by which the shares of moving rows may differ
CUTOFF = 1.05  # factor within which cut-offs count as the same


@dataclass(frozen=True, slots=True)
class Key:
    """What a null was made for.

    Attributes:
        robot: Hash of the robot's content.
        declared: Effects that the model has, in alphabetical order.
        candidates: Effects that were looked for.
        clock: Whether the order of the logs in time is known.
        cutoff: Identification cut-off [Hz].
        duration: Length of all fit logs together [s].
        noise: Torque noise of each joint, measured above the filter [N m].
        speed: 95 % quantile of speed of each joint [rad/s].
        moving: Share of the rows that count, of each joint.
    """

    robot: str
    declared: tuple[str, ...]
    candidates: tuple[str, ...]
    clock: bool
    cutoff: float
    duration: float
    noise: tuple[float, ...]
    speed: tuple[float, ...]
    moving: tuple[float, ...]

    def mismatch(self, other: "Key") -> str | None:
        """Return why a null of this key does not hold for other logs, or None."""
        exact = {
            "robot": "another robot, or another description of it",
            "declared": "other declared effects",
            "candidates": "another vocabulary of effects",
            "clock": "logs whose order in time is known, or these are such",
        }
        for name, words in exact.items():
            if getattr(self, name) != getattr(other, name):
                return words
        factors = {
            "cutoff": (CUTOFF, "another cut-off of the filter"),
            "duration": (LIKE, "another duration of the logs"),
            "noise": (LIKE, "another level of torque noise"),
            "speed": (LIKE, "other speeds"),
        }
        for name, (factor, words) in factors.items():
            mine, theirs = (np.atleast_1d(getattr(k, name)) for k in (self, other))
            if np.any(np.abs(np.log(mine / theirs)) > np.log(factor) + 1e-9):
                return f"{words} ({_few(mine)}, here {_few(theirs)})"
        apart = np.abs(np.subtract(self.moving, other.moving))
        if np.any(apart > SHARE):
            return f"other motion: joint {int(apart.argmax()) + 1} moves more or less"
        return None


def key_of(logs: Logs, nominal: Nominal) -> Key:
    """What a null that is made of these logs holds for."""
    tracks, span = logs.tracks, logs.span
    rms = np.sqrt(np.mean(np.concatenate([t.tau for t in tracks]) ** 2, axis=0))
    noise = np.sqrt(np.mean([t.torque_noise**2 for t in tracks], axis=0))
    moving = np.concatenate([t.moving for t in tracks]).mean(axis=0)
    return Key(
        robot=logs.robot.content_hash,
        declared=tuple(sorted(nominal.names)),
        candidates=tuple(registry()),
        clock=logs.clock is not None,
        cutoff=_short(span.cutoff),
        duration=_short(sum(float(t.t[-1] - t.t[0]) for t in tracks)),
        noise=_shorts(np.maximum(noise, np.maximum(NOISE_FLOOR * rms, TINY))),
        speed=_shorts(np.maximum(span.speed, 1e-3)),
        moving=_shorts(moving),
    )


def _short(value: float) -> float:
    """Three digits: a key is read by people too."""
    return float(f"{value:.3g}")


def _shorts(values: np.ndarray) -> tuple[float, ...]:
    return tuple(_short(float(v)) for v in values)


def _few(values: Sequence[float]) -> str:
    return ", ".join(f"{v:.3g}" for v in values)
