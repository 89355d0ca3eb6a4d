"""Identify the parameters of a model from logs (G2017 eq. 6, Phi theta = tau).

Base inertial parameters and declared effects are fitted together, never one after the
other, on filtered rows: torque and every column pass the same filter (`Track.filter`).
Parameters that the motion does not determine stay nominal and are reported
(`Observability`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.identification.estimate import (
    Estimate,
    FitStart,
    Observability,
    Options,
    build_joint_rows,
    build_sampled_states,
    compress_joint_rows,
    compute_joint_weights,
    compute_load_parameters,
    compute_model_base_parameters,
    compute_nominal_covariance,
    compute_weighted_gram,
    estimate_parameters,
    find_unobserved_parameters,
    solve_least_squares,
    stack_weighted_blocks,
    sum_squared_residuals,
)
from residual.model.bodies import build_body_sums, compute_link_eigenvalues, find_nearest_possible
from residual.model.compare import ErrorSums, compute_model_errors, prepare_held_out
from residual.model.dynamics import POSES, compute_acceleration_error, find_least_mass_eigenvalue
from residual.model.model import Model, compute_torque_columns
from residual.model.nominal import (
    FitLogs,
    choose_standstill_behaviour,
    prepare_fit_logs,
    start_model,
)
from residual.recording import Array, Recording
from residual.robot.dynamics import BaseParameters, draw_random_states
from residual.robot.robot import Robot, check_joint_count
from residual.signals.splitting import find_session_start, split_off_last_quarter
from residual.signals.track import FilterSettings

_ROWS_PER_PARAMETER = 3


@dataclass(frozen=True, eq=False, slots=True)
class Identification:
    """Identified parameters, with their uncertainty and observability."""

    options: Options  # the options
    logs: FitLogs  # the fit logs
    nominal: Model  # the model before
    model: Model  # the model after: full parameters nearest to the nominal ones
    base: BaseParameters  # base parameters over ``model.coefficients()``
    estimate: Estimate
    nominal_theta: Array  # base parameters before, (b,)
    # Prior covariance of full parameters around the nominal ones, (s, s).
    spread: Array
    preflight: Observability  # parameters that the motion does not determine
    # Compressed rows (`compress_joint_rows`), weighted where the method weighs rows.
    blocks: tuple[Array, ...]

    @property
    def status(self) -> tuple[str, ...]:
        """Of each parameter: "fitted" or "nominal"."""
        out = ["fitted"] * len(self.base)
        for parameter in self.preflight.fixed:
            out[parameter.index] = "nominal"
        return tuple(out)


def identify(
    robot: Robot,
    recordings: Sequence[Recording],
    declared: Sequence[str] | Model | None = None,
    options: Options = Options(),  # noqa: B008  frozen
    clock: float | None = None,
) -> Identification:
    """Identify a robot's model from logs.

    Args:
        declared: Effects that the model has; None for the robot's own list; or a model
            to start from as it is.
        clock: Start of the session on the logs' clock [s], or None.

    Raises:
        InputError: If a log is of another arm, nothing moves, or rows are too few.
    """
    if not recordings:
        raise InputError("No log to identify from: give at least one.")
    check_joint_count(robot, recordings)
    logs = prepare_fit_logs(robot, recordings, clock, FilterSettings())
    nominal = start_model(logs, declared)
    base = compute_model_base_parameters(nominal)
    first = _fitted(nominal, base, logs, options)
    # A prediction needs a standstill behaviour; one that extends into moving rows changes
    # the fit a little, so it is repeated.
    settled = choose_standstill_behaviour(first.model, logs.sketch).standstill
    return _fitted(replace(nominal, standstill=settled), base, logs, options)


def _fitted(
    nominal: Model, base: BaseParameters, logs: FitLogs, options: Options
) -> Identification:
    rows = build_joint_rows(nominal, logs.tracks, base)
    total, least = int(rows.counts.sum()), _ROWS_PER_PARAMETER * len(base)
    if total == 0:
        raise InputError(
            "No joint moves in these logs: there are no rows to identify from. Give "
            "logs in which joints move for longer than a second."
        )
    if total < least:
        raise InputError(
            f"Too few rows: {total} moving rows for {len(base)} parameters, expected "
            f"{least} or more. Give longer logs, or declare fewer effects."
        )
    states = draw_random_states(nominal.robot.model)
    columns = compute_torque_columns(nominal, build_sampled_states(nominal, *states))
    spread = compute_nominal_covariance(nominal, rows.rms, columns)
    theta = base.mapping @ nominal.coefficients()
    wide = spread + np.diag(compute_load_parameters(nominal) ** 2)
    size = np.sqrt(np.diag(base.mapping @ wide @ base.mapping.T))
    blocks = compress_joint_rows(rows)
    start = FitStart(theta, size, np.arange(len(base)))
    # Observability, under the noise of a first fit of all parameters.
    rough = solve_least_squares(blocks, np.ones(len(rows.y)), start)
    weight, _, _ = compute_joint_weights(rows, rough, "wls")
    per_row = np.stack([weight, rows.counts])
    shown = find_unobserved_parameters(
        nominal, base, compute_weighted_gram(blocks, weight), size, per_row
    )
    start = replace(start, free=shown.free)
    if options.prior is not None:
        # A prior covers undetermined parameters: none is held. Values that were never given stay
        # free.
        covariance, first = spread * options.prior**2, len(nominal.inertial)
        for i, value in enumerate(nominal.coefficients()[first:], start=first):
            sd = options.prior * abs(value) if value else 10 * np.sqrt(spread[i, i])
            covariance[i, i] = sd**2
        prior = base.mapping @ covariance @ base.mapping.T
        unit = np.sqrt(np.diag(prior))
        precision = np.linalg.inv(prior / np.outer(unit, unit)) / np.outer(unit, unit)
        start = replace(start, free=np.arange(len(base)), precision=precision)
        shown = replace(shown, fixed=())
    estimate = estimate_parameters(rows, blocks, start, options)
    full = base.expand_to_standard(estimate.theta, nominal.coefficients(), wide)
    model = nominal.with_coefficients(full)
    compressed = compress_joint_rows(rows, estimate.row_weights)
    return Identification(
        options, logs, nominal, model, base, estimate, theta, wide, shown, compressed
    )


# Physically consistent full parameters that fit, nearest to the nominal.
#
# min  |R (K pi - theta)|^2 + (pi - pi_0)' S^-1 (pi - pi_0)
#
# over possible bodies (``residual.model.bodies``) and dissipating friction, with R'R the
# information of the free fit about theta, so that determined parameters follow the logs
# and the others stay near the nominal.


@dataclass(frozen=True, eq=False, slots=True)
class ConsistentParameters:
    """Physically consistent parameters."""

    model: Model  # the consistent model
    # Smallest eigenvalue of each link's pseudo-inertia over that of its own scale, m
    # and m r^2, (dof,).
    least_eigenvalue: Array
    # Smallest eigenvalue of M(q), rotors included, over all poses [kg m^2].
    least_mass_matrix: float
    poses: int  # number of poses
    # Rms of each joint's rows, fitted freely and consistently [N m], (2, dof).
    misfit: Array


def find_consistent_parameters(free: Identification) -> ConsistentParameters:
    """Find the physically consistent parameters that fit, nearest to the nominal.

    Raises:
        InputError: If the method fails.
    """
    # The best unconstrained parameters, and U'U, the information of rows and nominal values
    # together, in SI units.
    unit = np.sqrt(np.diag(free.spread))
    rows = stack_weighted_blocks(free.blocks, free.estimate.weight)
    left = rows[:, :-1] @ free.base.mapping * unit
    right = rows[:, -1] - rows[:, :-1] @ free.nominal_theta
    correlation = free.spread / np.outer(unit, unit)
    root = np.linalg.cholesky(np.linalg.inv(correlation)).T
    q, upper = np.linalg.qr(np.concatenate([left, root]))
    target = q.T @ np.concatenate([right, np.zeros(len(root))])
    best = free.nominal.coefficients() + unit * np.linalg.solve(upper, target)
    bodies = build_body_sums(free.nominal.with_coefficients(best), friction=True)
    model = free.nominal.with_coefficients(find_nearest_possible(bodies, best, upper / unit))
    theta = free.base.mapping @ model.coefficients()
    both = [sum_squared_residuals(free.blocks, t) for t in (free.estimate.theta, theta)]
    misfit = np.sqrt(np.array(both) / np.maximum(free.estimate.counts, 1))
    least = compute_link_eigenvalues(model), find_least_mass_eigenvalue(model)
    return ConsistentParameters(model, *least, POSES, misfit)


SAME_RUN = (
    "no --holdout given: the last quarter of the longest log was held out; the proof "
    "is weak, since it is the same run"
)


@dataclass(frozen=True, eq=False, slots=True)
class ValidatedIdentification:
    """An identification, with its errors on held-out motion.

    Attributes:
        robot: The arm as described.
        free: The unconstrained fit.
        consistent: Physically consistent parameters, or None.
        errors: Torque errors by model: "nominal", "identified", "consistent".
        accelerations: Errors of acceleration from torque by model; None where M(q)
            is not positive definite.
        least_mass_matrix: Smallest eigenvalue of M(q) over random poses, by model.
        fit, held_out: Ids of the logs.
        same_run: Whether the held-out part is of a fit log.
        warnings: Warnings about odd but usable logs.
    """

    robot: Robot
    free: Identification
    consistent: ConsistentParameters | None
    errors: Mapping[str, ErrorSums]
    accelerations: Mapping[str, ErrorSums | None]
    least_mass_matrix: Mapping[str, float]
    fit: tuple[str, ...]
    held_out: tuple[str, ...]
    same_run: bool
    warnings: tuple[str, ...]

    @property
    def best(self) -> Model:
        """The model for further use: the consistent one if it exists."""
        return (self.consistent or self.free).model


def identify_and_validate(
    robot: Robot,
    fit: Sequence[Recording],
    held_out: Sequence[Recording] = (),
    declared: Sequence[str] | Model | None = None,
    options: Options | None = None,
    require_consistent: bool = False,
) -> ValidatedIdentification:
    """Fit the parameters of a model and compare it with the nominal one.

    Args:
        held_out: Logs for the test; empty for the last quarter of the longest.
        declared: Effects that the model has; None for the robot's own list; or a model
            to start from as it is.
    """
    same_run = not held_out
    if same_run:
        fit, held_out = split_off_last_quarter(fit)
    clock = find_session_start([*fit, *held_out])
    free = identify(robot, fit, declared, options or Options(), clock)
    models = {"nominal": free.nominal, "identified": free.model}
    consistent_fit = find_consistent_parameters(free) if require_consistent else None
    if consistent_fit is not None:
        models["consistent"] = consistent_fit.model
    least = {name: find_least_mass_eigenvalue(model) for name, model in models.items()}
    accelerations: dict[str, ErrorSums | None] = {}
    for name, model in models.items():
        try:
            accelerations[name] = compute_acceleration_error(model, held_out)
        except InputError:
            accelerations[name] = None
    ready = prepare_held_out(held_out, free.nominal)
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
        errors=compute_model_errors(models, ready, free.nominal.filters)[0],
        accelerations=accelerations,
        least_mass_matrix=least,
        fit=tuple(r.id for r in fit),
        held_out=tuple(r.id for r in held_out),
        same_run=same_run,
        warnings=(*((SAME_RUN,) if same_run else ()), *free.preflight.lines(free.base), *doubts),
    )
