"""What one arm has of the vocabulary in both epochs: a nuisance, and no change.

A gear has its own ripple, an arm in use its own twist. Columns that explain what the
usual nuisance leaves of a joint in the first epoch join it one after the other, by
orthogonal matching pursuit (Pati, Rezaiifar & Krishnaprasad 1993). What they explain is
never named: it may only make the errors smaller in which a change must be seen.
"""

from collections.abc import Sequence

import numpy as np

from residual.epochs.joint import Joint
from residual.epochs.rules import Rules
from residual.evidence.design import Design, Group
from residual.recording import Array

WIDEST = 3  # columns of a group that may join
FLAT = 1e-4  # of its square: a column that the nuisance has already


def joined(
    design: Design,
    j: int,
    groups: Sequence[Group],
    first: Array,
    alone: Joint,
    rules: Rules,
) -> Array:
    """Columns of the vocabulary that one joint has, by its first epoch.

    As `chosen`; as the design has them. Shape (rows, k).
    """
    ids = [g.ids for g in chosen(design, j, groups, first, alone, rules)]
    if not ids:
        return np.zeros((len(first), 0))
    return design.columns(j, design.present(j, np.concatenate(ids))[0])


def chosen(
    design: Design,
    j: int,
    groups: Sequence[Group],
    first: Array,
    alone: Joint,
    rules: Rules,
) -> list[Group]:
    """Effects of the vocabulary that one joint has, by its first epoch.

    Args:
        j: The joint, from 0.
        first: Rows of the first epoch. Shape (rows,), bool.
        alone: The joint on these rows, the usual nuisance taken out.
    """
    some = [g for g in groups if len(g.ids) <= WIDEST]
    some = [g for g in some if len(design.present(j, g.ids)[0]) == len(g.ids)]
    if not some:
        return []
    ids = np.concatenate([g.ids for g in some])
    raw = design.columns(j, design.present(j, ids)[0])
    y, power = alone.y, (raw[first] ** 2).sum(axis=0)
    left = alone.project(raw[first])
    ends = np.cumsum([0, *(len(g.ids) for g in some)])
    counted, found = len(y) / rules.slow, []
    while len(found) < rules.joined:
        gains = _gains(left, y, power, ends)
        i = int(np.argmax(gains))
        worth = -0.5 * counted * np.log1p(-gains[i])
        price = 0.5 * (ends[i + 1] - ends[i]) * np.log(counted) + np.log(len(some))
        if worth - price < rules.worth:
            break
        found.append(some[i])
        basis, _ = np.linalg.qr(left[:, ends[i] : ends[i + 1]])
        left = left - basis @ (basis.T @ left)
        y = y - basis @ (basis.T @ y)
    return found


def _gains(left: Array, y: Array, power: Array, ends: Array) -> Array:
    """Share of the squared rest that each group takes. Shape (groups,)."""
    cross, out = left.T @ y, np.zeros(len(ends) - 1)
    sizes = np.diff(ends)
    for k in np.unique(sizes):
        on = np.flatnonzero(sizes == k)
        at = ends[on][:, None] + np.arange(k)
        own = left[:, at.ravel()].reshape(len(y), len(on), k)
        gram = np.einsum("ngi,ngj->gij", own, own)
        gram = gram + FLAT * np.einsum("gi,ij->gij", power[at], np.eye(k)) + 1e-300
        solved = np.linalg.solve(gram, cross[at][..., None])[..., 0]
        out[on] = (solved * cross[at]).sum(axis=1)
    return np.clip(out / max(float(y @ y), 1e-300), 0.0, 1 - 1e-9)
