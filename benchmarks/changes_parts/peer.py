"""The peer: one plain regression of both epochs, one candidate at a time.

Inertia, friction by speed, load and angle, and waves are fitted to both epochs; a
candidate column counts only times 1[second epoch]. The covariance is clustered in
blocks of time and widened joint by joint by how much logs of the first epoch differ.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from scipy.signal import butter, sosfiltfilt

from residual.recording import Recording
from residual.robot import dynamics

Array = np.ndarray

THRESHOLD, LEAST_SHARE = 12.0, 0.02  # nats; of the torque's RMS
_RATE, _CUTOFF, _BLOCK = 25.0, 8.0, 2.0  # Hz, Hz, s
_EDGE = 0.6  # s at each end of a log
_G = 9.81
_ORDERS = np.arange(6.0, 42.0, 0.5)  # waves per turn that are tried
# Columns of a joint that are candidates of their own.
_LOCAL = ("offset", "coulomb", "viscous", "spring", "load_friction", "torque_gain")
_GAIN = _LOCAL.index("torque_gain")
_SHARED = ("payload", "base_tilt", "delay")
# What single logs differ by where there are too few to tell.
_UNTESTED = 4.0


@dataclass(frozen=True, eq=False, slots=True)
class Change:
    """One candidate."""

    evidence: float  # how much likelier the logs are with it [nats]
    name: str
    joint: int  # its joint from 1; 0 for one of the whole arm
    estimate: Array  # its coefficients. Shape (k,).
    share: float  # RMS of its torque over that of the joint, where it is largest


@dataclass(frozen=True, eq=False, slots=True)
class _Log:
    """One log, filtered, at few rows a second; m rows."""

    common: Array  # what each joint has in both epochs. Shape (m, dof, p).
    tau: Array  # torque. Shape (m, dof).
    local: Array  # candidates of each joint. Shape (m, dof, c).
    shared: dict[str, Array]  # candidates of the whole arm. Each of shape (m, dof, k).
    moves: Array  # rows that count. Shape (m, dof).
    t: Array  # time since the first row [s]. Shape (m,).


@dataclass(frozen=True, eq=False)
class _Joint:
    """Rows of one joint in all logs, and what its own columns leave of them; m rows."""

    common: Array  # what it has in both epochs, of one size. Shape (m, p).
    inverse: Array  # of the Gram matrix of these. Shape (p, p).
    noise: float  # RMS of what these leave of the torque
    residual: Array  # what they leave, over the noise. Shape (m,).
    local: Array  # candidates of its own. Shape (m, c).
    shared: dict[str, Array]  # its part of those of the arm. Each of shape (m, k).
    second: Array  # whether a row is of the second epoch. Shape (m,).
    log: Array  # number of its log, as the next of its block. Shapes (m,).
    block: Array
    rms: float

    def without_common(self, columns: Array) -> Array:
        """Return columns less what the common ones explain of them, over the noise."""
        explained = self.common @ (self.inverse @ (self.common.T @ columns))
        return (columns - explained) / self.noise

    @cached_property
    def in_second(self) -> Array:
        """Own candidates in the second epoch alone, less the common columns. (m, c)."""
        return self.without_common(self.local * self.second[:, None])

    def share(self, columns: Array, theta: Array) -> float:
        """Return RMS of a change in the second epoch over RMS of the torque."""
        there = max(float(self.second.mean()), 1e-9)
        return float(np.sqrt(((columns @ theta) ** 2).mean() / there)) / self.rms


def find_change(
    model: pin.Model, first: Sequence[Recording], second: Sequence[Recording]
) -> Change | None:
    """Return the likeliest candidate that is large and sure enough to be named."""
    logs = [_log(model, log) for log in (*first, *second)]
    later = np.arange(len(logs)) >= len(first)
    joints = [_joint(logs, later, j) for j in range(model.nv)]
    restless = np.array([_restless(joint) for joint in joints])
    blocks = float(np.mean([len(np.unique(joint.block)) for joint in joints]))
    found = [
        change
        for i, joint in enumerate(joints)
        for change in _own_changes(joint, i + 1, restless[i], blocks)
    ]
    typical = float(np.median(restless))
    found += [_shared_change(name, joints, typical, blocks) for name in _SHARED]
    named = [c for c in found if c.evidence >= THRESHOLD and c.share >= LEAST_SHARE]
    return max(named, key=lambda c: c.evidence, default=None)


def _own_changes(joint: _Joint, number: int, restless: float, blocks: float) -> list[Change]:
    many = len(_LOCAL)
    places = [(name, [i]) for i, name in enumerate(_LOCAL)]
    waves = range(len(_ORDERS))
    places += [("ripple", [many + 2 * i, many + 2 * i + 1]) for i in waves]
    out = []
    for name, place in places:
        columns = joint.in_second[:, place]
        if name == "ripple":
            # A wave that both epochs have is not among the common columns.
            both = joint.without_common(joint.local[:, place])
            columns = columns - both @ np.linalg.lstsq(both, columns, rcond=1e-8)[0]
        wald, theta, _ = _tested([joint], [columns])
        size = len(place)
        evidence = wald / restless / 2 - size / 2 * np.log(blocks)
        evidence -= np.log(len(_ORDERS)) if name == "ripple" else 0.0
        share = joint.share(joint.local[:, place] * joint.second[:, None], theta)
        out.append(Change(evidence, name, number, theta, share))
    return out


def _shared_change(name: str, joints: Sequence[_Joint], restless: float, blocks: float) -> Change:
    columns = [joint.shared[name] * joint.second[:, None] for joint in joints]
    basis = np.eye(columns[0].shape[1])
    if name == "payload":
        basis = _identifiable(joints, columns)
        columns = [each @ basis for each in columns]
    each = zip(joints, columns, strict=True)
    wald, theta, _ = _tested(joints, [joint.without_common(c) for joint, c in each])
    size = columns[0].shape[1]
    evidence = wald / restless / 2 - size / 2 * np.log(blocks)
    share = max(joint.share(c, theta) for joint, c in zip(joints, columns, strict=True))
    return Change(evidence, name, 0, basis @ theta, share)


def _identifiable(joints: Sequence[_Joint], columns: Sequence[Array]) -> Array:
    """Return a basis of what the logs can tell of the ten parameters. Shape (10, k)."""
    pairs = zip(joints, columns, strict=True)
    own = np.concatenate([joint.without_common(each) for joint, each in pairs])
    gram = own.T @ own
    size = np.sqrt(np.diag(gram)) + 1e-9
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    return vectors[:, values > 1e-4 * values[-1]] / size[:, None]


def _tested(joints: Sequence[_Joint], parts: Sequence[Array]) -> tuple[float, Array, Array]:
    """Return Wald statistic, coefficients and covariance of some columns.

    The covariance sums the scores of a block before it squares them (clustered errors).

    Args:
        parts: Of each joint the columns less the common ones. Shapes (m, k).
    """
    columns = np.concatenate(parts)
    residual = np.concatenate([joint.residual for joint in joints])
    size = columns.shape[1]
    gram = columns.T @ columns
    gram += 1e-9 * np.trace(gram) / size * np.eye(size)
    theta = np.linalg.solve(gram, columns.T @ residual)
    names = np.concatenate([joint.block for joint in joints])
    block, place = np.unique(names, return_inverse=True)
    sums = np.zeros((len(block), size))
    np.add.at(sums, place, columns * (residual - columns @ theta)[:, None])
    inverse = np.linalg.inv(gram)
    few = len(block) / max(1, len(block) - size)
    covariance = inverse @ (sums.T @ sums) @ inverse * few
    weight = np.linalg.pinv(covariance, rcond=1e-6, hermitian=True)
    return float(theta @ weight @ theta), theta, covariance


def _restless(joint: _Joint) -> float:
    """Return by how much single logs of the first epoch differ from the others.

    The mean of the squared t of each log against the residual, over all of the joint's
    candidates, the largest tenth left out; never less than 1. With fewer than three
    logs their halves stand for logs.
    """
    first = ~joint.second
    part = joint.log
    if len(np.unique(part[first])) <= 2:
        middle = np.median(joint.block[first] % 1000)
        part = 2 * part + (joint.block % 1000 > middle)
    found = []
    for number in np.unique(part[first]):
        there = (part == number) & first
        if there.sum() < 50:
            continue
        alone = joint.without_common(joint.local[:, : len(_LOCAL)] * there[:, None])
        for c in range(len(_LOCAL)):
            columns = np.column_stack([alone[:, c], joint.in_second[:, c]])
            _, theta, covariance = _tested([joint], [columns])
            found.append(theta[0] ** 2 / covariance[0, 0])
    if not found:
        return _UNTESTED
    kept = sorted(found)[: max(1, int(0.9 * len(found)))]
    return max(1.0, float(np.mean(kept)))


def _joint(logs: Sequence[_Log], later: Array, j: int) -> _Joint:
    kept = [log.moves[:, j] for log in logs]

    def all_of(each) -> Array:
        return np.concatenate([x[k] for x, k in zip(each, kept, strict=True)])

    x = all_of(log.common[:, j] for log in logs)
    tau = all_of(log.tau[:, j] for log in logs)
    local = all_of(log.local[:, j] for log in logs)
    x = x / (np.sqrt((x**2).mean(axis=0)) + 1e-12)
    inverse = np.linalg.inv(x.T @ x + 1e-5 * len(tau) * np.eye(x.shape[1]))
    residual = tau - x @ (inverse @ (x.T @ tau))
    noise = max(float(np.sqrt(np.mean(residual**2))), 1e-6)
    # A gain acts on what the arm does, not on what nobody can explain.
    local[:, _GAIN] = tau - residual
    return _Joint(
        common=x,
        inverse=inverse,
        noise=noise,
        residual=residual / noise,
        local=local,
        shared={n: all_of(log.shared[n][:, j] for log in logs) for n in _SHARED},
        second=np.repeat(later, [k.sum() for k in kept]),
        log=np.repeat(np.arange(len(logs)), [k.sum() for k in kept]),
        block=all_of(1000 * i + (log.t // _BLOCK).astype(int) for i, log in enumerate(logs)),
        rms=float(np.sqrt((tau**2).mean())),
    )


def _log(model: pin.Model, log: Recording) -> _Log:
    step = float(np.median(np.diff(log.t)))
    sos = butter(4, min(0.9, _CUTOFF / (0.5 / step)), output="sos")
    every = max(1, round(1 / (step * _RATE)))

    def filtered(values: Array) -> Array:
        return sosfiltfilt(sos, values, axis=0)

    q = filtered(log.q)
    qd = np.gradient(q, step, axis=0)
    qdd = np.gradient(qd, step, axis=0)
    inertial = dynamics.compute_inertial_regressor(model, q, qd, qdd)
    load = np.abs(filtered(inertial @ dynamics.read_inertial_parameters(model)))
    common = np.concatenate([inertial, _friction(q, qd, load)], axis=2)
    speed, edge = np.abs(qd), round(_EDGE * _RATE)
    moving = speed > 0.03 * np.quantile(speed, 0.95, axis=0)
    moves = filtered(moving.astype(float))[::every] > 0.98
    moves[:edge] = moves[-edge:] = False
    ways = [_G * np.eye(3)[axis] for axis in (0, 1)]
    tilt = [dynamics.compute_gravity_torque(model, q, way) for way in ways]
    shared = {
        "payload": inertial[:, :, -dynamics.PER_LINK :],
        "base_tilt": np.stack(tilt, axis=2),
        "delay": np.gradient(log.tau, step, axis=0)[:, :, None],
    }
    return _Log(
        common=filtered(common)[::every],
        tau=filtered(log.tau)[::every],
        local=filtered(_candidates(q, qd, load))[::every],
        shared={name: filtered(x)[::every] for name, x in shared.items()},
        moves=moves,
        t=log.t[::every] - log.t[0],
    )


def _friction(q: Array, qd: Array, load: Array) -> Array:
    """Return what a joint has beside inertia: friction, waves, a constant. (n, dof, p)."""
    sign, speed = np.tanh(qd / 0.02), np.abs(qd)
    hinges = np.quantile(speed, np.linspace(0, 1, 8), axis=0)[1:-1]
    columns = [sign, qd, sign * load]
    columns += [sign * np.maximum(0, speed - hinge) for hinge in hinges]
    columns += [sign / (1 + (speed / width) ** 2) for width in (0.03, 0.06, 0.1)]
    columns += [wave(k * q) for k in (1, 2, 3) for wave in (np.sin, np.cos)]
    columns += [sign * np.sin(q), sign * np.cos(q), np.ones_like(q)]
    return np.stack(columns, axis=2)


def _candidates(q: Array, qd: Array, load: Array) -> Array:
    """Return own candidates of a joint; that of a gain is filled in later. (n, dof, c)."""
    sign, none = np.tanh(qd / 0.02), np.zeros_like(q)
    columns = [np.ones_like(q), sign, qd, q, sign * load, none]
    columns += [wave(order * q) for order in _ORDERS for wave in (np.sin, np.cos)]
    return np.stack(columns, axis=2)
