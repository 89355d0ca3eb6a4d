"""What changed and has no name: more than in the first epoch remains, or a curve.

Every block of two seconds is predicted by a fit that left it out, in both epochs. Where
blocks of the second are missed by more than those of the first, and by more than its
logs differ among themselves, something is there that no name of ours explains. So it
is where a free curve over the angle or the speed of a joint, in the second epoch alone,
wins what a name would have to.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from residual.changes.contrast import Candidate
from residual.changes.joint import JointRows
from residual.changes.search import ChangeSearch
from residual.effects.base import Effect, State
from residual.evidence.columns import Group, regularize
from residual.recording import Array

KNOTS = 7  # of a free curve
CURVE = Effect(
    name="curve",
    sentence="a free curve over the motion of a joint, which has no name",
    parameters={},
    columns=lambda state, joints, shape: np.zeros((len(state.q), 1, 0)),
)
CHANCE = 1e-3  # of one joint to be flagged where nothing changed
USUAL, FEW_LOGS = 0.3, 3.0  # by which logs differ in the logarithm; logs it counts as
BINS = 8


@dataclass(frozen=True, eq=False, slots=True)
class Residuals:
    """What remains of each joint after everything that is named."""

    # What is left, by row; None for a joint that is not looked at.
    residuals: tuple[Array | None, ...]
    # Of the second epoch beyond the first, as a share of torque rms, (dof,).
    share: Array
    floor: Array  # what the first epoch leaves, likewise, (dof,)
    # Joints from 0 on which something changed that has no name.
    flagged: tuple[int, ...]


def analyze_residuals(found: ChangeSearch) -> Residuals:
    """Look for a change that no name explains."""
    both, table = found.both, found.table
    dof, rules = both.design.dof, both.rules
    share, floor = np.zeros(dof), np.zeros(dof)
    left: list[Array | None] = [None] * dof
    flagged = []
    thetas = table.theta(found.named)
    for j, joint in table.joints.items():
        rest = joint.y
        for c, theta in zip(found.named, thetas, strict=True):
            if j in c.pieces:
                rest = rest - c.pieces[j].columns @ theta
        left[j] = rest
        power, second, log = _blocks(joint, rest)
        rms = both.design.rms[j]
        before, after = power[~second], power[second]
        floor[j] = np.sqrt(before.mean()) / rms
        share[j] = np.sqrt(max(after.mean() - before.mean(), 0.0)) / rms
        sure = _excess_chance(before, after, log[~second], log[second])
        more = share[j] > rules.unknown_torque_share and sure < CHANCE
        if more or _has_curve(found, j):
            flagged.append(j)
    return Residuals(tuple(left), share, floor, tuple(flagged))


def _has_curve(found: ChangeSearch, j: int) -> bool:
    """Whether a free curve over the joint's motion is there in the second epoch."""
    joint, design, rules = found.table.joints[j], found.both.design, found.both.rules
    second = joint.layout.second
    q, qd, way = (
        _signal_rows(design.states, design.tracks, name, j, j, design)
        for name in ("q", "qd", "sign")
    )
    place = _hat_functions(q)
    for columns in (place, place * way[:, None], _hat_functions(qd)):
        shown = (columns[second] ** 2).sum(axis=0) > 1e-3 * second.sum()
        columns = columns[:, shown]
        one = _curve_candidate(found, j, columns)
        look = found.table.contrast(one, found.named)
        torque = columns[second] @ look.theta
        share = np.sqrt((torque**2).mean()) / design.rms[j]
        if look.nats > rules.unknown_nats and share > rules.unknown_torque_share:
            return True
    return False


def _hat_functions(x: Array) -> Array:
    """Linear pieces between quantiles. Shape (rows, KNOTS)."""
    knots = np.unique(np.quantile(x, np.linspace(0.01, 0.99, KNOTS)))
    return np.column_stack([np.interp(x, knots, unit) for unit in np.eye(len(knots))])


def _curve_candidate(found: ChangeSearch, j: int, columns: Array) -> Candidate:
    """Columns of one joint as a candidate."""
    joint, k = found.table.joints[j], columns.shape[1]
    size = USUAL * found.both.design.rms[j]
    precision, log_det = regularize(np.eye(k) / size**2)
    group = Group(CURVE, (j,), (), np.full(k, -1), precision, log_det)
    piece = joint.pieces(columns, joint.layout.second, [k])[0]
    return Candidate(group, {j: piece}, np.log(len(found.table.joints)), group)


def _blocks(joint: JointRows, rest: Array) -> tuple[Array, Array, Array]:
    """Mean square of every block as a fit without it leaves it; its epoch and log."""
    missed = joint.lift(rest[:, None])[:, 0]
    starts = joint.layout.starts
    counts = np.diff([*starts, len(rest)])
    power = np.add.reduceat(missed**2, starts) / counts
    enough = counts >= 8
    return (
        power[enough],
        joint.layout.second[starts][enough],
        joint.layout.log[starts][enough],
    )


def _excess_chance(before: Array, after: Array, logs: Array, fresh: Array) -> float:
    """Chance that the second epoch's blocks are missed by so much more.

    On logarithms, which are nearly normal; logs that differ widen what is usual.
    """
    a, b = np.log(before + 1e-300), np.log(after + 1e-300)
    if min(len(a), len(b)) < 4:
        return 1.0
    within = (a.var(ddof=1) * (len(a) - 1) + b.var(ddof=1) * (len(b) - 1)) / (
        len(a) + len(b) - 2
    )
    means = np.array([a[logs == i].mean() for i in np.unique(logs)])
    # Few logs say little of how logs differ: drawn towards what is usual.
    free = len(means) - 1
    own = float(((means - means.mean()) ** 2).sum())
    between = (own + FEW_LOGS * USUAL**2) / (free + FEW_LOGS)
    sd = np.sqrt(
        within * (1 / len(a) + 1 / len(b))
        + between * (1 / len(means) + 1 / len(np.unique(fresh)))
    )
    nu = len(a) + len(b) - 2
    # Of Student's t, the share above.
    return float(stdtr(nu, -(b.mean() - a.mean()) / max(sd, 1e-12)))


def strongest_variable(
    found: ChangeSearch, rest: Residuals, j: int
) -> tuple[str, int, float] | None:
    """The variable that the rest of a joint goes by most: what, of which joint, share.

    None where it goes by none of them.
    """
    joint, design = found.table.joints[j], found.both.design
    second = joint.layout.second
    y = rest.residuals[j][second]
    best: tuple[str, int, float] | None = None
    for name in ("q", "qd", "qdd", "tau_model"):
        for of in range(design.dof):
            x = _signal_rows(design.states, design.tracks, name, of, j, design)[second]
            share = _explained(x, y, joint.layout.blocks_of_rows[second])
            if best is None or share > best[2]:
                best = (name, of, share)
    return best if best is not None and best[2] > 0.2 else None


def _signal_rows(
    states: list[State], tracks, name: str, of: int, j: int, design
) -> Array:
    per_log = [
        np.repeat(getattr(s, name)[:: t.step, [of]], design.dof, axis=1)
        for s, t in zip(states, tracks, strict=True)
    ]
    return design.stacked(per_log)[j]


def _explained(x: Array, y: Array, block: Array) -> float:
    """Share of the squares of y that a step function of x takes of left-out blocks."""
    edges = np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1])
    code = np.searchsorted(edges, x)
    half = block % 2 == 0
    missed = 0.0
    for own in (half, ~half):
        means = np.array(
            [
                y[~own & (code == b)].mean() if (~own & (code == b)).any() else 0.0
                for b in range(BINS)
            ]
        )
        missed += float(((y[own] - means[code[own]]) ** 2).sum())
    return 1 - missed / max(float(y @ y), 1e-300)
