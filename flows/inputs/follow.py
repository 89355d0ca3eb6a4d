"""What goes with a repair of the angles: speeds and references of the same encoder."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from residual.check.result import Repair
from residual.recording import Recording

Array = np.ndarray

# Of the angles' own size: whoever is nearer than this has their sign, unit and order.
_SAME = 0.3


def with_followers(
    repairs: Sequence[Repair], others: Iterable[Repair], logs: Sequence[Recording]
) -> list[Repair]:
    """Return repairs, and with one of the angles the same of what agrees with them.

    Speeds in degrees per second beside angles in degrees agree before and have to agree
    after; speeds that never agreed are right, or a fault of their own.

    Args:
        others: All repairs; what they mend is not mended twice.
    """
    out, done = list(repairs), {repair.signal for repair in others}
    agree = {"qd": _speeds_agree, "q_ref": _references_agree}
    for name in (name for name in agree if name not in done):
        if all(agree[name](log) for log in logs):
            out += [replace(r, signal=name) for r in repairs if r.signal == "q"]
    return out


def _speeds_agree(log: Recording) -> bool:
    if log.qd is None:
        return False
    return _near(log.qd, np.gradient(log.q, log.t, axis=0))


def _references_agree(log: Recording) -> bool:
    if log.q_ref is None:
        return False
    middle = log.q.mean(axis=0)
    return _near(log.q_ref - middle, log.q - middle)


def _near(one: Array, other: Array) -> bool:
    """Whether two signals are the same on most joints."""
    size = np.sqrt(np.mean(other**2, axis=0))
    apart = np.sqrt(np.mean((one - other) ** 2, axis=0))
    return bool(np.median(apart / np.maximum(size, 1e-12)) < _SAME)
