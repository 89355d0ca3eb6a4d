"""A balancer that leaves its joint nearly nothing to carry is named."""

import numpy as np
import pytest

from residual.diagnosis.diagnose import diagnose
from residual.robot.robot import load_robot
from sim.engine.plant_records import SyntheticEffect
from tests.residual.arms import names
from tests.synthetic.logs import LogPlan, make
from tests.synthetic.quasi_static import Plant

WEIGHT = np.array([0.44, 15.10])  # of the irb140's joint 3: of sin q3 and cos q3 [N m]
PLAN = tuple(
    LogPlan(name, part, "fourier", 12.0, 50.0)
    for name, part in (("A", "fit"), ("B", "fit"), ("C", "held_out"))
)


@pytest.mark.parametrize(
    "share", [1.0, *(pytest.param(s, marks=pytest.mark.long) for s in (0.97, 1.03, 1.1))]
)
def test_a_balancer_is_named_that_cancels_the_weight_of_its_joint(share):
    sin, cos = -share * WEIGHT
    hidden = SyntheticEffect("balancer", (3,), {"sin": sin, "cos": cos})
    robot = load_robot("irb140")
    *fit, held_out = make(Plant(robot, (hidden,), 12), PLAN, 12)
    verdict = diagnose(robot, fit, held_out=[held_out]).verdict
    assert names(verdict) == [("balancer", (3,))]
    value = verdict.effects[0].parameters["cos"].value
    assert value == pytest.approx(cos, rel=0.1)
    assert verdict.error.moving["augmented"][2] < 10
