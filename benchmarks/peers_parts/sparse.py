"""A sparse selection written from the description of SAPC; it is not that program.

"Fidelity Is Not Identification" (Kyung Hee University 2026) takes the residual against
an uncorrected simulator and selects a bounded number of groups (links, joints with
friction and rotor, contact) forward, by cross-validation over trajectories; no
correction is a candidate too. Our own choices: how a group is fitted, by how much it
must lower the error, and that a correction must make three times the torque that the
stated scatter of all parameters would make of it.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks.hidden.score import Name
from benchmarks.peers_parts.linear_model import DRIVES, Answer, Arm, Case, Rows
from benchmarks.peers_parts.squares import SCATTER, body, sums

Array = np.ndarray
Group = tuple[str, int]  # kind and joint from 1

MOST = 4  # groups
LEAST = 0.05  # of the error: a group that lowers it by less is not taken
BEYOND = 3.0  # times the torque that the stated scatter makes
RIDGE = 1e-6  # of a column's size


def answer(case: Case) -> Answer:
    """Return the groups that lower the error on trajectories that were left out."""
    arm = Arm(case)
    fit = _Fit(arm, [arm.rows(log) for log in case.fit])
    chosen = _selected(arm, fit)
    change = fit.change(chosen, range(len(fit.gram)))
    return Answer(tuple(_finding(arm, fit, group, change) for group in chosen))


class _Fit:
    """Sums of each log, weighted by the noise of each joint."""

    def __init__(self, arm: Arm, logs: Sequence[Rows]) -> None:
        self._arm = arm
        each = [sums([log]) for log in logs]
        gram, cross, power, rows = (sum(part) for part in zip(*each, strict=True))
        # Noise: what is left by all parameters together.
        noise = []
        for j in range(arm.dof):
            best = _solved(gram[j], cross[j])
            noise.append((power[j] - best @ cross[j]) / rows[j])
        weight = 1 / np.maximum(noise, 1e-9 * power / rows)
        self.gram = [np.einsum("j,jab->ab", weight, g) for g, _, _, _ in each]
        self.cross = [weight @ c for _, c, _, _ in each]
        self.power = [float(weight @ p) for _, _, p, _ in each]

    def change(self, groups: Sequence[Group], logs: Sequence[int]) -> Array:
        """Return parameters fitted to some logs, zero outside of the groups."""
        own = [i for group in groups for i in _places(self._arm, group)]
        out = np.zeros(len(self.cross[0]))
        if own:
            gram = sum(self.gram[k] for k in logs)[np.ix_(own, own)]
            out[own] = _solved(gram, sum(self.cross[k] for k in logs)[own])
        return out

    def error(self, groups: Sequence[Group]) -> float:
        """Return the squared error on logs left out in turn, in units of noise."""
        every, total = range(len(self.gram)), 0.0
        for left in every:
            change = self.change(groups, [k for k in every if k != left])
            total += self.power[left] - 2 * change @ self.cross[left]
            total += change @ self.gram[left] @ change
        return total

    def beyond(self, groups: Sequence[Group]) -> bool:
        """Whether a correction is more than scatter of all others would look like."""
        whole = sum(self.gram)
        own = [i for group in groups for i in _places(self._arm, group)]
        last = slice(-len(_places(self._arm, groups[-1])), None)
        change = _solved(whole[np.ix_(own, own)], sum(self.cross)[own])[last]
        made = _solved(whole[np.ix_(own, own)], whole[own])[last]
        made = made * (SCATTER * self._arm.nominal)
        torque = whole[np.ix_(own[last], own[last])]
        expected = np.trace(made.T @ torque @ made)
        return bool(change @ torque @ change > BEYOND**2 * expected)


def _selected(arm: Arm, fit: _Fit) -> list[Group]:
    joints = range(1, arm.dof + 1)
    groups = [(kind, j) for kind in ("body", "drive") for j in joints] + [("force", 0)]
    chosen: list[Group] = []
    least = fit.error(chosen)
    while len(chosen) < MOST:
        tried = {
            group: fit.error([*chosen, group])
            for group in groups
            if group not in chosen and fit.beyond([*chosen, group])
        }
        best = min(tried, key=lambda group: tried[group], default=None)
        if best is None or tried[best] > (1 - LEAST) * least:
            break
        chosen, least = [*chosen, best], tried[best]
    return chosen


def _places(arm: Arm, group: Group) -> list[int]:
    kind, joint = group
    kinds = DRIVES if kind == "drive" else (kind,)
    return [i for one in kinds for i in arm.places(one, joint)]


def _solved(gram: Array, cross: Array) -> Array:
    """Return the smallest solution, in units of the torque that each column makes."""
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    scaled = gram / np.outer(size, size) + RIDGE * np.eye(len(gram))
    return (np.linalg.solve(scaled, (cross.T / size).T).T / size).T


def _finding(arm: Arm, fit: _Fit, group: Group, change: Array) -> tuple[Name, ...]:
    kind, joint = group
    if kind == "force":
        return (Name("tool_force", ()),)
    if kind == "body":
        return body(arm, joint)
    # It does not tell friction from a rotor: what makes most torque is named.
    power = np.diag(sum(fit.gram)) * change**2
    most = max(DRIVES, key=lambda name: power[arm.places(name, joint)[0]])
    return tuple(Name(k, (joint,)) for k in (most, *(k for k in DRIVES if k != most)))
