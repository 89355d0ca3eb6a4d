"""Names that must survive doubt, and refits that no arm can be."""

from dataclasses import replace

import numpy as np
import pytest

from residual.model.compare import compute_joint_error_rises as joint_error_rises
from tests.residual.arms import arm, diagnose_case, short_case


def seconds(*sizes):
    return np.array(sizes, dtype=float)[:, None]


@pytest.mark.parametrize(
    ("before", "after", "power", "expected"),
    [
        pytest.param(30 * [1.0], 30 * [1.21], 100.0, 0.1, id="every second by as much"),
        pytest.param(30 * [1.0], 30 * [1.02], 100.0, 0.0, id="by 1 %"),
        pytest.param(30 * [1.0], 30 * [1.21], 1e6, 0.0, id="nothing beside the torque"),
        pytest.param(30 * [1.0], [6.0, *29 * [1.0]], 100.0, 0.0, id="in one second only"),
        pytest.param(30 * [1.0], 30 * [0.5], 100.0, 0.0, id="a fall"),
        pytest.param(30 * [1.0], 30 * [1.21], 0.0, 0.0, id="a dead channel"),
    ],
)
def test_an_error_rises_where_it_does_beyond_chance(before, after, power, expected):
    rise = joint_error_rises(seconds(*after), seconds(*before), np.array([power]))
    assert rise == pytest.approx([expected], abs=1e-3)


def negated(recordings):
    return [replace(r, tau=-r.tau) for r in recordings]


def test_finding_nothing_in_what_cannot_be_is_no_answer():
    """All torques have the wrong sign, and nothing else is wrong with the arm."""
    case = short_case(arm(), seed=50)
    fit, held_out = negated(case.fit), negated(case.held_out)
    upside_down = diagnose_case(case, fit=fit, held_out=held_out).verdict
    assert upside_down.effects == ()
    assert upside_down.verdict == "unknown"
    contradiction = upside_down.contradictions[0]
    assert "fitted friction of joints 1, 2 drives the arm" in contradiction
