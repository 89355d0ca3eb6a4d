"""What is hidden so that it can be seen: by the plant's own torque, in any draw."""

import pytest

from benchmarks.synthetic.visible import OF_A_NAME, SEEDS, VISIBLE, Stage, draw_visible, share
from flows.steps import demo
from sim.engine.plant_records import HIDDEN, TrajectorySpec
from sim.engine.plant_records import create_random_stream as make_rng
from sim.plant.effect_catalogue import check_effect
from sim.plant.typical_sizes import draw_plant_effect, list_drawable_effects
from sim.trajectories import plan_reference_motion as plan_motion
from sim.trajectories.excitation import draw_slow_coefficients
from tests.sim.plant_cases import ROBOT

SPEED = 0.2  # rad/s


@pytest.fixture(scope="module")
def stages():
    """A motion that creeps, and one with stops that comes later."""
    rows = draw_slow_coefficients(ROBOT, 10.0, SPEED, make_rng(1, "slow"))
    slow = plan_motion(ROBOT, TrajectorySpec("fourier", 10.0, 1, 1, rows), 100.0)
    stops = plan_motion(ROBOT, TrajectorySpec("move_stop_move", 10.0, seed=1), 100.0)
    return [Stage.of(ROBOT, slow), Stage.of(ROBOT, stops, 30.0)]


@pytest.mark.parametrize("name", list_drawable_effects()[::4])
def test_whatever_is_drawn_is_five_per_cent_of_a_joint_that_moves(name, stages):
    hidden = draw_visible(ROBOT, make_rng(0, "hidden"), stages, name)
    check_effect(hidden, ROBOT)
    assert hidden.name == name
    assert share(ROBOT, hidden, stages) >= VISIBLE


TABLE = demo.list_visible_sizes()


def test_what_is_hidden_is_that_of_the_table_or_a_usual_draw_and_begins_again():
    def hidden(seed, name=None):
        (drawn,) = demo.build_demo_specs(seed, name)[0][1].plant_spec().effects
        return [drawn.name, list(drawn.joints), dict(drawn.parameters)]

    assert hidden(1) == TABLE[""]["larger"]["1"]
    assert hidden(1, "delay") == hidden(1 + OF_A_NAME, "delay")
    usual = draw_plant_effect(ROBOT, make_rng(7, HIDDEN))
    assert hidden(7) == [usual.name, list(usual.joints), dict(usual.parameters)]
    assert hidden(7) == hidden(7 + SEEDS)
