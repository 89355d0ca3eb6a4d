"""Base parameters: as few as possible, and together all that inertia can do."""

import numpy as np
import pytest

from residual.robot import dynamics
from residual.robot.dynamics import (
    compute_base_parameters,
    find_independent_columns,
    list_inertial_parameters,
    reduce_to_base_parameters,
)
from residual.robot.robot import load_robot
from tests.residual.arms import SEVEN, TWO, arm

MODEL = load_robot("irb140").model
ARMS = {"irb140": MODEL, "two": arm(TWO).model, "seven": arm(SEVEN).model}


@pytest.mark.parametrize("name", ARMS)
def test_base_regressor_times_base_parameters_is_rnea_on_a_thousand_states(name):
    model = ARMS[name]
    base = compute_base_parameters(model)
    assert base.gap > 1e6  # the rank is certain
    assert len(base) == len(find_independent_columns(model))
    states = np.random.default_rng(4).uniform(-2, 2, (3, 1000, model.nv))
    theta = base.mapping @ dynamics.read_inertial_parameters(model)
    torque = dynamics.compute_inertial_regressor(model, *states)[:, :, base.columns] @ theta
    np.testing.assert_allclose(
        torque, dynamics.compute_inverse_dynamics(model, *states), rtol=0, atol=1e-9
    )


def test_rounded_right_angles_do_not_make_new_parameters():
    """1.5708 for pi/2: columns that differ by rounding alone count as one."""
    exact = compute_base_parameters(MODEL)
    rng = np.random.default_rng(0)
    states = rng.uniform(-3, 3, (3, 100, 6))
    rows = dynamics.compute_inertial_regressor(MODEL, *states).reshape(600, -1)
    rows = rows + 1e-9 * rng.normal(size=rows.shape)
    again = reduce_to_base_parameters(rows, exact.columns, list_inertial_parameters(6))
    np.testing.assert_allclose(again.mapping, exact.mapping, atol=1e-6)


def test_embedding_gives_the_same_base_parameters_nearest_to_the_nominal():
    base = compute_base_parameters(MODEL)
    rng = np.random.default_rng(1)
    nominal = dynamics.read_inertial_parameters(MODEL)
    theta = base.mapping @ nominal + rng.normal(size=len(base))
    root = rng.normal(size=(60, 60)) + 8 * np.eye(60)
    full = base.expand_to_standard(theta, nominal, root @ root.T)
    np.testing.assert_allclose(base.mapping @ full, theta, atol=1e-9)
    # The move is orthogonal, in that metric, to all that the mapping does not see.
    metric = np.linalg.inv(root @ root.T)
    hidden = np.eye(60) - np.linalg.pinv(base.mapping) @ base.mapping
    np.testing.assert_allclose(hidden.T @ metric @ (full - nominal), 0, atol=1e-8)
