"""Friction that moved on all joints together is drift; on one joint it is a change."""

from functools import cache

import pytest

from sim.engine.plant_records import SyntheticEffect
from tests.residual.arms import Y, Z, arm, diagnose_case, names, short_case
from tests.synthetic.quasi_static import Plant, true_friction


@cache
def friction_verdict(factors, seed):
    robot = arm((Z, Y, Y))
    there = true_friction(Plant(robot, (), seed))
    changed = []
    for j, factor in enumerate(factors, start=1):
        coulomb = (factor - 1) * there.coulomb[j - 1]
        viscous = (factor - 1) * there.viscous[j - 1]
        changed += [
            SyntheticEffect("coulomb", (j,), {"level": coulomb}),
            SyntheticEffect("viscous", (j,), {"coefficient": viscous}),
        ]
    hidden = [h for h in changed if any(h.parameters.values())]
    case = short_case(robot, *hidden, seed=seed, baseline=True, duration=8.0)
    return diagnose_case(case).verdict


COLDER = (0.85, 0.8, 0.9)


@pytest.mark.parametrize(
    "factors",
    [COLDER, pytest.param((1.2, 1.15, 1.25), marks=pytest.mark.long)],
    ids=["colder", "warmer"],
)
def test_a_warmer_or_colder_arm_is_told_as_drift_and_as_nothing_else(factors):
    verdict = friction_verdict(factors, seed=80)
    assert names(verdict) == []
    assert verdict.drift.joints == (1, 2, 3)
    mean = sum(factors) / len(factors)
    assert verdict.drift.factor == pytest.approx(mean, abs=0.05)
    assert verdict.drift.std < 0.05


def test_one_joint_that_rubs_more_is_a_change_and_no_drift():
    verdict = friction_verdict((1.0, 1.6, 1.0), seed=81)
    assert verdict.drift is None
    assert {(n, j) for n, j in names(verdict)} >= {("coulomb", (2,))}
