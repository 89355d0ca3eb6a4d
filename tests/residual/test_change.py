"""What has changed since a baseline: named as a change, and nothing where nothing has.

The robot is told with links that are a fifth too heavy or too light: the baseline, not
the description, is what the new logs are held against.
"""

from dataclasses import replace

import numpy as np
import pytest

from residual.errors import InputError
from sim.engine.plant_records import SyntheticEffect
from sim.plant.typical_sizes import scatter_inertias
from tests.residual.arms import arm, diagnose_case, names, short_case

ROUGH = 0.2


def changed(*hidden, seed):
    case = short_case(arm(), *hidden, seed=seed, baseline=True)
    model = scatter_inertias(case.robot.model, ROUGH, np.random.default_rng(seed))
    robot = replace(case.robot, model=model)
    return {
        (f.name, f.joints): next(iter(f.parameters.values())).value
        for f in diagnose_case(case, robot=robot).effects
    }


@pytest.mark.parametrize(
    ("name", "joint", "values"),
    [
        ("payload", 2, {"mass": 1.5, "com_x": 0.1, "com_y": 0, "com_z": 0.05}),
        pytest.param("encoder_offset", 2, {"angle": 0.08}, marks=pytest.mark.long),
    ],
)
def test_a_change_is_named_with_its_size(name, joint, values):
    changes = changed(SyntheticEffect(name, (joint,), values), seed=60)
    assert list(changes) == [(name, (joint,))]
    first = next(iter(values.values()))
    assert changes[name, (joint,)] == pytest.approx(first, rel=0.1)


def test_where_nothing_has_changed_nothing_is_named():
    assert changed(seed=61) == {}


@pytest.fixture(scope="module")
def adopted():
    """An arm with a spring that its diagnosis found; and logs of it now."""
    spring = SyntheticEffect("spring", (1,), {"stiffness": 20.0, "rest": 0.2})
    before = short_case(arm(), spring, seed=63, baseline=False)
    diagnosis = diagnose_case(before)
    assert names(diagnosis.verdict) == [("spring", (1,))]
    grown = SyntheticEffect("coulomb", (2,), {"level": 3.0})
    now = short_case(arm(), spring, grown, seed=63, baseline=False)
    return diagnosis.adoptable, before, now


def test_since_a_model_was_adopted_only_what_is_new_is_named(adopted):
    model, before, now = adopted
    diagnosis = diagnose_case(now, baseline=before.fit, declared=model)
    assert names(diagnosis.verdict) == [("coulomb", (2,))]
    assert "spring" in diagnosis.verdict.declared
    assert {t.effect.name for t in model.terms} <= set(diagnosis.verdict.declared)


def test_an_adopted_model_comes_with_its_logs(adopted):
    model, _, now = adopted
    with pytest.raises(InputError, match="adopted model has no logs"):
        diagnose_case(now, declared=model)
