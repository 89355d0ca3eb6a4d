"""What has changed since a baseline: named as a change, and nothing where nothing has.

The robot is told with links that are a fifth too heavy or too light: the baseline, not
the description, is what the new logs are held against.
"""

from dataclasses import replace

import numpy as np
import pytest

from sim.records import Hidden
from sim.synthetic.body import scatter
from tests.residual.arms import arm, doubts, short_case

ROUGH = 0.2


def changed(*hidden, seed):
    """Names of a diagnosis under a rough robot, with their first parameter."""
    case = short_case(arm(), *hidden, seed=seed, baseline=True)
    model = scatter(case.robot.model, ROUGH, np.random.default_rng(seed))
    _, found = doubts(replace(case, robot=replace(case.robot, model=model)))
    return {
        (f.effect.name, f.joints): float(next(iter(f.parameters.values()))[0][0])
        for f in found
    }


@pytest.mark.parametrize(
    ("name", "joint", "values"),
    [
        ("payload", 2, {"mass": 1.5, "com_x": 0.1, "com_y": 0, "com_z": 0.05}),
        ("viscous", 1, {"coefficient": 2.0}),
        ("coulomb", 2, {"level": 3.0}),
        ("encoder_offset", 2, {"angle": 0.08}),
    ],
)
def test_a_change_is_named_with_its_size(name, joint, values):
    found = changed(Hidden(name, (joint,), values), seed=60)
    assert list(found) == [(name, (joint,))]
    first = next(iter(values.values()))
    assert found[name, (joint,)] == pytest.approx(first, rel=0.1)


@pytest.mark.parametrize("seed", [61, 62])
def test_where_nothing_has_changed_nothing_is_named(seed):
    assert changed(seed=seed) == {}
