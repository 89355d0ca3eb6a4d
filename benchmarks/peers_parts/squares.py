"""Plain least squares of all bodies and simple drives.

Base parameters from the last body to the first, weighted by the noise of each joint. A
body, a friction or a rotor is named if it is off by more than chance (3 sigma for its
number of parameters) and by more than the scatter that every program knows.
"""

from collections.abc import Sequence
from itertools import product

import numpy as np
from scipy.stats import chi2

from benchmarks.hidden.score import Name
from benchmarks.peers_parts.linear_model import DRIVES, Answer, Arm, Case, Rows

Array = np.ndarray

SCATTER = 0.02  # of each parameter: that is told of every arm
CHANCE = 0.0027  # two-sided, of three sigma
DEPENDENT = 1e-4  # of a column's size: less is the sum of others
ROUNDS = 3


def answer(case: Case) -> Answer:
    arm = Arm(case)
    order, change, cover = _fit(arm, [arm.rows(log) for log in case.fit])
    found = []
    for kind, joint in product(("body", *DRIVES), range(1, arm.dof + 1)):
        at = [order.index(i) for i in arm.places(kind, joint) if i in order]
        if at and _off(change[at], cover[np.ix_(at, at)]):
            found.append(body(arm, joint) if kind == "body" else (Name(kind, (joint,)),))
    return Answer(tuple(found))


def body(arm: Arm, joint: int) -> tuple[Name, ...]:
    """Return what a body that is off is called."""
    link = Name("link_inertia", (joint,))
    # In the torque a load and a heavier last link are one.
    return (Name("payload", (joint,)), link) if joint == arm.dof else (link,)


def _fit(arm: Arm, logs: Sequence[Rows]) -> tuple[list[int], Array, Array]:
    """Return base parameters, their changes and the covariance of those."""
    gram, cross, power, rows = sums(logs)
    nominal = arm.nominal
    used = len(nominal) - 3  # nobody would fit a force at the flange
    weight = rows / power
    order = _independent(np.einsum("j,jab->ab", weight, gram)[:used, :used])
    for _ in range(ROUNDS):
        whole = np.einsum("j,jab->ab", weight, gram)[:used, :used]
        inverse = np.linalg.inv(whole[np.ix_(order, order)])
        change = inverse @ (weight @ cross)[order]
        left = [
            power[j] - 2 * change @ cross[j][order]
            + change @ gram[j][np.ix_(order, order)] @ change
            for j in range(arm.dof)
        ]  # fmt: skip
        weight = rows / np.maximum(left, 1e-9 * power)
    # Parameters that only occur in sums scatter as their sums do.
    sum_of = inverse @ whole[order]
    spread = (sum_of * (SCATTER * nominal[:used]) ** 2) @ sum_of.T
    return order, change, inverse + spread


def sums(logs: Sequence[Rows]) -> tuple[Array, Array, Array, Array]:
    """Return Gram matrix, cross product, power and number of rows of each joint."""
    parts = []
    for log in logs:
        own = log.columns * log.moving[:, :, None]
        left = log.residual * log.moving
        gram = np.einsum("nja,njb->jab", own, own, optimize=True)
        cross = np.einsum("nja,nj->ja", own, left, optimize=True)
        parts.append((gram, cross, (left**2).sum(axis=0), log.moving.sum(axis=0)))
    return tuple(sum(part) for part in zip(*parts, strict=True))


def _independent(gram: Array) -> list[int]:
    """Return parameters that are no sum of those before, from the last to the first."""
    n = len(gram)
    kept: list[int] = []
    for i in reversed(range(n)):
        if gram[i, i] <= 0:
            continue
        left = gram[i, i]
        if kept:
            own = gram[np.ix_(kept, kept)]
            left -= gram[i, kept] @ np.linalg.lstsq(own, gram[kept, i], rcond=None)[0]
        if left > DEPENDENT**2 * n * gram[i, i]:
            kept.append(i)
    return kept


def _off(change: Array, cover: Array) -> bool:
    size = change @ np.linalg.pinv(cover, hermitian=True) @ change
    return bool(size > chi2.isf(CHANCE, len(change)))
