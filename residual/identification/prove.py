"""Identify a model and prove it on held-out motion: the verb of this folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.identification.estimate import Options, squares, stacked
from residual.identification.identify import Identification, identify
from residual.model.bodies import bodies_of, least_eigenvalues, nearest
from residual.model.compare import Errors, compare, prepare_held_out
from residual.model.dynamics import (
    POSES,
    AccelerationError,
    acceleration_error,
    least_mass_matrix,
)
from residual.model.model import Model
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.splitting import hold_out_end, session_clock

# Full parameters that a body can have, nearest to the nominal among those that fit.
#
# min  |R (K pi - theta)|^2 + (pi - pi_0)' S^-1 (pi - pi_0) / scale^2
#
# over bodies that can exist (``residual.model.bodies``) and friction that brakes, with
# R'R the information of the free fit about theta, so that whatever the logs tell weighs
# as they tell it, and the rest stays near the nominal.

LOOSE = 1.0  # relative doubt of nominal values that logs may override


@dataclass(frozen=True, eq=False, slots=True)
class Consistent:
    """Physically consistent parameters."""

    model: Model  # the model that has them
    # Smallest eigenvalue of each link's pseudo-inertia over that of its own scale, m
    # and m r^2, (dof,).
    least_eigenvalue: Array
    # Smallest eigenvalue of M(q), rotors included, over all poses [kg m^2].
    least_mass_matrix: float
    poses: int  # poses at which it was looked at
    # Rms of each joint's rows, fitted freely and consistently [N m], (2, dof).
    misfit: Array


def consistent(free: Identification, scale: float = LOOSE) -> Consistent:
    """Find the physically consistent parameters that fit, nearest to the nominal.

    Raises:
        InputError: If the scale is no positive number, or the method fails.
    """
    if not 0 < scale < np.inf:
        raise InputError(
            f"Scale {scale:g}: expected a positive number; 1 doubts nominal values by "
            "their own size."
        )
    best, root = _unconstrained(free, scale)
    bodies = bodies_of(free.nominal.with_coefficients(best), friction=True)
    model = free.nominal.with_coefficients(nearest(bodies, best, root))
    theta = free.base.mapping @ model.coefficients()
    both = [squares(free.blocks, t) for t in (free.estimate.theta, theta)]
    misfit = np.sqrt(np.array(both) / np.maximum(free.estimate.counts, 1))
    least = least_eigenvalues(model), least_mass_matrix(model)
    return Consistent(model, *least, POSES, misfit)


def _unconstrained(free: Identification, scale: float) -> tuple[Array, Array]:
    """Return the best parameters without the cone (s,), and U (s, s).

    With U'U the information of rows and nominal together, in SI units.
    """
    estimate, start = free.estimate, free.nominal.coefficients()
    unit = np.sqrt(np.diag(free.spread))
    rows = stacked(free.blocks, estimate.weight)
    left = rows[:, :-1] @ free.base.mapping * unit
    right = rows[:, -1] - rows[:, :-1] @ free.nominal_theta
    correlation = free.spread / np.outer(unit, unit)
    root = np.linalg.cholesky(np.linalg.inv(correlation)).T / scale
    both = np.concatenate([left, root])
    q, upper = np.linalg.qr(both)
    target = q.T @ np.concatenate([right, np.zeros(len(root))])
    return start + unit * np.linalg.solve(upper, target), upper / unit


SAME_RUN = (
    "no --holdout given: the last quarter of the longest log was held out; the proof "
    "is weak, since it is the same run"
)


# Validation of models (G2017 section 1.3): both directions, and unseen motion.
#
# Torque from motion is ``compare``, acceleration from torque ``forward``; here models
# are fitted to some logs and tried on the others. Feed-forward and open loop need an
# arm or its simulation: ``modelgap validate``.


def torque_errors(
    models: Mapping[str, Model], recordings: Sequence[Recording]
) -> dict[str, Errors]:
    """Return the error of torque from motion on unseen logs, of models by name."""
    if not models or not recordings:
        raise InputError("Validation needs at least one model and one held-out log.")
    some = next(iter(models.values()))
    errors, _ = compare(models, prepare_held_out(recordings, some), some.filters)
    return errors


@dataclass(frozen=True, eq=False, slots=True)
class ValidatedIdentification:
    """What was identified, and how far it gets on held-out motion.

    Attributes:
        robot: The arm as described.
        free: The unconstrained fit.
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
    free: Identification
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
        return (self.consistent or self.free).model


def identify_and_prove(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    declared: Sequence[str] | Model | None = None,
    options: Options | None = None,
    bodies: bool = False,
) -> ValidatedIdentification:
    """Fit the parameters of a model and compare it with the nominal one.

    Args:
        held_out: Logs for the proof; empty for the last quarter of the longest.
        declared: Effects that the model has; None for the robot's own list; or a model
            to start from as it is.
    """
    same_run = not held_out
    if same_run:
        fit, held_out = hold_out_end(fit)
    clock = session_clock([*fit, *held_out])
    free = identify(robot, fit, declared, options or Options(), clock)
    models = {"nominal": free.nominal, "identified": free.model}
    consistent_fit = consistent(free) if bodies else None
    if consistent_fit is not None:
        models["consistent"] = consistent_fit.model
    least = {name: least_mass_matrix(model) for name, model in models.items()}
    accelerations: dict[str, AccelerationError | None] = {}
    for name, model in models.items():
        try:
            accelerations[name] = acceleration_error(model, held_out)
        except InputError:
            accelerations[name] = None
    doubts = (
        f"M(q) of the {name} model is not positive definite (least eigenvalue "
        f"{value:.3g} kg m^2): it predicts torque but cannot be simulated; "
        "--consistent gives one that can"
        for name, value in least.items()
        if value <= 0
    )
    return ValidatedIdentification(
        robot=robot,
        free=free,
        consistent=consistent_fit,
        errors=torque_errors(models, held_out),
        accelerations=accelerations,
        least_mass_matrix=least,
        fit=tuple(r.id for r in fit),
        held_out=tuple(r.id for r in held_out),
        same_run=same_run,
        warnings=(
            *((SAME_RUN,) if same_run else ()),
            *free.preflight.lines(free.base),
            *doubts,
        ),
    )
