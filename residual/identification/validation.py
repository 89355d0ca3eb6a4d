"""Validation of models (G2017 section 1.3): both directions, and unseen motion.

Torque from motion is ``compare``; here are acceleration from torque, and models that
are fitted to some logs and tried on the others. Feed-forward and open loop need an arm
or its simulation: ``modelgap validate``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects.base import State
from residual.errors import InputError
from residual.model.compare import Errors, compare, prepare_held_out
from residual.model.model import Model
from residual.recording import Array, Recording
from residual.robot import dynamics
from residual.signals.pieces import are_long, in_pieces
from residual.signals.track import Track, prepare


@dataclass(frozen=True, eq=False, slots=True)
class AccelerationError:
    """Error of the acceleration that a model makes of measured torque.

    Attributes:
        per_joint: 100 ||qdd - qdd_hat|| / ||qdd|| on moving samples [%], NaN where a
            joint never moves. Shape (dof,).
        overall: The same over all joints, Frobenius norm [%].
    """

    per_joint: Array
    overall: float


def torque_errors(
    models: Mapping[str, Model], recordings: Sequence[Recording]
) -> dict[str, Errors]:
    """Return the error of torque from motion, of several models on unseen logs.

    Args:
        models: Models of one signal path, by name.

    Raises:
        InputError: If there is no model or no log.
    """
    if not models or not recordings:
        raise InputError("Validation needs at least one model and one held-out log.")
    some = next(iter(models.values()))
    errors, _ = compare(models, prepare_held_out(recordings, some), some.filters)
    return errors


def acceleration_error(
    model: Model, recordings: Sequence[Recording]
) -> AccelerationError:
    """Return the error of acceleration from torque (forward dynamics).

    qdd_hat = M(q)^-1 (tau - h(q, qd)), with M and h of body and effects. Measured and
    computed acceleration pass the identification filter; samples count where the joint
    moves.

    Raises:
        InputError: If M(q) of the model is not positive definite.
    """
    dof = model.robot.dof
    miss, power = np.zeros(dof), np.zeros(dof)
    full, pieces = not are_long(recordings), in_pieces(recordings, model.filters.torque)
    tracks, _ = prepare(pieces, model.filters, model.speed_floor, full_rate=full)
    for recording, track in zip(pieces, tracks, strict=True):
        measured = [np.interp(track.t, recording.t, c) for c in recording.tau.T]
        made = acceleration(model, track, np.column_stack(measured))
        both = track.filter(np.stack([track.qdd, made], axis=2))
        both = both * track.moving[:, :, None]
        miss += ((both[:, :, 0] - both[:, :, 1]) ** 2).sum(axis=0)
        power += (both[:, :, 0] ** 2).sum(axis=0)
    some = power > 0
    share = 100 * np.sqrt(miss / np.where(some, power, np.nan))
    whole = float(power.sum())
    overall = float(100 * np.sqrt(miss.sum() / whole)) if whole else float("nan")
    return AccelerationError(share, overall)


def acceleration(model: Model, track: Track, tau: Array) -> Array:
    """Return the acceleration that a torque gives the model [rad/s^2].

    Args:
        model: Body and effects. Effects may depend on acceleration linearly.
        tau: Torque at the same samples [N m]. Shape (n, dof).

    Returns:
        Shape (n, dof).

    Raises:
        InputError: If M(q) of the model is not positive definite.
    """
    still = replace(track, qdd=np.zeros_like(track.qdd))
    state = model.observe(still)
    rest = model.torque_of_state(state)
    body = dynamics.with_inertial_parameters(model.robot.model, model.inertial)
    matrices = dynamics.mass_matrix(body, track.q) + _effect_inertia(model, state)
    least = float(np.linalg.eigvalsh(matrices)[:, 0].min())
    if least <= 0:
        raise InputError(
            f"M(q) of the model has an eigenvalue of {least:.3g} kg m^2, expected more "
            "than 0: it has no acceleration. Use consistent parameters (--consistent)."
        )
    return np.linalg.solve(matrices, (tau - rest)[:, :, None])[:, :, 0]


def _effect_inertia(model: Model, state: State) -> Array:
    """What effects add to M: their torque at unit accelerations. (n, dof, dof)."""
    n, dof = state.q.shape
    out = np.zeros((n, dof, dof))
    rest = [term.torque(state) for term in model.terms]
    for j in range(dof):
        pushed = replace(state, qdd=np.tile(np.eye(dof)[j], (n, 1)))
        for term, before in zip(model.terms, rest, strict=True):
            out[:, :, j] += term.torque(pushed) - before
    return out
