"""Constants of sensors: named on the joints that have one, beside anything else."""

from dataclasses import replace

import numpy as np

from residual.diagnosis import outcome
from residual.diagnosis.diagnose import diagnose
from sim.engine.plant_records import SyntheticEffect
from tests.residual.arms import arm, names, short_case

TORQUE = (1.5, -2.0)


def _with_constants(logs):
    return [replace(r, tau=r.tau + np.array(TORQUE)) for r in logs]


def test_they_are_one_finding_with_their_values_beside_another_effect():
    hidden = SyntheticEffect("quadratic_viscous", (1,), {"coefficient": 4.0})
    case = short_case(arm(), hidden, seed=71)
    fit, held_out = map(_with_constants, (case.fit, case.held_out))
    verdict = diagnose(case.robot, fit, held_out=held_out).verdict
    (finding,) = [e for e in verdict.effects if e.name == "offset"]
    assert finding.joints == (1, 2)
    torque = finding.parameters["torque"]
    gaps = np.subtract(torque.value, TORQUE) / np.array(torque.std)
    assert np.all(np.abs(gaps) < 4)
    assert [e.name for e in verdict.effects if e is not finding] == [hidden.name]


def test_they_are_named_where_nothing_else_is_missing():
    case = short_case(arm(), seed=71)
    fit, held_out = map(_with_constants, (case.fit, case.held_out))
    verdict = diagnose(case.robot, fit, held_out=held_out).verdict
    assert names(verdict) == [("offset", (1, 2))]
    np.testing.assert_allclose(verdict.effects[0].parameters["torque"].value, TORQUE, atol=0.3)


def test_a_name_that_is_not_sure_is_suspected_and_in_no_model(monkeypatch):
    case = short_case(arm(), seed=71)
    fit, held_out = map(_with_constants, (case.fit, case.held_out))
    unsure = replace(outcome.THRESHOLDS, sure_probability=2.0)  # nothing is so sure
    monkeypatch.setattr(outcome, "THRESHOLDS", unsure)
    verdict = diagnose(case.robot, fit, held_out=held_out).verdict
    assert not verdict.effects
    assert [(e.name, e.joints) for e in verdict.suspected] == [("offset", (1, 2))]
    moving = verdict.error.moving
    assert moving["augmented"] == moving["identified"]


def test_a_torque_of_a_few_steps_has_no_error_and_no_name():
    case = short_case(arm(), seed=71)
    step = np.abs(case.fit[0].tau[:, 1]).max() / 3

    def coarse(log):
        tau = log.tau.copy()
        tau[:, 1] = step * np.round(tau[:, 1] / step)
        return replace(log, tau=tau)

    verdict = diagnose(
        case.robot, [coarse(r) for r in case.fit], held_out=[coarse(r) for r in case.held_out]
    ).verdict
    assert verdict.too_small == (2,)
    assert verdict.error.moving["augmented"][1] is None
    assert verdict.error.moving["augmented"][0] is not None
    assert 2 not in verdict.unexplained.joints
    assert not [n for n in names(verdict) if n[1] == (2,)]
    assert any("joint 2" in w and "too small" in w for w in verdict.warnings)
