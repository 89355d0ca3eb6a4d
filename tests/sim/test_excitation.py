import numpy as np
import pytest
from numpy.testing import assert_allclose

from residual.robot.robot import load_robot
from sim.trajectories.excitation import build_excitation_problem
from sim.trajectories.excitation import draw_feasible_series as feasible_series
from sim.trajectories.planning_limits import build_workspace

ROBOT = load_robot("irb140")


@pytest.mark.parametrize("size", [0.7, 1.6], ids=["within limits", "beyond them"])
def test_slopes_of_the_search_are_derivatives(size):
    place = build_workspace(ROBOT, 8.0)
    search = build_excitation_problem(place)
    x = size * search.encode_series(feasible_series(place, np.random.default_rng(1)))
    way, step = np.random.default_rng(2).normal(size=x.shape), 1e-6
    ahead, back = x + step * way, x - step * way
    slope = (search.cost(ahead)[0] - search.cost(back)[0]) / (2 * step)
    assert search.cost(x)[1] @ way == pytest.approx(slope, rel=1e-4)
    change = (search.compute_margins(ahead) - search.compute_margins(back)) / (2 * step)
    assert_allclose(search.compute_margin_gradients(x) @ way, change, atol=1e-6)
