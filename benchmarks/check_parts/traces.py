"""Whether a fault leaves a trace in a log at all, by the clean log and the fault alone.

Two witnesses can tell of a change in the torque. The other joints: no body and no
friction that is fitted to all torques carries it. The robot file: it is larger than
what the file misses of the clean torque anyway. What neither can see is no fault of the
log: a wrist whose torque is friction, times a factor, is a wrist of other friction.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.check_parts.arms import Host
from benchmarks.check_parts.spoiled import Spoiled
from residual.check.motion import Motion, thin_rows
from residual.recording import Recording
from residual.robot.dynamics import inertial_parameters, regressor

Array = np.ndarray

# Strict, so that what any witness sees faintly counts: odds of e^5 that noise and error
# of the fit to the clean log did it, and half of what the file misses.
NATS, FILE = 5.0, 0.5
KINDS = ("torque_scale", "delay")
_ROUNDS, _RANK, _LEAST = 4, 1e-6, 1e-3
_OWN = 6  # columns of each joint's friction and rotor


@dataclass(frozen=True, eq=False, slots=True)
class Trace:
    """What the witnesses see of a change.

    Attributes:
        others: Evidence of it beside any body and any friction [nats].
        file: Its size over what the robot file misses of the clean torque, both beside
            any friction, of the joint where that is largest.
    """

    others: float
    file: float

    @property
    def void(self) -> bool:
        """Whether there is none."""
        return self.others < NATS and self.file < FILE


def trace(host: Host, spoiled: Spoiled) -> Trace | None:
    """Return what a fault of the torque leaves; None of other kinds or without rows."""
    clean = thin_rows(host.logs) if spoiled.kind in KINDS else None
    if clean is None:
        return None
    logs = [
        Recording(log.id, log.robot, table["t"], log.q, table["tau"], log.qd)
        for log, table in zip(host.logs, spoiled.tables, strict=True)
    ]
    bodies = regressor(host.robot.model, clean.q, clean.qd, clean.qdd)
    friction = [_friction(clean, j) for j in range(clean.dof)]
    fitted, left, basis = _fit(clean, bodies, friction)
    if spoiled.kind == "torque_scale":
        # The noise is no trace: of the torque that the fit explains, the factor's part.
        change = fitted * (_factors(logs, host.logs) - 1)
    else:
        change = thin_rows(logs).tau - clean.tau
    weighed = (change / left).ravel()
    seen = weighed - basis @ (basis.T @ weighed)
    misses = clean.tau - bodies @ inertial_parameters(host.robot.model)
    sizes = [
        np.linalg.norm(_beside(own, change[:, j]))
        / max(np.linalg.norm(_beside(own, misses[:, j])), 1e-12)
        for j, own in enumerate(friction)
    ]
    return Trace(float(0.5 * clean.spread * seen @ seen), float(max(sizes)))


def _factors(logs: Sequence[Recording], clean: Sequence[Recording]) -> Array:
    pairs = [(a.tau, b.tau) for a, b in zip(logs, clean, strict=True)]
    powers = [(np.sum(a * b, axis=0), np.sum(b * b, axis=0)) for a, b in pairs]
    return sum(p[0] for p in powers) / sum(p[1] for p in powers)


def _friction(motion: Motion, joint: int) -> Array:
    """Friction in several forms, an offset and a rotor. Shape (n, 6)."""
    qd = motion.qd[:, joint]
    speed = max(float(qd.std()), 1e-9)
    parts = [np.ones_like(qd), qd, np.tanh(qd / (0.05 * speed)), np.abs(qd)]
    return np.column_stack([*parts, np.abs(qd) * qd, motion.qdd[:, joint]])


def _fit(
    motion: Motion, bodies: Array, friction: Sequence[Array]
) -> tuple[Array, Array, Array]:
    """Fit any body and any friction to all torques, each by what is left of it.

    Returns:
        The torque that it explains (n, dof), the rms that it leaves of each joint
        (dof,), and an orthonormal basis of all that it could, in units of that.
    """
    n, dof = motion.tau.shape
    own = np.zeros((n, dof, _OWN * dof))
    for j, part in enumerate(friction):
        own[:, j, _OWN * j : _OWN * (j + 1)] = part
    design = np.concatenate([bodies, own], axis=2)
    design = design / np.maximum(np.sqrt(np.mean(design**2, axis=(0, 1))), 1e-12)
    size = np.sqrt(np.mean(motion.tau**2, axis=0)) + 1e-12
    left = 0.1 * size
    for _ in range(_ROUNDS):
        rows = (design / left[:, None]).reshape(n * dof, -1)
        at = np.linalg.lstsq(rows, (motion.tau / left).ravel(), rcond=_RANK)[0]
        fitted = design @ at
        rest = np.sqrt(np.mean((motion.tau - fitted) ** 2, axis=0))
        left = np.maximum(rest, _LEAST * size)
    vectors, values, _ = np.linalg.svd(rows, full_matrices=False)
    return fitted, left, vectors[:, values > _RANK * values[0]]


def _beside(own: Array, x: Array) -> Array:
    """What a joint's own friction cannot take up."""
    return x - own @ np.linalg.lstsq(own, x, rcond=None)[0]
