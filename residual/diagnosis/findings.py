"""From tested members to findings, and the residual that each of them explains."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag
from scipy.special import ndtri, stdtrit

from residual.diagnosis.errors_in_variables import AngleNoiseCheck
from residual.diagnosis.outcome import Outcome
from residual.diagnosis.rivals import find_load_alternatives
from residual.diagnosis.search import refine_last_shape
from residual.diagnosis.select import Member
from residual.effects.base import Effect, EffectTrait, PlacedEffect, Shape
from residual.evidence.design import CandidateColumns, Design
from residual.evidence.fit import Fit, NominalPrior, fit_jointly, invert_scaled
from residual.evidence.priors import OF_NAMES, PriorSpace
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import FindingScatter
from residual.quantity import convert_to_sliding_unit
from residual.recording import Array
from residual.robot.robot import Robot
from residual.verdict.result import EXPLAINED

USUAL = 0.975  # quantile at two standard deviations
STEP = 1e-3  # relative step of the numerical derivatives


@dataclass(frozen=True, eq=False, slots=True)
class MemberUncertainty:
    """The uncertainty of a member."""

    std: Array  # standard deviation of each parameter, (parameters,)
    prior: Array  # the same before the logs, (parameters,)
    theta: Array  # standard deviation of each coefficient, after and before, (2, k)


def estimate_uncertainties(
    outcome: Outcome, fitted: Fit, sizes: Mapping[CandidateColumns, tuple[Array, Array]]
) -> dict[CandidateColumns, MemberUncertainty]:
    """Standard deviation of every parameter of every member.

    The largest of three: by the noise, by the disagreement of logs, and by other forms
    of the effect. A searched shape is uncertain too: its derivative columns join the fit
    (Gauss-Newton), and the parameters' covariance follows by linearisation.

    Args:
        sizes: For each member its coefficients and their covariance beyond the noise.
            Shapes (k,), (k, k).

    Returns:
        The uncertainty of each member.
    """
    design, robot = outcome.design, outcome.logs.robot
    extra = {g: _slope(design, g, fitted.of(g)) for g in fitted.members}
    slopes = [s for s in extra.values() if s is not None]
    members = (*fitted.members, *slopes)
    known = fitted.counted, fitted.variance, 1
    full = fit_jointly(design, outcome.selection.wide, members, *known)
    covariance, between = full.covariance(), covariance_between_logs(design, full)
    out = {}
    for g in sizes:
        slope, (theta, doubt) = extra[g], sizes[g]
        slots = full.slots(g)
        if slope is not None:
            slots = np.concatenate([slots, full.slots(slope)])
        searched = slope is not None
        jacobian = values_jacobian(g.effect, theta, g.shape, robot, searched)
        covariances = [c[np.ix_(slots, slots)] for c in (covariance, between)]
        for c in covariances:
            c[: len(theta), : len(theta)] += doubt
        form = _form_doubt(outcome, fitted, g)
        prior = _prior_std(g, slope, jacobian)
        out[g] = _doubt(g, theta, covariances, jacobian, form, prior)
    return out


def rougher_body_prior(outcome: Outcome) -> NominalPrior:
    """The prior for the test of wrong values: bodies one step rougher.

    Their scale is an estimate from few base parameters, accurate to one step.
    """
    prior, wide = outcome.prior, outcome.selection.wide
    if prior.scale >= wide.scale:
        return wide
    rougher = min([s for s in OF_NAMES if s > prior.scale], default=wide.scale)
    space = PriorSpace(outcome.design, outcome.nominal)
    return space.at(min(rougher, wide.scale), prior.widths)


def _doubt(
    group: CandidateColumns,
    theta: Array,
    covariances: Sequence[Array],
    jacobian: Array,
    form: Array,
    prior: Array,
) -> MemberUncertainty:
    """Combine the covariances of one member: by noise, and between logs."""
    variance = [np.einsum("ij,jk,ik->i", jacobian, c, jacobian) for c in covariances]
    std = np.sqrt(np.maximum.reduce([*variance, form**2]))
    k = len(theta)
    before = np.diag(invert_scaled(group.precision))
    after = np.maximum.reduce([np.diag(c)[:k] for c in covariances])
    deviations = np.sqrt(np.maximum([after, before], 0.0))
    return MemberUncertainty(std, prior, deviations)


def _prior_std(group: CandidateColumns, slope: CandidateColumns | None, jacobian: Array) -> Array:
    """Standard deviation of the parameters by the prior alone. Shape (parameters,)."""
    parts = [group, *([] if slope is None else [slope])]
    blocks = [invert_scaled(part.precision) for part in parts]
    covariance = block_diag(*blocks)
    return np.sqrt(np.einsum("ij,jk,ik->i", jacobian, covariance, jacobian))


def covariance_between_logs(design: Design, full: Fit) -> Array:
    """Covariance from the disagreement of logs on the coefficients. Shape (m, m).

    No effect has exactly the form of a textbook, and the misfit differs from log to log:
    a sandwich of the scores of the folds (Liang & Zeger 1986). With few folds, two
    standard deviations are widened to the coverage of Student's t.
    """
    weight, label = full.weight, design.label_logs()
    count = int(label.max()) + 1
    pulls = np.zeros((count, len(full.ids)))
    for j in range(design.dof):
        place, have = design.present(j, full.ids)
        own = design.fold_pulls(j, place, full.theta[have])
        np.add.at(pulls, (label[:, None], have), weight[j] * own)
    pulls -= pulls.mean(axis=0)  # the pull of the prior is shared by all
    moved = pulls @ full.covariance()
    free = max(count - 1, 1)
    wider = float(stdtrit(free, USUAL) / ndtri(USUAL))
    return wider**2 * count / free * moved.T @ moved


def _form_doubt(outcome: Outcome, fitted: Fit, group: CandidateColumns) -> Array:
    """Half of the change by another form of the same effect. Shape (parameters,).

    Stribeck's curve falls as exp(-x) in one textbook and as exp(-x^2) in another: logs do
    not cover standstill, where its level is defined.
    """
    score, effect = outcome.score, group.effect
    robot = outcome.logs.robot
    values = np.asarray(effect.values(fitted.of(group), group.shape, robot), dtype=float)
    anchor = group.joints[0] if group.joints else 0
    forms = {shape[1:] for shape in effect.shapes(outcome.logs.span, anchor)}
    units = np.array(list(effect.parameters.values()))
    sizes = [np.linalg.norm(values[units == unit]) for unit in units]
    doubt = effect.inexact * np.array(sizes)
    for form in sorted(forms - {group.shape[1:]}):
        shape = (group.shape[0], *form)
        groups = score.design.add([group.placed._replace(shape=shape)])
        others = [g for g in fitted.members if g is not group]
        *_, best = refine_last_shape(score, (*others, *groups), fitted)
        theta = score.fit((*others, best), fitted).of(best)
        doubt = np.maximum(doubt, abs(effect.values(theta, best.shape, robot) - values) / 2)
    return doubt


def _slope(design: Design, group: CandidateColumns, theta: Array) -> CandidateColumns | None:
    """Column of the derivative with respect to the searched shape, as a group."""
    effect = group.effect
    if effect.refine is None:
        return None
    x, rest = group.shape[0], group.shape[1:]
    step = STEP * abs(x)

    def columns(state, joints, shape):
        above = effect.columns(state, joints, (x + step, *rest))
        below = effect.columns(state, joints, (x - step, *rest))
        return ((above - below) @ theta / (2 * step))[:, :, None]

    derivative = Effect(effect.name, "", {}, columns, scope=effect.scope)
    (steps,) = design.add([PlacedEffect(derivative, group.joints, ())])
    # The search was limited to the scale of the shape: 100 % of it, one sigma.
    width = abs(x)
    return CandidateColumns(
        derivative, group.joints, (), steps.ids, np.eye(1) / width**2, -2 * np.log(width)
    )


def values_jacobian(
    effect: Effect, theta: Array, shape: Shape, robot: Robot, with_shape: bool = False
) -> Array:
    """Derivative of an effect's parameter values to its coefficients.

    Args:
        theta: Its coefficients. Shape (k,).
        shape: Its shape.
        with_shape: Whether the first number of the shape comes last.

    Returns:
        Shape (parameters, k) or (parameters, k + 1).
    """
    start = np.concatenate([theta, shape[:1] if with_shape else []])

    def values(x: Array) -> Array:
        at = (x[-1], *shape[1:]) if with_shape else shape
        return np.asarray(effect.values(x[: len(theta)], at, robot), dtype=float)

    columns = []
    for i, x in enumerate(start):
        step = STEP * max(abs(x), 1e-6)
        shift = np.eye(len(start))[i] * step
        columns.append((values(start + shift) - values(start - shift)) / (2 * step))
    return np.column_stack(columns)


@dataclass(frozen=True, eq=False, slots=True)
class MemberConfidence:
    """The confidence in one member of a finding."""

    probability: float  # of its class against all other names and none
    doubt: MemberUncertainty  # uncertainty of its parameters

    @property
    def determined(self) -> Array:
        """Which parameters the logs determine better than the prior. (parameters,)."""
        return self.doubt.std < THRESHOLDS.determined_share * self.doubt.prior


@dataclass(frozen=True, eq=False, slots=True)
class NamedEffect:
    """One named effect on one or several joints."""

    # Its members, one per joint where the effect is local.
    tested: tuple[Member, ...]
    joints: tuple[int, ...]  # joints from 1 in the vocabulary's convention
    # Per key: values and standard deviations of the members, unit, and whether the
    # motion determines them.
    parameters: dict[str, tuple[Array, Array, str, bool]]
    # (name, joints from 1) of its equivalents there.
    equivalent: tuple[tuple[str, tuple[int, ...]], ...]
    confidences: tuple[MemberConfidence, ...]  # confidence in each member
    # Determined combinations if some of these are undetermined: value, standard
    # deviation and unit, by formula.
    combined: dict[str, tuple[float, float, str]]
    # Rms torque of each member, as a share of that of the joint on which it is most,
    # (members,).
    torque: Array

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.tested[0].group.effect

    @property
    def probability(self) -> float:
        """Of its class against all others; the weakest member's."""
        return min(s.probability for s in self.confidences)

    @property
    def nats(self) -> float:
        """Evidence of all members [nats]."""
        return sum(t.nats for t in self.tested)


def merge_into_findings(
    outcome: Outcome,
    fitted: Fit,
    tested: Sequence[Member],
    noise_check: AngleNoiseCheck | None = None,
) -> list[NamedEffect]:
    """Merge members of one name into one finding, sorted by torque.

    Args:
        noise_check: Influence of angle noise on the fit; None if not checked.
    """
    if not tested:
        return []
    sizes = {t.group: _size(fitted, t, noise_check) for t in tested}
    doubts = estimate_uncertainties(outcome, fitted, sizes)
    out, search = [], outcome.selection.search
    for members in _merge_joints(tested, outcome.logs.robot):
        sure = [MemberConfidence(t.probability, doubts[t.group]) for t in members]
        values = _parameters(outcome, members, sizes, sure)
        out.append(
            NamedEffect(
                tuple(members),
                tuple(j for t in members for j in joint_numbers(t.group)),
                values,
                _equivalents(
                    members,
                    [
                        [*t.equivalent, *find_load_alternatives(search, fitted, t.group)]
                        for t in members
                    ],
                ),
                tuple(sure),
                _combined(outcome, members[0], sizes, sure[0], values),
                np.array([_torque(outcome, fitted, t.group) for t in members]),
            )
        )
    return _order_riding(sorted(out, key=lambda f: (-f.torque.max(), -f.nats)))


def _order_riding(findings: Sequence[NamedEffect]) -> list[NamedEffect]:
    """Reorder findings: one that rides on another of its size comes first.

    Presliding friction is reported on top of a constant level: a missing contact is
    both, and the former name describes it.
    """
    out = list(findings)
    for rider in findings:
        for base in findings:
            if rider.effect.rides_on == base.effect.name and _rides_on(rider, base):
                place = min(out.index(rider), out.index(base))
                out.remove(rider)
                out.insert(place, rider)
    return out


def _rides_on(rider: NamedEffect, base: NamedEffect) -> bool:
    """Whether a finding has half the size of another on a shared joint."""
    sizes = [
        dict(zip(f.joints, np.abs(next(iter(f.parameters.values()))[0]), strict=True))
        for f in (rider, base)
    ]
    shared = sizes[0].keys() & sizes[1].keys()
    return any(sizes[0][j] >= THRESHOLDS.rides_share * sizes[1][j] for j in shared)


def _torque(outcome: Outcome, fitted: Fit, group: CandidateColumns) -> float:
    """Largest rms torque of a member on any joint, as a share of the joint's rms."""
    design, out = outcome.design, 0.0
    for j in range(design.dof):
        torque = design.torque(group, fitted.of(group), j)
        if torque.any():  # a joint may log no torque
            out = max(out, float(np.sqrt(np.mean(torque**2))) / design.rms[j])
    return out


def _size(fitted: Fit, tested: Member, checks: AngleNoiseCheck | None) -> tuple[Array, Array]:
    """Reported coefficients of a member, and their additional covariance."""
    if checks:
        return checks.estimate(tested)
    theta = fitted.of(tested.group)
    return theta, np.zeros((len(theta), len(theta)))


def joint_numbers(group: CandidateColumns) -> tuple[int, ...]:
    """Joints from 1; empty for a global effect."""
    return tuple(j + 1 for j in group.joints)


def _merge_joints(tested: Sequence[Member], robot: Robot) -> list[list[Member]]:
    """Group members of one local effect on joints of one unit."""
    out: list[list[Member]] = []
    for t in sorted(tested, key=lambda t: (t.group.effect.name, t.group.joints)):
        group = t.group
        for members in out:
            merged = members[-1].group
            same = merged.effect.name == group.effect.name and (
                group.effect.units(merged.joints, robot) == group.effect.units(group.joints, robot)
            )
            if same and group.effect.scope == "local" and merged.joints != group.joints:
                members.append(t)
                break
        else:
            out.append([t])
    return out


def _equivalents(members, near) -> tuple:
    """The equivalents of a finding; for several members, with their joints.

    A constant may be a spring on one joint and a gas spring on the next.
    """
    if len(members) == 1:
        return tuple(dict.fromkeys((g.effect.name, joint_numbers(g)) for g in near[0]))
    name, on = members[0].group.effect.name, {}
    for member, groups in zip(members, near, strict=True):
        joints = member.group.joints
        for g in dict.fromkeys(g for g in groups if g.effect.name != name):
            place = None if g.joints == joints else joint_numbers(g)
            on_joints = on.setdefault((g.effect.name, place), list(place or ()))
            on_joints += joint_numbers(member.group) if place is None else ()
    ranked = sorted(on.items(), key=lambda item: -len(item[1]))
    return tuple((other, tuple(sorted({*joints}))) for (other, _), joints in ranked)


def _parameters(outcome: Outcome, members, sizes, sure) -> dict:
    robot = outcome.logs.robot
    effect = members[0].group.effect
    values = np.array([effect.values(sizes[t.group][0], t.group.shape, robot) for t in members])
    sds = np.array([s.doubt.std for s in sure])
    keys = list(effect.units(members[0].group.joints, robot).items())
    clear = np.array([s.determined for s in sure]).all(axis=0)
    if effect.combined is not None and np.any(np.abs(values[:, 0]) < 2 * sds[:, 0]):
        # The others are ratios to a first one that may be zero.
        clear[:] = False
    return {
        key: (values[:, i], sds[:, i], unit, bool(clear[i]))
        for i, (key, unit) in enumerate(keys)
        if effect.reports is None or effect.reports(key, values[0], sds[0])
    }


def _combined(outcome: Outcome, member: Member, sizes, sure, parameters) -> dict:
    """Determined combinations of a member with undetermined parameters. By formula.

    Returns:
        Value, standard deviation and unit of those better known than by the prior.
    """
    effect, robot = member.group.effect, outcome.logs.robot
    theta, _ = sizes[member.group]
    if effect.combined is None or all(clear for *_, clear in parameters.values()):
        return {}
    units = [effect.combined(one, robot) for one in np.eye(len(theta))]
    out = {}
    for key, (value, unit) in effect.combined(theta, robot).items():
        share = np.array([one[key][0] for one in units])
        after, before = np.sqrt((share * sure.doubt.theta) ** 2 @ np.ones(len(theta)))
        if after < THRESHOLDS.determined_share * before:
            out[key] = (value, float(after), unit)
    return out


def residual_clouds(
    outcome: Outcome, fitted: Fit, findings: Sequence[NamedEffect]
) -> tuple[FindingScatter, ...]:
    """One cloud per finding and joint on which it acts most.

    An effect without a single explaining variable has one on every joint that it moves,
    over its torque.
    """
    return tuple(
        _cloud(outcome, fitted, tested, j)
        for finding in findings
        for tested in finding.tested
        for j in _drawn_on(outcome.design, fitted, tested)
    )


def _drawn_on(design: Design, fitted: Fit, tested: Member) -> Sequence[int]:
    """Joints (from 0) on which a member is plotted."""
    group = tested.group
    if group.effect.scope == "local":
        return group.joints
    if group.effect.variable is not None:
        return (tested.joint,)
    rows = group.effect.rows(group.joints, len(design.rms))
    torques = {j: design.torque(group, fitted.of(group), j) for j in rows}
    shares = {
        j: np.sqrt(np.mean(torque**2)) / design.rms[j]
        for j, torque in torques.items()
        if len(torque)  # a joint may log no torque
    }
    return [j for j in shares if shares[j] > THRESHOLDS.plotted_torque_share] or [tested.joint]


def _cloud(outcome: Outcome, fitted: Fit, tested: Member, j: int) -> FindingScatter:
    design, group = outcome.design, tested.group
    torque, rows = design.torque(group, fitted.of(group), j), design.acting(j)
    left = design.residual(j, fitted.ids, fitted.theta)[rows]
    anchor = j if group.effect.scope == "local" else tested.joint
    x, label, log = _variable(outcome, group.effect, anchor, j)
    x = torque if x is None else x[rows]
    return FindingScatter(group.effect.name, j + 1, label, x, left + torque, torque, log[rows])


def _variable(
    outcome: Outcome, effect: Effect, anchor: int, j: int
) -> tuple[Array | None, str, Array]:
    """The explaining variable on the rows of joint j, and the log of each row.

    None if that is its own torque.
    """
    prismatic = outcome.logs.robot.prismatic[j]
    values, labels, label = ([], [], convert_to_sliding_unit(EXPLAINED) if prismatic else EXPLAINED)
    states = outcome.design.states
    for track, state in zip(outcome.logs.tracks, states, strict=True):
        rows = track.moving[:, j]
        if effect.variable is not None:
            x, label = effect.variable(state, anchor)
            values.append(x[:: track.step][rows])
        labels.append(np.full(int(rows.sum()), track.id))
    return np.concatenate(values) if values else None, label, np.concatenate(labels)


def split_background(
    named: Sequence[NamedEffect], dof: int
) -> tuple[tuple[NamedEffect, ...], tuple[NamedEffect, ...]]:
    """Split the findings into listed and folded ones.

    Friction or ripple of a size common to joints is folded next to a much larger finding,
    if half of the joints have it: a single one is listed.

    Returns:
        The listed ones, and the folded ones, in the same order.
    """
    if not named:
        return tuple(named), ()
    largest = max(f.torque.max() for f in named)
    small = [f for f in named if _is_background(f, THRESHOLDS.background_share * largest)]
    if len({j for f in small for j in f.joints}) < max(
        THRESHOLDS.usual_joint_share * dof, THRESHOLDS.usual_min_joints
    ):
        small = []
    return tuple(f for f in named if f not in small), tuple(small)


def _is_background(finding: NamedEffect, least: float) -> bool:
    effect = finding.effect
    small = effect.traits & (EffectTrait.FRICTION | EffectTrait.PERIODIC)
    if not small or effect.scope != "local":
        return False
    return bool(np.all(finding.torque < min(THRESHOLDS.usual_torque_share, least)))
