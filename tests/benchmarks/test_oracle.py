"""What one reaches who is told the effect: the best that a diagnosis can do."""

import pytest

from benchmarks.hidden.oracle import oracle
from benchmarks.synthetic.logs import LogPlan, make
from benchmarks.synthetic.quasi_static import Plant
from residual.errors import UnknownNameError
from residual.robot.robot import load_robot
from sim.engine.records import Hidden

PLAN = (
    LogPlan("one", "fit", "fourier", 9.0, 125.0),
    LogPlan("two", "fit", "cyclic", 9.0, 125.0),
    LogPlan("proof", "held_out", "fourier", 9.0, 125.0),
)


@pytest.fixture(scope="module")
def logs():
    hidden = Hidden("position_friction", (2,), {"cos": 8.0, "sin": 0.0})
    made = make(Plant(load_robot("irb140"), (hidden,), 4), PLAN, 4)
    return made[:2], made[2:]


def test_the_right_effect_predicts_better_than_another_and_than_none(logs):
    robot = load_robot("irb140")
    told, other, nothing = (
        oracle(robot, *logs, effects)[1].overall("filtered")
        for effects in (
            [("position_friction", (2,))],
            [("position_friction", (3,))],
            [],
        )
    )
    assert told < 0.8 * nothing
    assert told < 0.8 * other


def test_an_effect_that_has_no_name_cannot_be_told(logs):
    with pytest.raises(UnknownNameError):
        oracle(load_robot("irb140"), *logs, [("x_wall", (2,))])
