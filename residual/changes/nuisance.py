"""What an arm does without any change: by how much its logs differ, and its warmth.

Every log of the first epoch is held against the others. Where nothing changed between
them, what they show beyond noise is what any new log will show too. One factor a joint,
of all candidates and logs together: three logs give a score of values.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import psi

from residual.changes.contrast import JointNoise
from residual.changes.rows import EpochRows, JointRows, ProjectedColumns, RowLayout
from residual.changes.thresholds import ChangeThresholds
from residual.evidence.columns import CandidateColumns
from residual.evidence.design import Design
from residual.evidence.fit import estimate_autocorrelation_time
from residual.recording import Array

WIDEST = 3  # columns of a group that may join
FLAT = 1e-4  # of its square: a column that the nuisance has already


# What one arm has of the vocabulary in both epochs: a nuisance, and no change.
#
# A gear has its own ripple, an arm in use its own twist. Columns that explain what the
# usual nuisance leaves of a joint in the first epoch join it one after the other, by
# orthogonal matching pursuit (Pati, Rezaiifar & Krishnaprasad 1993). What they explain
# is never named: it may only make the errors smaller in which a change must be seen.


def nuisance_columns(
    design: Design,
    j: int,
    groups: Sequence[CandidateColumns],
    first: Array,
    alone: JointRows,
    rules: ChangeThresholds,
) -> Array:
    """Columns of the vocabulary that one joint has, by its first epoch.

    Args:
        j: The joint, from 0.
        first: Rows of the first epoch. Shape (rows,), bool.
        alone: The joint on these rows, the usual nuisance taken out.

    Returns:
        As the design has them. Shape (rows, k).
    """
    candidates = [g for g in groups if len(g.ids) <= WIDEST]
    candidates = [g for g in candidates if design.acts(j, g)]
    if not candidates:
        return np.zeros((len(first), 0))
    ids = np.concatenate([g.ids for g in candidates])
    raw = design.columns(j, design.present(j, ids)[0])
    y, power = alone.y, (raw[first] ** 2).sum(axis=0)
    remaining = alone.project(raw[first])
    ends = np.cumsum([0, *(len(g.ids) for g in candidates)])
    counted, chosen = len(y) / rules.rows_per_independent, []
    while len(chosen) < rules.max_joined:
        gains = _gains(remaining, y, power, ends)
        i = int(np.argmax(gains))
        worth = -0.5 * counted * np.log1p(-gains[i])
        price = 0.5 * (ends[i + 1] - ends[i]) * np.log(counted) + np.log(
            len(candidates)
        )
        if worth - price < rules.joined_nats:
            break
        chosen.append(candidates[i].ids)
        basis, _ = np.linalg.qr(remaining[:, ends[i] : ends[i + 1]])
        remaining = remaining - basis @ (basis.T @ remaining)
        y = y - basis @ (basis.T @ y)
    if not chosen:
        return np.zeros((len(first), 0))
    return design.columns(j, design.present(j, np.concatenate(chosen))[0])


def _gains(columns: Array, y: Array, power: Array, ends: Array) -> Array:
    """Share of the squared residual that each group explains. Shape (groups,)."""
    cross, out = columns.T @ y, np.zeros(len(ends) - 1)
    sizes = np.diff(ends)
    for k in np.unique(sizes):
        members = np.flatnonzero(sizes == k)
        at = ends[members][:, None] + np.arange(k)
        group_columns = columns[:, at.ravel()].reshape(len(y), len(members), k)
        gram = np.einsum("ngi,ngj->gij", group_columns, group_columns)
        gram = gram + FLAT * np.einsum("gi,ij->gij", power[at], np.eye(k)) + 1e-300
        solved = np.linalg.solve(gram, cross[at][..., None])[..., 0]
        out[members] = (solved * cross[at]).sum(axis=1)
    return np.clip(out / max(float(y @ y), 1e-300), 0.0, 1 - 1e-9)


TOLD = 3.0  # deviations from which on warmth is told
JOINTS = 2.0  # that what is usual of warmth counts as
TRIM = 0.9  # of the squared ratios: no single one decides
FLOOR = 1e-3  # of torque rms: no log is cleaner
FEWEST = 50  # rows of a log that can be compared


@dataclass(frozen=True, eq=False, slots=True)
class FrictionDrift:
    """Friction of all joints together, second epoch over first."""

    factor: float  # friction over that of the first epoch, less one, of all joints
    std: float  # its standard deviation
    each: Array  # the same of every joint that has friction to tell. Shape (dof,), NaN
    spread: float  # by how much joints and logs differ in it, a standard deviation
    per_joint: Array  # the same of every joint, by the first epoch's logs too, (dof,)

    @property
    def significant(self) -> bool:
        """Whether it is beyond chance."""
        return abs(self.factor) > TOLD * self.std


@dataclass(frozen=True, eq=False, slots=True)
class NuisanceFit:
    """What any arm has, taken out."""

    joints: Mapping[int, JointRows]  # the joints in both epochs, by number from 0
    first: Mapping[int, JointRows]  # the same in the first epoch alone
    warmth: FrictionDrift  # how the friction of all of them moved together


def fit_friction_drift(
    both: EpochRows, plain: Mapping[int, JointRows], shared: Mapping[int, Array]
) -> FrictionDrift:
    """How the friction of all joints moved together.

    Args:
        plain: The joints without what warms.
        shared: Columns of what each has. Shapes (rows, p).
    """
    each, sd = np.full(both.design.dof, np.nan), np.full(both.design.dof, np.nan)
    for j, joint in plain.items():
        factor = _factor(joint, both.friction[j], joint.layout.second)
        if factor is not None:
            each[j], sd[j] = factor
    usable = np.isfinite(each) & (sd < 0.2)
    least = both.rules.friction_spread
    within, logs = _spread_within(both, shared)
    if usable.sum() < 3:
        return FrictionDrift(
            0.0, least, each, least, _shrink_spread(least, within, logs)
        )
    value, spread = _weighted_median(each[usable], sd[usable])
    # Joints warm by different amounts, and few of them say by how different.
    count = usable.sum()
    spread = np.sqrt((JOINTS * least**2 + count * spread**2) / (JOINTS + count))
    std = 1.25 * float(np.sqrt(1 / (1 / (sd[usable] ** 2 + spread**2)).sum()))
    spread = max(float(spread), both.rules.warmth_spread_share * abs(value))
    return FrictionDrift(value, std, each, spread, _shrink_spread(spread, within, logs))


def _factor(
    joint: JointRows, friction: Array, mask: Array, before: Array | None = None
) -> tuple[float, float] | None:
    """Friction of a joint on some rows over all its friction, less one, and deviation.

    None where the nuisance has nearly all of it.
    """
    f = friction[:, None]
    piece = joint.pieces(f, mask, [1], before)[0]
    info = piece.gram[0, 0]
    if info <= 1e-3 * float((f[mask] ** 2).sum()):
        return None
    value = piece.cross[0] / info
    score = piece.pull[:, 0] - piece.lever[:, 0, 0] * value
    return value, np.sqrt((score**2).sum()) / info


def _shrink_spread(spread: float, within: Array, logs: int) -> Array:
    """Spread of each joint's friction, shrunk towards that of all joints."""
    return np.sqrt((JOINTS * spread**2 + logs * within) / (JOINTS + logs))


def _spread_within(both: EpochRows, shared: Mapping[int, Array]) -> tuple[Array, int]:
    """Variance of friction between the logs of the first epoch, beyond noise, by joint.

    Some joints warm by several times as much as others, and their own logs show it. By
    a fit of that epoch alone: in one of both, what changed is in these logs as well.
    """
    value, noise = np.full((2, both.first, both.design.dof), np.nan)
    for j, columns in shared.items():
        rows = ~both.layout[j].second
        target, layout = both.design.target[j][rows], _first_layout(both.layout[j])
        joint = JointRows(columns[rows], target, layout)
        friction = both.friction[j][rows]
        nothing = np.zeros((len(friction), 1))  # of a single log's was there before
        for i in range(both.first):
            factor = _factor(joint, friction, joint.layout.log == i, nothing)
            if factor is not None:
                value[i, j], noise[i, j] = factor[0], factor[1] ** 2
    out = np.zeros(both.design.dof)
    for j in shared:
        known = np.isfinite(value[:, j])
        if known.sum() > 1:
            beyond = value[known, j].var(ddof=1) - noise[known, j].mean()
            out[j] = max(float(beyond), 0.0)
    return out, both.first - 1


def _weighted_median(values: Array, sd: Array) -> tuple[float, float]:
    """Weighted median, and the spread beyond the deviations."""
    order = np.argsort(values)
    share = np.cumsum(1 / (sd[order] + 0.01)) * (0.01 + sd.min())
    middle = values[order][int(np.searchsorted(share, 0.5 * share[-1]))]
    gap = 1.48 * float(np.median(np.abs(values - middle)))
    return float(middle), float(np.sqrt(max(gap**2 - np.median(sd) ** 2, 0.0)))


def project_out_nuisance(
    both: EpochRows, groups: Sequence[CandidateColumns]
) -> "NuisanceFit":
    """The joints with what any arm has projected out, its warmth by log included."""
    design, rules = both.design, both.rules
    plain, shared, held, noise = {}, {}, {}, {}
    for j in both.analyzable_joints:
        common_columns = design.columns(j, design.present(j, both.shared)[0])
        # By the first epoch: nothing that changed may look like a trait of the arm.
        first = ~both.layout[j].second
        joined, layout = design.target[j][first], _first_layout(both.layout[j])
        alone = JointRows(common_columns[first], joined, layout, light=True)
        joined = nuisance_columns(design, j, groups, first, alone, rules)
        shared[j], noise[j] = (
            np.hstack([common_columns, joined]),
            _noise_variance(both, alone, j),
        )
        # The same freedom of torque for every column.
        firm = noise[j] / (rules.nuisance_torque_share * design.rms[j]) ** 2
        held[j] = firm * (shared[j] ** 2).mean(axis=0)
        plain[j] = JointRows(shared[j], both.residuals[j], both.layout[j], held[j])
    warm = fit_friction_drift(both, plain, shared)
    joints, first = {}, {}
    for j in plain:
        layout, f = both.layout[j], both.friction[j]
        y = both.residuals[j] - warm.factor * f * layout.second
        joined, firm = _friction_by_log(both, j, noise[j], warm)
        columns, firm = np.hstack([shared[j], joined]), np.concatenate([held[j], firm])
        joints[j] = JointRows(columns, y, layout, firm)
        rows = ~layout.second
        first[j] = JointRows(columns[rows], y[rows], _first_layout(layout), firm)
    return NuisanceFit(joints, first, warm)


def _noise_variance(both: EpochRows, alone: JointRows, j: int) -> float:
    """Variance of independent rows [N^2 m^2], of the first epoch by itself.

    No change can be in it, as it may be in what a fit of both epochs leaves.
    """
    line = np.zeros(len(both.layout[j].second))
    line[~both.layout[j].second] = alone.y
    slow = max(estimate_autocorrelation_time(both.design.line(j, line)), 1.0)
    floor = (FLOOR * both.design.rms[j]) ** 2
    return slow * (float(alone.y @ alone.y) / max(alone.degrees, 1.0) + floor)


def _friction_by_log(
    both: EpochRows, j: int, noise: float, warm: FrictionDrift
) -> tuple[Array, Array]:
    """Friction of each log, its slope, that of the second epoch; how firmly it is held.

    And how exactly a joint reports what is known to have changed.

    Returns:
        Shapes (rows, k), (k,).
    """
    layout, f = both.layout[j], both.friction[j]
    logs = np.unique(layout.log)
    own = layout.log[:, None] == logs
    ramp = np.zeros(len(f))
    for i, _ in enumerate(logs):
        rows = np.flatnonzero(own[:, i])
        ramp[rows] = np.linspace(-1, 1, len(rows))
    # Friction that is more one way than the other warms as well.
    epoch = np.column_stack([f, np.abs(f)]) * layout.second[:, None]
    columns = [f[:, None] * own, (f * ramp)[:, None] * own, epoch]
    rules, count = both.rules, len(logs)
    moved, spread = abs(warm.factor), float(warm.per_joint[j])
    sd = [spread] * count + [rules.ramp_share + 0.2 * moved] * count
    sd += [spread, rules.asymmetry_share * (moved + spread)]
    if both.changed:
        # Each drive reports what it bears with a gain of its own.
        columns.append(both.changed[j][:, None])
        sd.append(rules.gain_share)
    return np.hstack(columns), noise / np.array(sd) ** 2


def _first_layout(layout: RowLayout) -> RowLayout:
    rows = ~layout.second
    count = int(rows[layout.starts].sum())
    return RowLayout(
        layout.second[rows], layout.log[rows], layout.starts[:count], layout.blocks
    )


def measure_noise(
    both: EpochRows, nuisance_fit: "NuisanceFit", groups: Sequence[CandidateColumns]
) -> JointNoise:
    """What errors are, as the first epoch shows them: nothing changed within it."""
    dof = both.design.dof
    variance, slow = np.ones(dof), np.full(dof, both.rules.rows_per_independent)
    restless, fewest = np.ones(dof), []
    for j, joint in nuisance_fit.first.items():
        blocks = both.layout[j].second[both.layout[j].starts]
        fewest.append(min(blocks.sum(), (~blocks).sum()))
        variance[j] = joint.y @ joint.y / max(joint.degrees, 1.0)
        variance[j] += (FLOOR * both.design.rms[j]) ** 2
        basic = [g for g in groups if g.joints == (j,)]
        slow[j], restless[j] = _compare_logs(both, joint, basic, float(variance[j]))
    return JointNoise(variance, slow, restless, float(np.median(fewest or [1.0])))


def select_basic_groups(groups: Sequence[CandidateColumns]) -> list[CandidateColumns]:
    """What logs are compared by."""
    return [g for g in groups if is_single_column_group(g)]


def is_single_column_group(group: CandidateColumns) -> bool:
    """Whether it is one column on one joint, without a shape."""
    local = group.effect.scope == "local"
    return local and group.shape == () and len(group.ids) == 1


def _compare_logs(
    both: EpochRows,
    joint: JointRows,
    groups: Sequence[CandidateColumns],
    variance: float,
) -> tuple[float, float]:
    """Rows that are as good as one, and by how much logs differ beyond that.

    The second is a factor on standard deviations, of all candidates and logs together:
    three logs give a score of values, and no single one decides.
    """
    parts, few = _parts(joint.layout, both.rules.parts)
    least = both.rules.few_logs_factor if few else both.rules.logs_factor
    if not groups or not parts:
        return both.rules.rows_per_independent, max(least, 2.0)
    (j,) = groups[0].joints
    ids = np.concatenate([g.ids for g in groups])
    columns = both.design.columns(j, both.design.present(j, ids)[0])[: len(joint.y)]
    slow, ratios = [], []
    for mask in parts:
        power = (columns[mask] ** 2).sum(axis=0)
        made = joint.pieces(columns, mask, [1] * len(groups))
        for piece, size in zip(made, power, strict=True):
            if float(piece.plain[0, 0]) > 1e-3 * size:
                pace, ratio = _ratio(piece, variance)
                slow.append(pace)
                ratios.append(ratio)
    if not ratios:
        return both.rules.rows_per_independent, max(least, 2.0)
    kept = np.sort(ratios)[: max(1, int(TRIM * len(ratios)))]
    return max(float(np.median(slow)), 1.0), max(least, float(np.sqrt(np.mean(kept))))


def _ratio(piece: ProjectedColumns, variance: float) -> tuple[float, float]:
    """Rows per independent row, and a squared normal score, of one contrast."""
    gram, plain = float(piece.gram[0, 0]), float(piece.plain[0, 0])
    lever, theta = piece.lever[:, 0, 0], float(piece.cross[0]) / gram
    score = (piece.pull[:, 0] - lever * theta) / np.maximum(1 - lever / gram, 0.1)
    power = float((score**2).sum())
    seen = max(int((lever > 0.02 * gram).sum()) - 1, 2)
    total = max(power * gram / plain, 1e-300)
    square = np.log1p((theta * gram) ** 2 / total / seen)
    # Of Student's t with so many degrees the logarithm is this on average.
    usual = psi((seen + 1) / 2) - psi(seen / 2)
    return power / plain / variance, float(square / usual)


def _parts(layout: RowLayout, parts: int) -> tuple[list[Array], bool]:
    """Rows of each log, or of parts where logs are few; whether they are few."""
    logs = [layout.log == i for i in np.unique(layout.log)]
    logs = [x for x in logs if x.sum() >= FEWEST]
    if len(logs) >= 3:
        return logs, False
    out = []
    for own in np.array_split(np.arange(len(layout.log)), parts):
        mask = np.zeros(len(layout.log), dtype=bool)
        mask[own] = True
        out.append(mask)
    return [x for x in out if x.sum() >= FEWEST], True
