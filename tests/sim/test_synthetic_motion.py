import numpy as np
import pytest

from benchmarks.synthetic.motions import FAMILIES, make_motion
from residual.robot.robot import load_robot
from sim.records import stream
from sim.sizes import usual_limits

SPACE = usual_limits(load_robot("irb140"))
ROBOT = load_robot("irb140")
SEEDS = range(3)


def motion(family, seed, rate):
    return make_motion(family, SPACE, 20.0, rate, stream(seed, "motion"))


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("family", FAMILIES)
def test_limits_hold_between_the_samples(family, seed):
    dense = motion(family, seed, 5000.0)
    assert (dense.q >= ROBOT.lower).all()
    assert (dense.q <= ROBOT.upper).all()
    assert (np.abs(dense.qd) <= ROBOT.velocity_limit).all()
    assert (np.abs(dense.qdd) <= ROBOT.acceleration_limit).all()
    assert (np.abs(dense.qd) <= SPACE.velocity + 1e-9).all()
    assert (np.abs(dense.qdd) <= SPACE.acceleration + 1e-9).all()


@pytest.mark.parametrize("family", FAMILIES)
def test_velocity_and_acceleration_are_the_derivatives_of_position(family):
    m = motion(family, 1, 5000.0)
    h = m.t[1] - m.t[0]
    qd = (m.q[2:] - m.q[:-2]) / (2 * h)
    qdd = (m.qd[2:] - m.qd[:-2]) / (2 * h)
    np.testing.assert_allclose(qd, m.qd[1:-1], atol=2e-4)
    np.testing.assert_allclose(qdd, m.qdd[1:-1], atol=6e-2)
    assert np.sqrt(np.mean((qdd - m.qdd[1:-1]) ** 2)) < 1e-3


@pytest.mark.parametrize("family", FAMILIES)
def test_a_motion_starts_and_ends_at_rest(family):
    m = motion(family, 2, 1000.0)
    for end in (0, -1):
        np.testing.assert_allclose(m.qd[end], 0, atol=1e-3)
        np.testing.assert_allclose(m.qdd[end], 0, atol=0.2)


@pytest.mark.parametrize("family", FAMILIES)
def test_the_rate_samples_the_same_motion(family):
    fast, slow = motion(family, 3, 500.0), motion(family, 3, 125.0)
    np.testing.assert_allclose(fast.q[::4], slow.q, atol=1e-12)


def test_move_stop_move_dwells():
    m = motion("move_stop_move", 1, 250.0)
    still = (m.qd == 0).all(axis=1)
    assert 0.1 < still.mean() < 0.6
    assert (np.diff(still.astype(int)) == 1).sum() >= 4


def test_slow_strokes_are_slow():
    slow, fast = motion("slow_cyclic", 1, 250.0), motion("cyclic", 1, 250.0)
    assert (np.abs(slow.qd).max(0) < 0.5 * np.abs(fast.qd).max(0)).all()


def test_an_unknown_family_is_refused():
    with pytest.raises(ValueError, match="fourier"):
        motion("zigzag", 1, 250.0)
