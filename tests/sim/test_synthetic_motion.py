"""What every motion of the synthetic logs keeps."""

import numpy as np
import pytest

from residual.robot.robot import load_robot
from sim.engine.plant_records import create_random_stream
from sim.plant.typical_sizes import compute_usual_motion_range
from tests.synthetic.motions import FAMILIES, make_motion

ROBOT = load_robot("irb140")
SPACE = compute_usual_motion_range(ROBOT)


def motion(family, seed=1, rate=250.0):
    return make_motion(family, ROBOT, 20.0, rate, create_random_stream(seed, "motion"))


@pytest.mark.parametrize("family", FAMILIES)
def test_limits_hold_between_samples_and_derivatives_are_those_of_position(family):
    m = motion(family, rate=5000.0)
    assert ((m.q >= ROBOT.lower) & (m.q <= ROBOT.upper)).all()
    assert (np.abs(m.qd) <= np.minimum(ROBOT.velocity_limit, SPACE.velocity)).all()
    least = np.minimum(ROBOT.acceleration_limit, SPACE.acceleration + 1e-9)
    assert (np.abs(m.qdd) <= least).all()
    qd, qdd = ((x[2:] - x[:-2]) / (2 * m.t[1]) for x in (m.q, m.qd))
    np.testing.assert_allclose(qd, m.qd[1:-1], atol=2e-4)
    np.testing.assert_allclose(qdd, m.qdd[1:-1], atol=6e-2)
    assert np.sqrt(np.mean((qdd - m.qdd[1:-1]) ** 2)) < 1e-3
    for end in (0, -1):  # at rest
        np.testing.assert_allclose(m.qd[end], 0, atol=1e-3)
        np.testing.assert_allclose(m.qdd[end], 0, atol=0.2)
    np.testing.assert_allclose(m.q[::20], motion(family).q, atol=1e-12)
