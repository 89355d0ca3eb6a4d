"""The smallest effect that these logs would have shown."""

from collections.abc import Sequence

import numpy as np

from residual.design import Group
from residual.evidence import Fit, System
from residual.recording import Array
from residual.search import Task


def minimum_detectable(task: Task, fitted: Fit) -> list[dict]:
    """Size at which the expected evidence reaches the threshold, per effect and joint.

    A true effect of size x along the first column of a group earns
    x^2 c / 2 nats, with c the information that the nominal model cannot imitate, and
    pays the group's Occam factor, its price and the threshold. It must also lower the
    joint's error by the rules' tolerance and share. Where several shapes are tried,
    the middle one counts. Linear and Gaussian, hence optimistic for small numbers.

    Returns:
        One entry per effect and joints: name, joints (from 1), value, unit.
    """
    weight = fitted.counted / task.design.rows / fitted.variance
    system = System.of(task.design, task.prior, fitted.members)
    _, lower = system.solve(weight)
    out = []
    for groups in _per_key(task.candidates.groups):
        group = groups[len(groups) // 2]
        if group.parts or group.key in {g.key for g in fitted.members}:
            continue
        size = _smallest(task, fitted, (system, lower, weight), group)
        unit = next(iter(group.effect.parameters.values()))
        joints = [j + 1 for j in group.joints]
        if np.isfinite(size):
            entry = {"name": group.effect.name, "joints": joints}
            out.append({**entry, "value": float(size), "unit": unit})
    return out


def _per_key(groups: Sequence[Group]) -> list[list[Group]]:
    keys: dict[tuple, list[Group]] = {}
    for g in groups:
        keys.setdefault((g.effect.name, g.joints), []).append(g)
    return list(keys.values())


def _smallest(task: Task, fitted: Fit, solved, group: Group) -> float:
    system, lower, weight = solved
    design, rules = task.design, task.rules
    information, free = _information(design, (system, lower), weight, group)
    if information[0, 0] <= 0:
        return np.inf
    occam = np.linalg.slogdet(information + group.precision)[1] - group.log_det
    needed = rules.threshold + task.candidates.cost(group) + 0.5 * max(occam, 0.0)
    by_evidence = np.sqrt(2 * needed / information[0, 0])
    fall = np.maximum(free, 1e-30)  # squared error that size 1 adds, per joint
    tolerance = design.rows * (rules.tolerance * design.rms) ** 2
    usual, clear = (fitted.sse * s / (1 - s) for s in (rules.share, rules.clear))
    lower = np.minimum(np.maximum(tolerance, usual), np.maximum(tolerance / 4, clear))
    by_error = np.sqrt(lower / fall).min()
    return float(max(by_evidence, by_error))


def _information(design, solved, weight: Array, group: Group) -> tuple[Array, Array]:
    """Information of a group beyond the fit, and its squared torque per joint."""
    system, lower = solved
    own = np.zeros((len(group.ids), len(group.ids)))
    mixed = np.zeros((len(system.ids), len(group.ids)))
    free = np.zeros(design.dof)
    for j in range(design.dof):
        _, have = design.present(j, system.ids)
        place, mine = design.present(j, group.ids)
        if not len(place):
            continue
        gram, _ = design.total(j)
        block = gram[np.ix_(place, place)]
        own[np.ix_(mine, mine)] += weight[j] * block
        cross = gram[np.ix_(design.place[j][system.ids[have]], place)]
        mixed[np.ix_(have, mine)] += weight[j] * cross
        free[j] = block[0, 0] if mine[0] == 0 else 0.0
    half = np.linalg.solve(lower, mixed)
    left = own - half.T @ half
    if own[0, 0] > 0:
        free = free * max(left[0, 0], 0.0) / own[0, 0]
    return left, free
