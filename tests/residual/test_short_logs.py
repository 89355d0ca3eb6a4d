"""Five seconds of motion: what they show is named, and nothing where nothing is.

A part of so short a log is too short to repeat a name, which is no reason against it.
"""

from dataclasses import replace

import numpy as np
import pytest

from residual.diagnosis.diagnose import diagnose
from residual.robot.robot import load_robot
from sim.engine.plant_records import SyntheticEffect
from tests.residual.arms import arm, names, short_case
from tests.synthetic.logs import LogPlan, make
from tests.synthetic.quasi_static import Plant

PLAN = (LogPlan("fit", "fit", "fourier", 5.0), LogPlan("held_out", "held_out", "fourier", 5.0))
COUPLING = SyntheticEffect(
    "coupled_friction", (4, 5), {"level": 7.0, "coefficient": 0.7, "sign": 1.0}
)


@pytest.mark.parametrize(
    ("robot", "hidden", "expected"),
    [(load_robot("irb140"), (COUPLING,), [("coupled_friction", (4, 5))]), (arm(), (), [])],
    ids=["a coupling of the wrist", "nothing"],
)
def test_what_is_there_is_named_on_five_seconds(robot, hidden, expected):
    fit, held_out = make(Plant(robot, hidden, 41), PLAN, 41)
    verdict = diagnose(robot, [fit], held_out=[held_out]).verdict
    assert names(verdict) == expected
    if expected:
        moving = verdict.error.moving
        assert moving["augmented"][4] < moving["identified"][4] / 3


def test_smoothed_friction_that_grew_is_told_with_all_joints_in_the_headline():
    case = short_case(arm(), seed=70, baseline=True)
    rub = np.array([2.0, 2.0])

    def rubbed(log):
        qd = np.gradient(log.q, log.t, axis=0)
        return replace(log, tau=log.tau + rub * np.tanh(qd / 0.01))

    diagnosis = diagnose(
        case.robot,
        [rubbed(r) for r in case.fit],
        baseline=case.baseline,
        held_out=[rubbed(r) for r in case.held_out],
    ).verdict
    assert {e.name for e in diagnosis.effects} == {"coulomb"}
    before, after = (np.array(diagnosis.error.moving[k]) for k in ("identified", "augmented"))
    risen = tuple(int(j) + 1 for j in np.flatnonzero(after > 1.05 * before))
    assert set(diagnosis.error.worse) <= set(risen)
    overall = diagnosis.error.overall_moving
    assert overall["augmented"] < 1.05 * overall["identified"]
