"""The verdict on two epochs: what changed, by how much, and what would have shown."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from residual.changes.contrast import Candidate, expected_evidence
from residual.changes.models import Epoch, values_that_changed
from residual.changes.search import ChangeSearch, NamedChange
from residual.changes.unexplained import Residuals, strongest_variable
from residual.check.result import LogCheck
from residual.effects.base import Effect, Trait
from residual.evidence.embodied import PossibleModel
from residual.model.compare import Cloud
from residual.quantity import along, plain
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
    with_model_values,
)

LADDER = np.geomspace(1.0, 1e4, 400)  # deviations at which to look


def minimum_detectable(found: ChangeSearch) -> list[Detectable]:
    """Smallest size of every effect and joint at which the evidence is expected.

    By the very information of the logs and the unrest of the first epoch by which a
    change is judged. Of several parameters of one unit it is the length, of a searched
    shape the usual one counts.
    """
    keys: dict[tuple, list[Candidate]] = {}
    for c in found.every:
        keys.setdefault((c.group.effect.name, c.group.joints), []).append(c)
    named = {(c.group.effect.name, c.group.joints) for c in found.named}
    out = []
    for key, some in keys.items():
        if key in named:
            continue
        size = _least(found, some[len(some) // 2])
        if size is not None:
            name, joints = key
            robot, effect = found.both.design.states[0].robot, some[0].group.effect
            unit = next(iter(effect.units(joints, robot).values()))
            public = tuple(j + 1 for j in joints)
            out.append(Detectable(name, public, size, unit))
    return [*out, Detectable("drift", (), 2 * found.warmth.std, "1")]


def _least(found: ChangeSearch, one: Candidate) -> float | None:
    look = found.table.contrast(one, found.named)
    effect, robot = one.group.effect, found.both.design.model.robot
    sizes = []
    for way in _directions(effect, found, one):
        known = float(way @ look.information @ way)
        if known <= 0:
            continue
        per_unit, _ = found.share(one, way)
        if per_unit <= 0:
            continue
        scale = _smallest(found, one, way, look.information)
        if scale is not None:
            sizes.append(max(scale, found.both.rules.min_torque_share / per_unit))
    if not sizes:
        return None
    size = float(np.median(sizes))
    if len(one.group.ids) > 1:
        return size
    return float(abs(effect.values(np.array([size]), one.group.shape, robot)[0]))


def _smallest(
    found: ChangeSearch, one: Candidate, way: Array, information: Array
) -> float | None:
    """Size along a direction at which the expected evidence is the threshold."""
    unit = 1 / np.sqrt(float(way @ information @ way))
    sizes = unit * LADDER
    prior, nu = one.group.precision, found.table.degrees
    worth = expected_evidence(information, way, prior, nu, sizes) - one.price
    seen = worth > found.both.rules.min_nats
    return float(sizes[int(np.argmax(seen))]) if seen.any() else None


def _directions(effect: Effect, found: ChangeSearch, one: Candidate) -> Sequence[Array]:
    """Coefficients of an effect of size one, in the ways that it usually comes."""
    count = len(one.group.ids)
    if effect.unit_directions is not None:
        return effect.unit_directions(found.both.design.states, one.group.joints)
    units = list(effect.parameters.values())[:count]
    alike = len(units) == count and len(set(units)) == 1
    if count == 1 or not (Trait.PERIODIC in effect.traits or alike):
        return [np.eye(count)[0]]
    every = [np.array(u, dtype=float) for u in product((-1, 0, 1), repeat=count)]
    half = every[len(every) // 2 + 1 :]  # the others point the other way
    return [u / np.linalg.norm(u) for u in half]


DETERMINED = 0.5  # of the deviation before the logs
MOVED = 0.3  # of the warmth of all joints: from there on a joint moved with them


@dataclass(frozen=True, slots=True)
class Judgement:
    """What held-out motion says of a name: a word, and the part of the error gone."""

    word: str
    gain: float


def conclude(
    found: ChangeSearch,
    rest: Residuals,
    judged: Mapping[NamedChange, Judgement],
    error: ErrorTables,
    edit: tuple[Edit, ...],
    unproven: str | None,
    made: PossibleModel,
    epochs: tuple[Epoch, Epoch],
    declared: Sequence[str],
    check: LogCheck | None,
    warnings: Sequence[str],
) -> Verdict:
    """Return the verdict, of plain values.

    Args:
        found: What stands on the held-out logs; its changes with most torque first.
        unproven: Why the named changes do not explain the second epoch, in a sentence.
        made: The augmented model.
    """
    robot = epochs[0].model.robot
    faulty = check is not None and bool(check.certain)
    still = not any(t.moving.any() for t in epochs[1].logs.tracks)
    contradictions = (STILL,) if still else made.doubts
    doubtful = rest.flagged or found.bodiless or contradictions or faulty
    effects = (
        _finding(c, i, judged[c], robot, unproven is not None)
        for i, c in enumerate(found.changes, 1)
    )
    return Verdict(
        robot=robot.name,
        declared=tuple(declared),
        verdict="effects" if found.changes else "unknown" if doubtful else "none",
        effects=tuple(with_model_values(f, made) for f in effects),
        minimum_detectable=() if faulty else tuple(minimum_detectable(found)),
        unexplained=_unexplained(found, rest),
        error=error,
        nominal_scale=None,
        next_experiment=None,
        warnings=(
            *warnings,
            *(check.sentences if check else ()),
            *_warnings(found, error.same_run),
            *([unproven] if unproven else ()),
        ),
        log_check=check,
        contradictions=contradictions,
        drift=_drift(found),
        edit=None if faulty else edit,
        bodies=made.correction,
        frames=Frames.of(robot),
        changes=tuple(values_that_changed(*epochs, found)),
    )


def _finding(
    change: NamedChange, order: int, judged: Judgement, robot: Robot, unproven: bool
) -> Finding:
    return Finding(
        name=change.place.name,
        joints=change.place.joints,
        probability=plain(change.probability),
        order=order,
        equivalent=tuple(c.place for c in change.equivalent),
        parameters=_parameters(change, robot),
        evidence=Evidence(
            nats=plain(float(change.contrast.nats)),
            by="fit",
            held_out="neutral" if unproven else judged.word,
            held_out_gain=plain(judged.gain),
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
            plain(float(values[i])),
            plain(float(sd[i])),
            unit,
            bool(sd[i] < DETERMINED * prior[i]) if prior[i] > 0 else True,
        )
        for i, (key, unit) in enumerate(effect.units(group.joints, robot).items())
        if effect.reports is None or effect.reports(key, values, sd)
    }


def _deviations(change: NamedChange, robot: Robot, covariance: Array) -> Array:
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


def _unexplained(found: ChangeSearch, rest: Residuals) -> Unexplained:
    design = found.both.design
    power = design.rows * design.rms**2
    weight = power / power.sum()
    depends = []
    for j in rest.flagged:
        known = strongest_variable(found, rest, j)
        if known is not None:
            on, of, share = known
            name = "tau" if on == "tau_model" else on
            depends.append(
                Dependence(j + 1, name, (of + 1,), "curve", plain(share), None)
            )
    return Unexplained(
        joints=tuple(j + 1 for j in rest.flagged),
        fraction=plain(float(np.sqrt(weight @ rest.share**2))),
        noise_floor=plain(float(np.sqrt(weight @ rest.floor**2))),
        depends_on=tuple(depends),
        kind=None,
        per_joint=tuple(plain(rest.share)),
        noise_model="first epoch",
    )


def _drift(found: ChangeSearch) -> Drift | None:
    warm = found.warmth
    if not warm.significant:
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


def _warnings(found: ChangeSearch, same_run: bool) -> tuple[str, ...]:
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
            f"{group.effect.name}{where} is refuted by the held-out logs: the error "
            "is higher with it"
        )
    out += [
        f"{change.contrast.candidate.group.effect.name} is not named: the logs "
        "give a physically impossible body for it"
        for change in found.bodiless
    ]
    dead = [j for j in range(found.both.design.dof) if j not in found.both.live]
    out += [
        f"joint {j + 1} hardly moves in one of the epochs and is not compared"
        for j in dead
    ]
    return tuple(out)


def clouds(found: ChangeSearch, rest: Residuals) -> tuple[Cloud, ...]:
    """What each change explains on the joint where it is largest, over its variable."""
    out = []
    for change in found.changes:
        group, j = change.contrast.candidate.group, change.joint
        joint, design = found.table.joints[j], found.both.design
        second = joint.layout.second
        columns = design.columns(j, design.present(j, group.ids)[0])
        torque = (columns @ change.contrast.theta)[second]
        slides = design.states[0].robot.prismatic[j]
        x, label = torque, along(EXPLAINED) if slides else EXPLAINED
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
        left = rest.residuals[j][second] + torque
        out.append(Cloud(group.effect.name, j + 1, label, x, left, torque, log))
    return tuple(out)
