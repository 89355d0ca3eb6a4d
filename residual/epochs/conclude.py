"""The verdict on two epochs: what changed, by how much, and what would have shown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.causes.alternative import Place
from residual.diagnosis.conclude import error_tables
from residual.diagnosis.drift import Drift
from residual.diagnosis.leftover.remainder import Dependence, Unexplained
from residual.diagnosis.result import (
    PLAIN,
    STAGES,
    Evidence,
    Finding,
    Parameter,
    Verdict,
)
from residual.epochs.contrast import Candidate
from residual.epochs.detectable import minimum_detectable
from residual.epochs.models import Epoch, values_that_changed
from residual.epochs.search import Change, Found
from residual.epochs.unnamed import Rest, follows
from residual.model.compare import Cloud, Errors
from residual.plain import plain
from residual.recording import Array
from residual.robot.robot import Robot

DETERMINED = 0.5  # of the deviation before the logs
MOVED = 0.3  # of the warmth of all joints: from there on a joint moved with them


@dataclass(frozen=True, slots=True)
class Judged:
    """What held-out motion says of a name: a word, and the part of the error gone."""

    word: str
    gain: float


def conclude(
    found: Found,
    rest: Rest,
    judged: Mapping[int, Judged],
    errors: Mapping[str, Errors],
    epochs: tuple[Epoch, Epoch],
    declared: Sequence[str],
    logs: tuple[Sequence[str], bool],
) -> Verdict:
    """Return the verdict, of plain values.

    Args:
        logs: Labels of the held-out logs, and whether they are a part of a fit log.
    """
    robot = epochs[0].model.robot
    flagged = rest.flagged
    nothing = "unknown" if flagged else "none"
    every = sorted(found.changes, key=lambda c: -c.share)
    return Verdict(
        robot=robot.name,
        declared=tuple(declared),
        verdict="effects" if every else nothing,
        effects=tuple(
            _finding(c, i, judged[id(c)], robot, found) for i, c in enumerate(every, 1)
        ),
        minimum_detectable=tuple(minimum_detectable(found)),
        unexplained=_unexplained(found, rest, flagged),
        error=error_tables(
            {name: errors.get(name) for name in (*STAGES, PLAIN)},
            min(t.cutoff for t in found.both.logs.tracks),
            *logs,
        ),
        nominal_scale=None,
        next_experiment=None,
        warnings=_warnings(found, logs[1]),
        drift=_drift(found),
        changes=tuple(values_that_changed(*epochs, found)),
    )


def _finding(
    change: Change, order: int, judged: Judged, robot: Robot, found: Found
) -> Finding:
    look = change.contrast
    group = look.candidate.group
    return Finding(
        name=group.effect.name,
        joints=_public(look.candidate),
        probability=plain(change.probability),
        order=order,
        equivalent=tuple(
            Place(c.group.effect.name, _public(c)) for c in change.equivalent
        ),
        parameters=_parameters(change, robot),
        evidence=Evidence(
            nats=plain(float(look.nats)),
            by="fit",
            held_out=judged.word,
            held_out_gain=plain(judged.gain),
            p_value=None,
            splits=None,
        ),
    )


def _public(one: Candidate) -> tuple[int, ...]:
    return tuple(j + 1 for j in one.group.joints)


def _parameters(change: Change, robot: Robot) -> dict[str, Parameter]:
    look = change.contrast
    group, theta = look.candidate.group, look.theta
    effect = group.effect
    values = np.asarray(effect.values(theta, group.shape, robot), dtype=float)
    sd = _deviations(change, robot, look.covariance)
    before = np.linalg.inv(group.precision)
    prior = _deviations(change, robot, before)
    return {
        key: Parameter(
            plain(float(values[i])),
            plain(float(sd[i])),
            unit,
            bool(sd[i] < DETERMINED * prior[i]) if prior[i] > 0 else True,
        )
        for i, (key, unit) in enumerate(effect.parameters.items())
        if effect.reports is None or effect.reports(key, values, sd)
    }


def _deviations(change: Change, robot: Robot, covariance: Array) -> Array:
    """Deviations of the parameters by those of the coefficients. (parameters,)."""
    group, theta = change.contrast.candidate.group, change.contrast.theta
    at = np.asarray(group.effect.values(theta, group.shape, robot), dtype=float)
    sizes = np.sqrt(np.maximum(np.diag(change.contrast.covariance), 1e-24))
    slope = np.empty((len(at), len(theta)))
    for i, size in enumerate(sizes):
        moved = theta.copy()
        moved[i] += 1e-3 * size
        slope[:, i] = (group.effect.values(moved, group.shape, robot) - at) / (
            1e-3 * size
        )
    inexact = group.effect.inexact * np.abs(at)
    return np.sqrt(np.diag(slope @ covariance @ slope.T) + inexact**2)


def _unexplained(found: Found, rest: Rest, flagged: Sequence[int]) -> Unexplained:
    design = found.both.design
    power = design.rows * design.rms**2
    weight = power / power.sum()
    depends = []
    for j in flagged:
        known = follows(found, rest, j)
        if known is not None:
            on, of, share = known
            name = "tau" if on == "tau_model" else on
            depends.append(
                Dependence(j + 1, name, (of + 1,), "curve", plain(share), None)
            )
    return Unexplained(
        joints=tuple(j + 1 for j in flagged),
        fraction=plain(float(np.sqrt(weight @ rest.share**2))),
        noise_floor=plain(float(np.sqrt(weight @ rest.floor**2))),
        depends_on=tuple(depends),
        kind=None,
        per_joint=tuple(plain(rest.share)),
        noise_model="first epoch",
    )


def _drift(found: Found) -> Drift | None:
    warm = found.warmth
    if not warm.told:
        return None
    moved = np.nan_to_num(warm.each) * np.sign(warm.factor)
    joints = np.flatnonzero(moved > MOVED * abs(warm.factor))
    clock = "order" if found.both.logs.clock is None else "recording time"
    return Drift(
        factor=plain(1 + warm.factor),
        std=plain(warm.std),
        joints=tuple(int(j) + 1 for j in joints),
        clock=clock,
    )


def _warnings(found: Found, same_run: bool) -> tuple[str, ...]:
    out = []
    if same_run:
        out.append(
            "the held-out samples are the last quarter of a fit log: a weak proof; "
            "give a separate run with --holdout"
        )
    for change in found.refuted:
        group = change.contrast.candidate.group
        where = "".join(f" J{j + 1}" for j in group.joints)
        out.append(
            f"{group.effect.name}{where} is refuted by the held-out logs, where the "
            "error is higher with it"
        )
    dead = [j for j in range(found.both.design.dof) if j not in found.both.live]
    out += [
        f"joint {j + 1} hardly moves in one of the epochs: nothing can be said of it"
        for j in dead
    ]
    return tuple(out)


def clouds(found: Found, rest: Rest) -> tuple[Cloud, ...]:
    """What each change explains on the joint where it is largest, over its variable."""
    out = []
    for change in found.changes:
        group, j = change.contrast.candidate.group, change.joint
        joint, design = found.table.joints[j], found.both.design
        second = joint.layout.second
        columns = design.columns(j, design.present(j, group.ids)[0])
        torque = (columns @ change.contrast.theta)[second]
        x, label = torque, "torque that it explains [N m]"
        if group.effect.variable is not None:
            anchor = group.joints[0] if group.effect.scope == "local" else j
            seen = [group.effect.variable(s, anchor) for s in design.states]
            label = seen[0][1]
            per_log = [
                np.repeat(values[:: t.step, None], design.dof, axis=1)
                for (values, _), t in zip(seen, design.tracks, strict=True)
            ]
            x = design.stacked(per_log)[j][second]
        ids = np.array([t.id.split("/", 1)[-1] for t in design.tracks])
        log = ids[joint.layout.log[second].astype(int)]
        left = rest.left[j][second] + torque
        out.append(Cloud(group.effect.name, j + 1, label, x, left, torque, log))
    return tuple(out)
