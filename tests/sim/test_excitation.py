import numpy as np
import pinocchio as pin
import pytest

from residual.robot.base_parameters import base_columns
from residual.robot.robot import load_robot
from sim.trajectories.excitation import _stirred, cost, excitation, problem
from sim.trajectories.fourier import draw, room_left, shrunk
from sim.trajectories.limits import workspace
from tests.sim.arms import TWO, arm

ROBOT = load_robot("irb140")
RNG = np.random.default_rng(0)


def test_rounded_angles_of_a_description_make_no_base_parameters_of_their_own():
    model = ROBOT.model.copy()
    for joint in range(1, 7):
        turn = pin.exp3(RNG.normal(0, 2e-6, 3))
        model.jointPlacements[joint].rotation = (
            model.jointPlacements[joint].rotation @ turn
        )
    assert len(base_columns(model)) == 36


def test_a_joint_that_the_search_put_to_sleep_is_stirred():
    place = workspace(ROBOT, 10.0)
    size = np.ones(6)
    size[2] = 1e-7
    asleep = shrunk(draw(place, np.random.default_rng(1)), size)
    assert room_left(place, asleep)[2] > 1e5
    stirred = _stirred(place, asleep)
    assert room_left(place, stirred).max() < 12
    assert _stirred(place, stirred) is stirred


def test_a_motion_that_never_moves_is_said_to_excite_nothing(tmp_path):
    robot = arm(TWO, tmp_path)
    still = np.zeros((50, 2))
    assert np.isinf(excitation(robot.model, still, still, still).condition)


def test_units_do_not_change_the_condition_number():
    w = RNG.normal(size=(60, 5))
    scaled = w * [1, 10, 1e-3, 1e4, 5]
    shift = 0.1 / 5 * 2 * np.log(10 * 1e-3 * 1e4 * 5)
    assert cost(w)[0] - cost(scaled)[0] == pytest.approx(shift)


def test_the_slope_of_the_cost_is_its_derivative():
    w, way = RNG.normal(size=(2, 40, 7))
    slope = (cost(w + 1e-6 * way)[0] - cost(w - 1e-6 * way)[0]) / 2e-6
    assert (cost(w)[1] * way).sum() == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize("size", [0.7, 1.6], ids=["within limits", "beyond them"])
def test_slopes_of_the_search_are_derivatives(size):
    place = workspace(ROBOT, 8.0)
    search = problem(place)
    x = size * search.point(draw(place, np.random.default_rng(1)))
    way, step = np.random.default_rng(2).normal(size=x.shape), 1e-6
    ahead, back = x + step * way, x - step * way
    slope = (search.cost(ahead)[0] - search.cost(back)[0]) / (2 * step)
    assert search.cost(x)[1] @ way == pytest.approx(slope, rel=1e-4)
    change = (search.spare(ahead) - search.spare(back)) / (2 * step)
    np.testing.assert_allclose(search.spare_slopes(x) @ way, change, atol=1e-6)
