"""Identify a model and prove it on held-out motion: the verb of this folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects.base import State
from residual.errors import InputError
from residual.identification.consistency import (
    Consistent,
    consistent,
    least_mass_matrix,
)
from residual.identification.estimate import Options
from residual.identification.identify import Identification, identify
from residual.model.compare import Errors, compare, prepare_held_out
from residual.model.model import Model
from residual.recording import Array, Recording
from residual.robot import dynamics
from residual.robot.robot import Robot
from residual.signals.pieces import are_long, hold_out_end, in_pieces, session_clock
from residual.signals.track import Track, prepare

SAME_RUN = (
    "no --holdout given: the last quarter of the longest log was held out; the proof "
    "is weak, since it is the same run"
)


# Validation of models (G2017 section 1.3): both directions, and unseen motion.
#
# Torque from motion is ``compare``; here are acceleration from torque, and models that
# are fitted to some logs and tried on the others. Feed-forward and open loop need an
# arm or its simulation: ``modelgap validate``.


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
    """Return the error of torque from motion on unseen logs, of models by name."""
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
    """Return the acceleration that a torque [N m] gives the model [rad/s^2]. (n, dof).

    Effects may depend on acceleration linearly.
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


@dataclass(frozen=True, eq=False, slots=True)
class Identified:
    """What was identified, and how far it gets on held-out motion.

    Attributes:
        robot: The arm as described.
        found: The free fit.
        consistent: Physically consistent parameters, or None.
        errors: Torque errors by model: "nominal", "identified", "consistent".
        accelerations: Errors of acceleration from torque by model; None where M(q)
            is not positive definite.
        least_mass_matrix: Smallest eigenvalue of M(q) over random poses, by model.
        fit, held_out: Ids of the logs.
        same_run: Whether the held-out part is of a log that was fitted.
        warnings: What is odd but usable.
    """

    robot: Robot
    found: Identification
    consistent: Consistent | None
    errors: Mapping[str, Errors]
    accelerations: Mapping[str, AccelerationError | None]
    least_mass_matrix: Mapping[str, float]
    fit: tuple[str, ...]
    held_out: tuple[str, ...]
    same_run: bool
    warnings: tuple[str, ...]

    @property
    def best(self) -> Model:
        """The model to use elsewhere: the consistent one where there is one."""
        return (self.consistent or self.found).model


def identify_and_prove(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    declared: Sequence[str] | Model | None = None,
    options: Options | None = None,
    bodies: bool = False,
) -> Identified:
    """Fit the parameters of a model and compare it with the nominal one.

    Args:
        held_out: Logs for the proof; empty for the last quarter of the longest.
        declared: Effects that the model has; None for the robot's own list; or a model
            to start from as it is.

    Raises:
        InputError: If a log is not usable.
    """
    same_run = not held_out
    if same_run:
        fit, held_out = hold_out_end(fit)
    clock = session_clock([*fit, *held_out])
    found = identify(robot, fit, declared, options or Options(), clock)
    models = {"nominal": found.nominal, "identified": found.model}
    made = consistent(found) if bodies else None
    if made is not None:
        models["consistent"] = made.model
    least = {name: least_mass_matrix(model) for name, model in models.items()}
    return Identified(
        robot=robot,
        found=found,
        consistent=made,
        errors=torque_errors(models, held_out),
        accelerations={k: _acceleration(m, held_out) for k, m in models.items()},
        least_mass_matrix=least,
        fit=tuple(r.id for r in fit),
        held_out=tuple(r.id for r in held_out),
        same_run=same_run,
        warnings=(
            *((SAME_RUN,) if same_run else ()),
            *found.preflight.lines(found.base),
            *_doubts(least),
        ),
    )


def _acceleration(
    model: Model, held_out: Sequence[Recording]
) -> AccelerationError | None:
    try:
        return acceleration_error(model, held_out)
    except InputError:
        return None


def _doubts(least: Mapping[str, float]) -> list[str]:
    return [
        f"M(q) of the {name} model is not positive definite (least eigenvalue "
        f"{value:.3g} kg m^2): it predicts torque but cannot be simulated; "
        "--consistent gives one that can"
        for name, value in least.items()
        if value <= 0
    ]
