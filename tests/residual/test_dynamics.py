"""Laws that any rigid-body dynamics obeys, and its base parameters."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

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
seeds = st.integers(0, 2**31)


def states(seed, n=5):
    return np.random.default_rng(seed).normal(size=(3, n, MODEL.nv)) * 2


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_any_parameters_can_be_put_into_a_model(seed):
    """Also those that no body can have, such as a negative mass."""
    q, qd, qdd = states(seed)
    parameters = np.random.default_rng(seed).normal(size=60)
    model = dynamics.replace_inertial_parameters(MODEL, parameters)
    np.testing.assert_allclose(
        dynamics.compute_inverse_dynamics(model, q, qd, qdd),
        dynamics.compute_inertial_regressor(MODEL, q, qd, qdd) @ parameters,
        atol=1e-6,
    )


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_mass_matrix_is_symmetric_and_positive_definite(seed):
    for matrix in dynamics.compute_mass_matrix(MODEL, states(seed)[0]):
        np.testing.assert_array_equal(matrix, matrix.T)
        assert np.linalg.eigvalsh(matrix).min() > 0


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_torque_power_is_the_rate_of_kinetic_energy_plus_gravity_power(seed):
    """Equivalent to qd' (Mdot - 2 C) qd = 0."""
    q, qd, qdd = states(seed)
    step = 1e-6

    def energy(sign):
        speed = qd + sign * step * qdd
        place = q + sign * step * qd + 0.5 * step**2 * qdd
        matrix = dynamics.compute_mass_matrix(MODEL, place)
        return 0.5 * np.einsum("ni,nij,nj->n", speed, matrix, speed)

    rate = (energy(1) - energy(-1)) / (2 * step)
    gravity = dynamics.compute_gravity_torque(MODEL, q, MODEL.gravity.linear)
    power = np.sum(qd * (dynamics.compute_inverse_dynamics(MODEL, q, qd, qdd) - gravity), 1)
    np.testing.assert_allclose(power, rate, rtol=1e-5, atol=1e-4)


def test_gravity_torque_is_linear_in_its_direction_and_leaves_the_model_alone():
    q = states(2)[0]
    before = np.array(MODEL.gravity.linear)
    along_x, along_z = (
        dynamics.compute_gravity_torque(MODEL, q, d) for d in ([1, 0, 0], [0, 0, -9.81])
    )
    both = dynamics.compute_gravity_torque(MODEL, q, [2, 0, -9.81])
    np.testing.assert_allclose(both, 2 * along_x + along_z, atol=1e-9)
    still = dynamics.compute_inverse_dynamics(MODEL, q, 0 * q, 0 * q)
    np.testing.assert_allclose(along_z, still, atol=1e-9)
    np.testing.assert_array_equal(MODEL.gravity.linear, before)
    fields = [dynamics.compute_gravity_torque(MODEL, q, along) for along in np.eye(3)]
    weight = dynamics.compute_weight_torques(MODEL, q)
    np.testing.assert_allclose(weight, np.stack(fields, axis=-1), atol=1e-9)


def test_flange_jacobian_is_the_derivative_of_the_flange_position():
    q, qd, _ = states(3, n=1)
    step, data = 1e-6, MODEL.createData()

    def place(sign):
        pin.framesForwardKinematics(MODEL, data, q[0] + sign * step * qd[0])
        return data.oMf[dynamics.find_flange_frame(MODEL)].translation.copy()

    jacobian = dynamics.compute_flange_jacobian(MODEL, q)
    assert jacobian.shape == (1, 6, 6)
    speed = (place(1) - place(-1)) / (2 * step)
    np.testing.assert_allclose(jacobian[0, :3] @ qd[0], speed, atol=1e-6)


# Base parameters: as few as possible, and together all that inertia can do.


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
