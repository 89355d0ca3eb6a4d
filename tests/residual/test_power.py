"""The books of power: an oracle that shares no code with the regressor."""

import numpy as np

from benchmarks.identification_parts.recovery import energy, power, power_miss
from residual.robot import dynamics
from residual.robot.robot import load_robot

MODEL = load_robot("irb140").model
MOTION = tuple(np.random.default_rng(3).uniform(-2, 2, (3, 600, 6)))


def test_torque_of_the_regressor_balances_the_books_of_power():
    tau = dynamics.regressor(MODEL, *MOTION) @ dynamics.inertial_parameters(MODEL)
    assert power_miss(MODEL, MOTION, tau) < 1e-6


def test_a_wrong_torque_does_not_balance():
    tau = dynamics.inverse_dynamics(MODEL, *MOTION)
    tau[:, 3] *= 1.01
    assert power_miss(MODEL, MOTION, tau) > 1e-6


def test_a_body_that_falls_keeps_its_energy():
    q, qd = MOTION[0][:5], MOTION[1][:5]
    rest = dynamics.inverse_dynamics(MODEL, q, qd, 0 * q)
    free = np.linalg.solve(dynamics.mass_matrix(MODEL, q), -rest[:, :, None])[:, :, 0]
    scale = np.abs(energy(MODEL, q, qd)).max()
    np.testing.assert_allclose(power(MODEL, q, qd, free) / scale, 0, atol=1e-7)
