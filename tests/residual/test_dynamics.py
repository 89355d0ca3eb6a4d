"""Laws that any rigid-body dynamics obeys."""

import numpy as np
import pinocchio as pin
from hypothesis import given, settings
from hypothesis import strategies as st

from residual.robot import dynamics
from residual.robot.robot import load_robot

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
