"""How firmly the nominal model is held, and what it may be blamed for."""

from dataclasses import replace

import numpy as np
import pytest

from residual.effects import load_effects
from residual.evidence.design import Design
from residual.evidence.priors import ASSUMED, build_relative_prior, compute_inertial_sd
from residual.evidence.priors import list_forbidden_effects as forbidden_effects
from residual.model.model import Model, Term
from residual.model.nominal import GIVEN, NominalModel
from residual.robot.dynamics import read_inertial_parameters as read_inertias
from tests.residual.arms import arm
from tests.residual.linear import NOMINAL, Problem, random_state, track

FREE, ROUGH_SCALE, FINE_SCALE = None, 0.3, 0.1


def term(name, joint, theta):
    return Term(load_effects()[name], (joint,), (), np.array(theta, dtype=float))


def nominal(terms=(), given=(), **options):
    robot = arm()
    model = Model(robot, read_inertias(robot.model), tuple(terms), np.ones(2))
    return NominalModel(model, tuple(given), **options)


def design_of(found, rng):
    drawn = []
    for k in range(3):
        state = random_state(rng, 100)
        drawn.append((track(rng.normal(size=(100, 2)), np.ones((100, 2), bool), k, state), state))
    return Design([t for t, _ in drawn], found.model, [s for _, s in drawn])


@pytest.mark.parametrize("scale", [0.01, 0.3])
def test_inertial_parameters_are_held_within_a_share_of_their_size(rng, scale):
    """Half of the doubt is each one's own, half the link's as a whole."""
    nominal_model = nominal()
    prior = build_relative_prior(design_of(nominal_model, rng), nominal_model, scale)
    expected = np.zeros((NOMINAL, NOMINAL))
    sizes = compute_inertial_sd(arm()).reshape(2, 10)
    parameters = read_inertias(arm().model).reshape(2, 10)
    for i in range(2):
        own = slice(10 * i, 10 * i + 10)
        shared = np.outer(parameters[i], parameters[i])
        expected[own, own] = 0.5 * scale**2 * (shared + np.diag(sizes[i] ** 2))
    np.testing.assert_allclose(np.linalg.inv(prior.precision), expected, atol=1e-12)
    assert prior.scale == scale
    assert prior.log_det == pytest.approx(np.linalg.slogdet(prior.precision)[1])


@pytest.mark.parametrize(("given", "share"), [(GIVEN, 0.1), (ASSUMED, 1.0)])
def test_a_declared_value_is_held_within_its_share(rng, given, share):
    nominal_model = nominal([term("viscous", 0, [8.0]), term("coulomb", 1, [4.0])], [given, given])
    prior = build_relative_prior(design_of(nominal_model, rng), nominal_model, 0.03)
    sd = 1 / np.sqrt(np.diag(prior.precision))[NOMINAL:]
    # One thousandth of torque rms is added, so that a declared 0 is not exact.
    assert (sd > share * np.array([8.0, 4.0])).all()
    np.testing.assert_allclose(sd, share * np.array([8.0, 4.0]), rtol=0.02)


def test_a_declared_effect_without_value_may_have_all_of_the_torque(rng):
    """Its prior is as wide as the torque that it would explain."""
    nominal_model = nominal([term("viscous", 0, [0.0])], [None])
    design = design_of(nominal_model, rng)
    prior = build_relative_prior(design, nominal_model, 0.03)
    sd = 1 / np.sqrt(prior.precision[-1, -1])
    speed = np.concatenate([s.qd[:, 0] for s in design.states])
    assert sd * np.sqrt(np.mean(speed**2)) == pytest.approx(design.rms[0], rel=1e-3)


@pytest.mark.parametrize(
    ("name", "given", "scale", "barred"),
    [
        # Declared without a value: it is free already, there is nothing to blame.
        ("coulomb", FREE, FINE_SCALE, {"coulomb"}),
        ("coulomb", ASSUMED, FINE_SCALE, {"coulomb"}),
        # Declared with a value: the value may be wrong.
        ("coulomb", GIVEN, FINE_SCALE, set()),
        # A rough rigid body cannot blame a load.
        ("coulomb", GIVEN, ROUGH_SCALE, {"payload", "link_body", "link_inertia"}),
        # What the model has and is no parameter of a model is not named twice.
        ("offset", GIVEN, FINE_SCALE, {"offset"}),
    ],
)
def test_what_may_not_be_blamed(rng, name, given, scale, barred):
    nominal_model = nominal([term(name, 1, [1.0])], [given])
    known = replace(Problem.draw(rng, rows=20).prior, scale=scale)
    prior = replace(known, widths=nominal_model.kinds)
    assert forbidden_effects(prior, nominal_model) == barred
