"""What one reaches who is told the effect: the best that a diagnosis can do."""

import pytest

from benchmarks.hidden.oracle import oracle
from residual.errors import UnknownNameError
from sim.engine.plant_records import SyntheticEffect
from tests.residual.arms import arm
from tests.synthetic.logs import LogPlan, make
from tests.synthetic.quasi_static import Plant

PLAN = (
    LogPlan("one", "fit", "fourier", 9.0, 125.0),
    LogPlan("two", "fit", "cyclic", 9.0, 125.0),
    LogPlan("proof", "held_out", "fourier", 9.0, 125.0),
)


def test_the_right_effect_predicts_better_than_another_and_than_none():
    robot = arm()
    hidden = SyntheticEffect("position_friction", (2,), {"cos": 8.0, "sin": 0.0})
    recordings = make(Plant(robot, (hidden,), 4), PLAN, 4)
    right, other, nothing = (
        oracle(robot, recordings[:2], recordings[2:], effects)[1].overall("filtered")
        for effects in ([("position_friction", (2,))], [("position_friction", (1,))], [])
    )
    assert right < 0.8 * min(other, nothing)
    with pytest.raises(UnknownNameError):
        oracle(robot, recordings[:2], recordings[2:], [("x_wall", (2,))])
