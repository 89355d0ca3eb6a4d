"""The verdict on two epochs: what changed, by how much, and what would have shown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.special import stdtr

from residual.changes.contrast import ChangeCandidate, expected_evidence
from residual.changes.models import EpochFit, compare_epoch_values
from residual.changes.rows import JointRows
from residual.changes.search import ChangeSearch, NamedChange
from residual.check.result import LogCheck
from residual.effects.base import Effect, EffectTrait, State
from residual.evidence.columns import CandidateColumns, regularize_precision
from residual.evidence.fit import PossibleModel
from residual.model.compare import FindingScatter
from residual.model.nominal import FitLogs
from residual.quantity import convert_to_plain_values, convert_to_sliding_unit
from residual.recording import Array
from residual.robot.robot import Robot
from residual.verdict.result import (
    EXPLAINED,
    STILL,
    Dependence,
    Detectable,
    Drift,
    Edit,
    ErrorTables,
    Evidence,
    Finding,
    Frames,
    Parameter,
    Unexplained,
    Verdict,
    add_motor_class,
    replace_by_model_values,
)

# What changed and has no name: more than in the first epoch remains, or a curve.
#
# Every block of two seconds is predicted by a fit that left it out, in both epochs.
# Where blocks of the second are missed by more than those of the first, and by more
# than its logs differ among themselves, something is there that no name of ours
# explains. So it is where a free curve over the angle or the speed of a joint, in the
# second epoch alone, wins what a name would have to.


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
class UnexplainedChange:
    """What remains of each joint after everything that is named."""

    # What is left, by row; None for a joint that is not looked at.
    residuals: tuple[Array | None, ...]
    # Of the second epoch beyond the first, as a share of torque rms, (dof,).
    share: Array
    floor: Array  # what the first epoch leaves, likewise, (dof,)
    # Joints from 0 on which something changed that has no name.
    flagged: tuple[int, ...]


def analyze_residuals(search: ChangeSearch) -> UnexplainedChange:
    """Look for a change that no name explains."""
    both, table = search.both, search.table
    dof, rules = both.design.dof, both.rules
    share, floor = np.zeros(dof), np.zeros(dof)
    residuals: list[Array | None] = [None] * dof
    flagged = []
    thetas = table.theta(search.named)
    for j, joint in table.joints.items():
        residual = joint.y
        for c, theta in zip(search.named, thetas, strict=True):
            if j in c.pieces:
                residual = residual - c.pieces[j].columns @ theta
        residuals[j] = residual
        power, second, log = _blocks(joint, residual)
        rms = both.design.rms[j]
        before, after = power[~second], power[second]
        floor[j] = np.sqrt(before.mean()) / rms
        share[j] = np.sqrt(max(after.mean() - before.mean(), 0.0)) / rms
        sure = _excess_chance(before, after, log[~second], log[second])
        grew = share[j] > rules.unknown_torque_share and sure < CHANCE
        if grew or _has_curve(search, j):
            flagged.append(j)
    return UnexplainedChange(tuple(residuals), share, floor, tuple(flagged))


def _has_curve(search: ChangeSearch, j: int) -> bool:
    """Whether the second epoch has a free curve over the joint's motion."""
    joint, design, rules = search.table.joints[j], search.both.design, search.both.rules
    second = joint.layout.second
    q, qd, way = (
        _signal_rows(design.states, design.tracks, name, j, j, design)
        for name in ("q", "qd", "sign")
    )
    place = _hat_functions(q)
    for columns in (place, place * way[:, None], _hat_functions(qd)):
        shown = (columns[second] ** 2).sum(axis=0) > 1e-3 * second.sum()
        columns = columns[:, shown]
        curve = _curve_candidate(search, j, columns)
        look = search.table.contrast(curve, search.named)
        torque = columns[second] @ look.theta
        share = np.sqrt((torque**2).mean()) / design.rms[j]
        if look.nats > rules.unknown_nats and share > rules.unknown_torque_share:
            return True
    return False


def _hat_functions(x: Array) -> Array:
    """Linear pieces between quantiles. Shape (rows, KNOTS)."""
    knots = np.unique(np.quantile(x, np.linspace(0.01, 0.99, KNOTS)))
    return np.column_stack([np.interp(x, knots, unit) for unit in np.eye(len(knots))])


def _curve_candidate(search: ChangeSearch, j: int, columns: Array) -> ChangeCandidate:
    joint, k = search.table.joints[j], columns.shape[1]
    size = USUAL * search.both.design.rms[j]
    precision, log_det = regularize_precision(np.eye(k) / size**2)
    group = CandidateColumns(CURVE, (j,), (), np.full(k, -1), precision, log_det)
    piece = joint.pieces(columns, joint.layout.second, [k])[0]
    return ChangeCandidate(group, {j: piece}, np.log(len(search.table.joints)), group)


def _blocks(joint: JointRows, residual: Array) -> tuple[Array, Array, Array]:
    """Left-out mean square of every block; its epoch and log."""
    left_out = joint.lift(residual[:, None])[:, 0]
    starts = joint.layout.starts
    counts = np.diff([*starts, len(residual)])
    power = np.add.reduceat(left_out**2, starts) / counts
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
    spread = float(((means - means.mean()) ** 2).sum())
    between = (spread + FEW_LOGS * USUAL**2) / (free + FEW_LOGS)
    sd = np.sqrt(
        within * (1 / len(a) + 1 / len(b))
        + between * (1 / len(means) + 1 / len(np.unique(fresh)))
    )
    nu = len(a) + len(b) - 2
    # Of Student's t, the share above.
    return float(stdtr(nu, -(b.mean() - a.mean()) / max(sd, 1e-12)))


def strongest_variable(
    search: ChangeSearch, residuals: UnexplainedChange, j: int
) -> tuple[str, int, float] | None:
    """The variable that the rest of a joint goes by most: what, of which joint, share.

    None where it goes by none of them.
    """
    joint, design = search.table.joints[j], search.both.design
    second = joint.layout.second
    y = residuals.residuals[j][second]
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
    """Share of y^2 in left-out blocks that a step function of x explains."""
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


LADDER = np.geomspace(1.0, 1e4, 400)  # deviations at which to look


def find_detectable_changes(search: ChangeSearch) -> list[Detectable]:
    """Smallest size of every effect and joint at which the evidence is expected.

    By the very information of the logs and the unrest of the first epoch by which a
    change is judged. Of several parameters of one unit it is the length, of a searched
    shape the usual one counts.
    """
    keys: dict[tuple, list[ChangeCandidate]] = {}
    for c in search.every:
        keys.setdefault((c.group.effect.name, c.group.joints), []).append(c)
    named_keys = {(c.group.effect.name, c.group.joints) for c in search.named}
    out = []
    for key, shapes in keys.items():
        if key in named_keys:
            continue
        size = _least(search, shapes[len(shapes) // 2])
        if size is not None:
            name, joints = key
            robot, effect = search.both.design.states[0].robot, shapes[0].group.effect
            unit = next(iter(effect.units(joints, robot).values()))
            public = tuple(j + 1 for j in joints)
            out.append(Detectable(name, public, size, unit))
    return [*out, Detectable("drift", (), 2 * search.warmth.std, "1")]


def _least(search: ChangeSearch, candidate: ChangeCandidate) -> float | None:
    look = search.table.contrast(candidate, search.named)
    effect, robot = candidate.group.effect, search.both.design.model.robot
    sizes = []
    for direction in _directions(effect, search, candidate):
        information = float(direction @ look.information @ direction)
        if information <= 0:
            continue
        per_unit, _ = search.share(candidate, direction)
        if per_unit <= 0:
            continue
        scale = _smallest(search, candidate, direction, look.information)
        if scale is not None:
            sizes.append(max(scale, search.both.rules.min_torque_share / per_unit))
    if not sizes:
        return None
    size = float(np.median(sizes))
    if len(candidate.group.ids) > 1:
        return size
    return float(abs(effect.values(np.array([size]), candidate.group.shape, robot)[0]))


def _smallest(
    search: ChangeSearch,
    candidate: ChangeCandidate,
    direction: Array,
    information: Array,
) -> float | None:
    unit = 1 / np.sqrt(float(direction @ information @ direction))
    sizes = unit * LADDER
    prior, nu = candidate.group.precision, search.table.degrees
    worth = (
        expected_evidence(information, direction, prior, nu, sizes) - candidate.price
    )
    detected = worth > search.both.rules.min_nats
    return float(sizes[int(np.argmax(detected))]) if detected.any() else None


def _directions(
    effect: Effect, search: ChangeSearch, candidate: ChangeCandidate
) -> Sequence[Array]:
    count = len(candidate.group.ids)
    if effect.unit_directions is not None:
        return effect.unit_directions(search.both.design.states, candidate.group.joints)
    units = list(effect.parameters.values())[:count]
    alike = len(units) == count and len(set(units)) == 1
    if count == 1 or not (EffectTrait.PERIODIC in effect.traits or alike):
        return [np.eye(count)[0]]
    signs = [np.array(u, dtype=float) for u in product((-1, 0, 1), repeat=count)]
    half = signs[len(signs) // 2 + 1 :]  # the others point the other way
    return [u / np.linalg.norm(u) for u in half]


DETERMINED = 0.5  # of the deviation before the logs
MOVED = 0.3  # of the warmth of all joints: from there on a joint moved with them


@dataclass(frozen=True, slots=True)
class HeldOutJudgement:
    """What held-out motion says of a name: a word, and the part of the error gone."""

    word: str
    gain: float


def build_change_verdict(
    search: ChangeSearch,
    residuals: UnexplainedChange,
    judgements: Mapping[NamedChange, HeldOutJudgement],
    error: ErrorTables,
    edit: tuple[Edit, ...],
    unproven: str | None,
    augmented: PossibleModel,
    epochs: tuple[EpochFit, EpochFit],
    declared: Sequence[str],
    check: LogCheck | None,
    warnings: Sequence[str],
) -> Verdict:
    """Return the verdict, of plain values.

    Args:
        search: What stands on the held-out logs; its changes with most torque first.
        unproven: Why the named changes do not explain the second epoch, in a sentence.
        augmented: The augmented model.
    """
    robot = epochs[0].model.robot
    faulty = check is not None and bool(check.certain)
    still = not any(t.moving.any() for t in epochs[1].logs.tracks)
    contradictions = (STILL,) if still else augmented.doubts
    doubtful = residuals.flagged or search.without_body or contradictions or faulty
    effects = (
        _finding(c, i, judgements[c], search.both.logs, unproven is not None)
        for i, c in enumerate(search.changes, 1)
    )
    return Verdict(
        robot=robot.name,
        declared=tuple(declared),
        verdict="effects" if search.changes else "unknown" if doubtful else "none",
        effects=tuple(replace_by_model_values(f, augmented) for f in effects),
        minimum_detectable=() if faulty else tuple(find_detectable_changes(search)),
        unexplained=_unexplained(search, residuals),
        error=error,
        nominal_scale=None,
        next_experiment=None,
        warnings=(
            *warnings,
            *(check.sentences if check else ()),
            *_warnings(search, error.same_run),
            *([unproven] if unproven else ()),
        ),
        log_check=check,
        contradictions=contradictions,
        drift=_drift(search),
        edit=None if faulty else edit,
        bodies=augmented.correction,
        frames=Frames.of(robot),
        changes=tuple(compare_epoch_values(*epochs, search)),
    )


def _finding(
    change: NamedChange,
    order: int,
    judgement: HeldOutJudgement,
    logs: FitLogs,
    unproven: bool,
) -> Finding:
    return Finding(
        name=change.place.name,
        joints=change.place.joints,
        probability=convert_to_plain_values(change.probability),
        order=order,
        equivalent=add_motor_class(
            change.place, [c.place for c in change.equivalent], logs.span
        ),
        parameters=_parameters(change, logs.robot),
        evidence=Evidence(
            nats=convert_to_plain_values(float(change.contrast.nats)),
            by="fit",
            held_out="neutral" if unproven else judgement.word,
            held_out_gain=convert_to_plain_values(judgement.gain),
            splits=None,
        ),
    )


def _parameters(change: NamedChange, robot: Robot) -> dict[str, Parameter]:
    look = change.contrast
    group, theta = look.candidate.group, look.theta
    effect = group.effect
    values = np.asarray(effect.values(theta, group.shape, robot), dtype=float)
    sd = _deviations(change, robot, look.covariance)
    before = np.linalg.inv(group.precision)
    prior = _deviations(change, robot, before)
    return {
        key: Parameter(
            convert_to_plain_values(float(values[i])),
            convert_to_plain_values(float(sd[i])),
            unit,
            bool(sd[i] < DETERMINED * prior[i]) if prior[i] > 0 else True,
        )
        for i, (key, unit) in enumerate(effect.units(group.joints, robot).items())
        if effect.reports is None or effect.reports(key, values, sd)
    }


def _deviations(change: NamedChange, robot: Robot, covariance: Array) -> Array:
    """Standard deviations of the parameters. Shape (parameters,)."""
    group, theta = change.contrast.candidate.group, change.contrast.theta
    values = np.asarray(group.effect.values(theta, group.shape, robot), dtype=float)
    sizes = np.sqrt(np.maximum(np.diag(change.contrast.covariance), 1e-24))
    slope = np.empty((len(values), len(theta)))
    for i, size in enumerate(sizes):
        shifted = theta.copy()
        shifted[i] += 1e-3 * size
        slope[:, i] = (group.effect.values(shifted, group.shape, robot) - values) / (
            1e-3 * size
        )
    inexact = group.effect.inexact * np.abs(values)
    return np.sqrt(np.diag(slope @ covariance @ slope.T) + inexact**2)


def _unexplained(search: ChangeSearch, residuals: UnexplainedChange) -> Unexplained:
    design = search.both.design
    power = design.rows * design.rms**2
    weight = power / power.sum()
    depends = []
    for j in residuals.flagged:
        variable = strongest_variable(search, residuals, j)
        if variable is not None:
            on, of, share = variable
            name = "tau" if on == "tau_model" else on
            depends.append(
                Dependence(
                    j + 1,
                    name,
                    (of + 1,),
                    "curve",
                    convert_to_plain_values(share),
                    None,
                )
            )
    return Unexplained(
        joints=tuple(j + 1 for j in residuals.flagged),
        fraction=convert_to_plain_values(float(np.sqrt(weight @ residuals.share**2))),
        noise_floor=convert_to_plain_values(
            float(np.sqrt(weight @ residuals.floor**2))
        ),
        depends_on=tuple(depends),
        kind=None,
        per_joint=tuple(convert_to_plain_values(residuals.share)),
        noise_model="first epoch",
    )


def _drift(search: ChangeSearch) -> Drift | None:
    warm = search.warmth
    if not warm.significant:
        return None
    moved = np.nan_to_num(warm.each) * np.sign(warm.factor)
    joints = np.flatnonzero(moved > MOVED * abs(warm.factor))
    clock = "order" if search.both.logs.clock is None else "recording time"
    return Drift(
        factor=convert_to_plain_values(1 + warm.factor),
        std=convert_to_plain_values(warm.std),
        joints=tuple(int(j) + 1 for j in joints),
        clock=clock,
    )


def _warnings(search: ChangeSearch, same_run: bool) -> tuple[str, ...]:
    out = []
    if same_run:
        out.append(
            "the held-out samples are the last quarter of a fit log: a weak proof; "
            "give a separate run with --holdout"
        )
    for change in search.refuted:
        group = change.contrast.candidate.group
        where = "".join(f" J{j + 1}" for j in group.joints)
        out.append(
            f"{group.effect.name}{where} is refuted by the held-out logs: the error "
            "is higher with it"
        )
    out += [
        f"{change.contrast.candidate.group.effect.name} is not named: the logs "
        "give a physically impossible body for it"
        for change in search.without_body
    ]
    dead = [
        j
        for j in range(search.both.design.dof)
        if j not in search.both.analyzable_joints
    ]
    out += [
        f"joint {j + 1} hardly moves in one of the epochs and is not compared"
        for j in dead
    ]
    return tuple(out)


def change_clouds(
    search: ChangeSearch, residuals: UnexplainedChange
) -> tuple[FindingScatter, ...]:
    """What each change explains on the joint where it is largest, over its variable."""
    out = []
    for change in search.changes:
        group, j = change.contrast.candidate.group, change.joint
        joint, design = search.table.joints[j], search.both.design
        second = joint.layout.second
        columns = design.columns(j, design.present(j, group.ids)[0])
        torque = (columns @ change.contrast.theta)[second]
        slides = design.states[0].robot.prismatic[j]
        x, label = torque, convert_to_sliding_unit(EXPLAINED) if slides else EXPLAINED
        if group.effect.variable is not None:
            anchor = group.joints[0] if group.effect.scope == "local" else j
            variables = [group.effect.variable(s, anchor) for s in design.states]
            label = variables[0][1]
            per_log = [
                np.repeat(values[:: t.step, None], design.dof, axis=1)
                for (values, _), t in zip(variables, design.tracks, strict=True)
            ]
            x = design.stacked(per_log)[j][second]
        ids = np.array([t.id.split("/", 1)[-1] for t in design.tracks])
        log = ids[joint.layout.log[second].astype(int)]
        residual = residuals.residuals[j][second] + torque
        out.append(
            FindingScatter(group.effect.name, j + 1, label, x, residual, torque, log)
        )
    return tuple(out)
