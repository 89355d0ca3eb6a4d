"""From tested members to findings, and the residual that each of them explains."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.angle_noise import Checked
from residual.diagnosis.examine import Examined
from residual.diagnosis.gate import Tested, alternatives
from residual.diagnosis.uncertainty import standard_deviations
from residual.effects.base import Effect
from residual.evidence.design import Group
from residual.evidence.fit import Fit
from residual.model.compare import Cloud
from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Named:
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
    examined: Examined,
    fitted: Fit,
    tested: Sequence[Tested],
    checks: Checked | None = None,
) -> list[Named]:
    """Merge members of one name into one finding; what explains most comes first.

    Args:
        examined: The diagnosis.
        fitted: Fit of exactly these members.
        tested: The members that are named.
        checks: What noise of the angles does to the fit; None where nobody looked.
    """
    sizes = {
        id(t.group): checks.estimate(t) if checks else _exactly(fitted.of(t.group))
        for t in tested
    }
    stds = standard_deviations(examined, fitted, sizes)
    near = {id(t): alternatives(examined.task, fitted, t.group) for t in tested}
    out = []
    for members in _merged(tested):
        options = [near[id(t)] for t in members]
        out.append(
            Named(
                tuple(members),
                tuple(j for t in members for j in public_joints(t.group)),
                _parameters(examined, members, sizes, stds),
                _equivalents(members, [o[0] for o in options]),
                min(o[1] for o in options),
            )
        )
    return sorted(out, key=lambda f: (-f.fall, -f.nats))


def _exactly(theta: Array) -> tuple[Array, Array]:
    return theta, np.zeros((len(theta), len(theta)))


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


def _parameters(examined: Examined, members, sizes, stds) -> dict:
    robot = examined.logs.robot
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


def clouds(
    examined: Examined, fitted: Fit, found: Sequence[Named]
) -> tuple[Cloud, ...]:
    """One cloud per finding and joint on which it acts most."""
    design = examined.task.design
    out = []
    for finding in found:
        for tested in finding.tested:
            group = tested.group
            joints = group.joints if group.effect.scope == "local" else (tested.joint,)
            for j in joints:
                place, have = design.present(j, group.ids)
                effect = design.columns(j, place) @ fitted.of(group)[have]
                left = design.residual(j, fitted.ids, fitted.theta)
                anchor = j if group.effect.scope == "local" else tested.joint
                x, label, log = _variable(examined, group.effect, anchor, j)
                out.append(
                    Cloud(
                        group.effect.name, j + 1, label, x, left + effect, effect, log
                    )
                )
    return tuple(out)


def _variable(
    examined: Examined, effect, anchor: int, j: int
) -> tuple[Array, str, Array]:
    """The explaining variable on the rows of joint j, and which log each is of."""
    values, labels, label = [], [], ""
    states = examined.task.design.states
    for track, state in zip(examined.logs.tracks, states, strict=True):
        x, label = effect.variable(state, anchor)
        rows = track.moving[:, j]
        values.append(x[:: track.step][rows])
        labels.append(np.full(int(rows.sum()), track.id))
    return np.concatenate(values), label, np.concatenate(labels)
