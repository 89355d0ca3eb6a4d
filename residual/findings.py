"""From tested members to findings: one per name, with parameters and alternatives."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.design import Design, Group
from residual.diagnose import Diagnosis
from residual.effects.base import Effect
from residual.evidence import Fit, fit
from residual.gate import Tested, alternatives
from residual.instruments import INSTRUMENTS, Checked
from residual.recording import Array
from residual.search import refined

STEP = 1e-3  # relative step of the numerical derivatives


@dataclass(frozen=True, eq=False, slots=True)
class Finding:
    """One named effect on one or several joints.

    Attributes:
        tested: Its members, one per joint where the effect is local.
        joints: Joints from 1 in the vocabulary's convention.
        parameters: Per key: values and standard deviations of the members, and unit.
        equivalent: (name, joints from 1) of what cannot be told from it.
        probability: Of its class against all others; the weakest member's.
    """

    tested: tuple[Tested, ...]
    joints: tuple[int, ...]
    parameters: dict[str, tuple[Array, Array, str]]
    equivalent: tuple[tuple[str, tuple[int, ...]], ...]
    probability: float

    @property
    def effect(self) -> Effect:
        """The effect."""
        return self.tested[0].group.effect

    @property
    def nats(self) -> float:
        """Evidence of all members [nats]."""
        return sum(t.nats for t in self.tested)

    @property
    def fall(self) -> float:
        """Largest fall of a joint's left-out error, as a share of torque rms."""
        return max(t.fall for t in self.tested)


def findings(
    diagnosis: Diagnosis,
    fitted: Fit,
    tested: Sequence[Tested],
    checks: Checked | None = None,
) -> list[Finding]:
    """Merge members of one name into one finding; what explains most comes first.

    Args:
        diagnosis: The diagnosis.
        fitted: Fit of exactly these members.
        tested: The members that are named.
        checks: What noise of the angles does to the fit; None where nobody looked.
    """
    sizes = {id(t.group): _size(fitted, t, checks) for t in tested}
    stds = _standard_deviations(diagnosis, fitted, sizes)
    near = {id(t): alternatives(diagnosis.task, fitted, t.group) for t in tested}
    out = []
    for members in _merged(tested):
        options = [near[id(t)] for t in members]
        out.append(
            Finding(
                tuple(members),
                tuple(j for t in members for j in public_joints(t.group)),
                _parameters(diagnosis, members, sizes, stds),
                _equivalents(members, [o[0] for o in options]),
                min(o[1] for o in options),
            )
        )
    return sorted(out, key=lambda f: (-f.fall, -f.nats))


def public_joints(group: Group) -> tuple[int, ...]:
    """Joints from 1; empty for a global effect."""
    return tuple(j + 1 for j in group.joints)


def _merged(tested: Sequence[Tested]) -> list[list[Tested]]:
    """Members of one local name on different joints belong together."""
    out: list[list[Tested]] = []
    for t in sorted(tested, key=lambda t: (t.group.effect.name, t.group.joints)):
        mine = t.group
        for members in out:
            other = members[-1].group
            same = other.effect.name == mine.effect.name
            if same and mine.effect.scope == "local" and other.joints != mine.joints:
                members.append(t)
                break
        else:
            out.append([t])
    return out


def _equivalents(members, near) -> tuple:
    """Alternatives that hold for every member, its own name excluded."""
    name = members[0].group.effect.name
    per_member = [
        {
            g.effect.name if len(members) > 1 else (g.effect.name, public_joints(g)): g
            for g in groups
            if g.effect.name != name or len(members) == 1
        }
        for groups in near
    ]
    shared = [k for k in per_member[0] if all(k in other for other in per_member)]
    if len(members) == 1:
        return tuple(shared)
    joints = tuple(j for t in members for j in public_joints(t.group))
    return tuple((k, joints) for k in shared)


def _size(fitted: Fit, tested: Tested, checks: Checked | None) -> tuple[Array, Array]:
    """Coefficients of a member and what is doubtful beside its noise. (k,), (k, k).

    Where the reference contradicts least squares, it is believed.
    """
    theta = fitted.of(tested.group)
    if checks is None:
        return theta, np.zeros((len(theta), len(theta)))
    shift, spread = checks.doubt(tested)
    if checks.differs(tested):
        return theta + shift, spread
    reference = checks.how == INSTRUMENTS
    return theta, 0 * spread if reference else np.outer(shift, shift)


def _parameters(diagnosis: Diagnosis, members, sizes, stds) -> dict:
    robot = diagnosis.logs.robot
    effect = members[0].group.effect
    values = np.array(
        [effect.values(sizes[id(t.group)][0], t.group.shape, robot) for t in members]
    )
    sds = np.array([stds[id(t.group)] for t in members])
    keys = list(effect.parameters.items())
    return {
        key: (values[:, i], sds[:, i], unit)
        for i, (key, unit) in enumerate(keys)
        if effect.reports is None or effect.reports(key, values[0], sds[0])
    }


def _standard_deviations(diagnosis: Diagnosis, fitted: Fit, sizes) -> dict[int, Array]:
    """Standard deviation of every parameter of every member.

    A searched shape is uncertain too: its derivative columns join the fit
    (Gauss-Newton), and the parameters' covariance follows by linearisation.
    """
    task = diagnosis.task
    extra = {id(g): _slope(task.design, g, fitted.of(g)) for g in fitted.members}
    slopes = [s for s in extra.values() if s is not None]
    full = fit(
        task.design,
        diagnosis.wide,
        (*fitted.members, *slopes),
        fitted.counted,
        fitted.variance,
        rounds=1,
    )
    covariance, between = full.covariance(), _between_logs(task.design, full)
    out = {}
    for g in fitted.members:
        slope = extra[id(g)]
        slots = full.slots(g)
        if slope is not None:
            slots = np.concatenate([slots, full.slots(slope)])
        theta, doubt = sizes[id(g)]
        jacobian = _jacobian(g, theta, diagnosis.logs.robot, slope is not None)
        own = [c[np.ix_(slots, slots)] for c in (covariance, between)]
        for c in own:
            c[: len(theta), : len(theta)] += doubt
        variance = [np.einsum("ij,jk,ik->i", jacobian, c, jacobian) for c in own]
        variance.append(_form_doubt(diagnosis, fitted, g) ** 2)
        out[id(g)] = np.sqrt(np.maximum.reduce(variance))
    return out


def _between_logs(design: Design, full: Fit) -> Array:
    """Covariance by how much the logs disagree on the coefficients. Shape (m, m).

    No effect has the very form of a textbook, and what is left of it pulls each log its
    own way: a sandwich of the scores of the folds (Liang & Zeger 1986), with the usual
    correction for their small number.
    """
    weight = full.counted / design.rows / full.variance
    pulls = np.zeros((design.folds, len(full.ids)))
    for j in range(design.dof):
        place, have = design.present(j, full.ids)
        gram = design.gram[j][:, place[:, None], place]
        left = design.cross[j][:, place] - gram @ full.theta[have]
        pulls[:, have] += weight[j] * left
    pulls -= pulls.mean(axis=0)  # the prior's own pull is shared by all
    moved = pulls @ full.covariance()
    return design.folds / max(design.folds - 1, 1) * moved.T @ moved


def _form_doubt(diagnosis: Diagnosis, fitted: Fit, group: Group) -> Array:
    """Half of what another form of the same effect would change. Shape (parameters,).

    Stribeck's curve falls as exp(-x) in one textbook and as exp(-x^2) in another: what
    logs hold of it does not reach down to standstill, where its level is said.
    """
    task, effect = diagnosis.task, group.effect
    robot = diagnosis.logs.robot
    own = np.asarray(effect.values(fitted.of(group), group.shape, robot), dtype=float)
    anchor = group.joints[0] if group.joints else 0
    forms = {shape[1:] for shape in effect.shapes(diagnosis.logs.span, anchor)}
    doubt = np.zeros_like(own)
    for form in sorted(forms - {group.shape[1:]}):
        shape = (group.shape[0], *form)
        made = task.design.add([(effect, group.joints, shape)])
        rest = [g for g in fitted.members if g is not group]
        *_, best = refined(task, (*rest, *made), fitted)
        theta = task.fit((*rest, best), fitted).of(best)
        doubt = np.maximum(
            doubt, abs(effect.values(theta, best.shape, robot) - own) / 2
        )
    return doubt


def _slope(design: Design, group: Group, theta: Array) -> Group | None:
    """Column of the derivative to the searched shape, as a group of its own."""
    effect = group.effect
    if effect.refine is None:
        return None
    x, rest = group.shape[0], group.shape[1:]
    step = STEP * abs(x)

    def columns(state, joints, shape):
        above = effect.columns(state, joints, (x + step, *rest))
        below = effect.columns(state, joints, (x - step, *rest))
        return ((above - below) @ theta / (2 * step))[:, :, None]

    derivative = Effect(effect.name, "", {}, columns, effect.scope)
    (made,) = design.add([(derivative, group.joints, ())])
    # The search was confined to the shape's own scale: 100 % of it, one sigma.
    width = abs(x)
    return Group(
        derivative, group.joints, (), made.ids, np.eye(1) / width**2, -2 * np.log(width)
    )


def _jacobian(group: Group, theta: Array, robot, with_shape: bool) -> Array:
    """Derivative of the parameter values to coefficients (and the first shape)."""
    effect = group.effect
    start = np.concatenate([theta, group.shape[:1] if with_shape else []])

    def values(x: Array) -> Array:
        shape = (x[-1], *group.shape[1:]) if with_shape else group.shape
        return np.asarray(effect.values(x[: len(theta)], shape, robot), dtype=float)

    columns = []
    for i, x in enumerate(start):
        step = STEP * max(abs(x), 1e-6)
        shift = np.eye(len(start))[i] * step
        columns.append((values(start + shift) - values(start - shift)) / (2 * step))
    return np.column_stack(columns)
