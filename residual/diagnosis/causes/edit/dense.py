"""Dense least squares: what one does without looking for a cause.

All inertial parameters of all bodies and all declared coefficients are fitted freely,
without a prior: by least squares weighted with the noise of each joint, on the very
rows of the diagnosis (joints that move, both sides through its filter). Of the many
parameters that fit alike (the base parameters are fewer) those nearest to the nominal
ones are taken, in units of the torque that each makes: the mildest choice, under which
a body that need not change does not.

An effect is taken out of it by setting the parameters that stand for it back to the
nominal model's: of a load those of the last body, of a link its own, of declared
friction or a rotor the coefficient. Nothing is refitted then either.
"""

from collections.abc import Sequence

import numpy as np

from residual.effects import registry
from residual.evidence.design import Design
from residual.evidence.fit import smallest_change
from residual.model.model import Model
from residual.model.nominal import prepare_logs
from residual.recording import Array, Recording
from residual.signals.pieces import session_clock

ROUNDS = 3  # of parameters and noise in turn


def dense_model(nominal: Model, recordings: Sequence[Recording]) -> Model:
    """Fit all that the nominal model has, freely."""
    clock = session_clock(recordings)
    logs = prepare_logs(nominal.robot, recordings, clock, nominal.filters)
    return dense_fit(Design(logs.tracks, nominal))


def dense_fit(design: Design) -> Model:
    """Fit all that a design's nominal model has, freely, on the design's rows."""
    weight = design.rows / np.maximum(design.power.sum(axis=0), 1e-300)
    for _ in range(ROUNDS):
        theta = _solve(design, weight)
        left = [_left(design, j, theta) for j in range(design.dof)]
        weight = design.rows / np.maximum(left, 1e-12 * design.rms**2 * design.rows)
    return design.model.with_coefficients(design.model.coefficients() + theta)


def _solve(design: Design, weight: Array) -> Array:
    """Smallest change of the coefficients that leaves least. Shape (p,)."""
    size = len(design.nominal)
    gram, cross = np.zeros((size, size)), np.zeros(size)
    for j in range(design.dof):
        own, right, have = _sums(design, j)
        gram[np.ix_(have, have)] += weight[j] * own
        cross[have] += weight[j] * right
    return smallest_change(gram, cross)


def _sums(design: Design, j: int) -> tuple[Array, Array, Array]:
    """Gram and cross product of the nominal columns on joint j, and which they are."""
    place, have = design.present(j, design.nominal)
    gram, cross = design.total(j)
    return gram[np.ix_(place, place)], cross[place], have


def _left(design: Design, j: int, theta: Array) -> float:
    gram, cross, have = _sums(design, j)
    own = theta[have]
    return float(design.power[:, j].sum() - 2 * own @ cross + own @ gram @ own)


def set_back(model: Model, nominal: Model, effect) -> Model | None:
    """Set back what stands for an effect in a dense model.

    Args:
        effect: Anything with a name and joints from 1.

    Returns:
        The edited model; None where no parameter of it stands for the effect.
    """
    known, joints = registry()[effect.name], tuple(effect.joints)
    bodies = _bodies(known, joints, model.robot.dof)
    if bodies:
        inertial = model.inertial.copy()
        for body in bodies:
            own = slice(10 * body, 10 * body + 10)
            inertial[own] = nominal.inertial[own]
        model = model.with_coefficients(
            np.concatenate([inertial, model.coefficients()[len(inertial) :]])
        )
    places = {(t.effect.name, j + 1) for t in model.terms for j in t.joints}
    had = [j for j in joints if (effect.name, j) in places]
    if not had and not bodies:
        return None
    return model.without(effect.name, had) if had else model


def _bodies(known, joints: tuple[int, ...], dof: int) -> tuple[int, ...]:
    if known.carries == "body":
        return (dof - 1,)
    return tuple(j - 1 for j in joints) if known.scope == "link" else ()
