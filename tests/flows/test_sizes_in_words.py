"""Sizes as people say them: a change, a balancer, the frame of a vector, a joint."""

import numpy as np
import pytest

from flows.report.diagnosis import build_tiles
from flows.report.tables import format_first_size, list_finding_sizes
from residual.effects import load_effects
from residual.verdict.diagnosis import Diagnosis
from tests.flows.report_outcomes import effect, given_value, parameter
from tests.verdict_documents import typed

URDF = ("base_to_turret", "shoulder_lift", "joint_3", "j4", "axis_5", "wrist_roll")


def verdict(name, joints, changes=(), declared=(), **parameters):
    """A verdict with one finding: each parameter as (value, std, unit)."""
    own = {k: parameter(*told) | {"determined": True} for k, told in parameters.items()}
    frames = {"joints": list(URDF), "flange": "tool0"}
    part = {"effects": [effect(name, list(joints), own)], "changes": list(changes)}
    return typed({**part, "declared": list(declared), "frames": frames})


def tile(said):
    return build_tiles(Diagnosis(said))[0]


def test_a_balancer_is_an_amplitude_and_where_it_is_largest():
    document = verdict("balancer", (2,), sin=(16.3, 0.4, "N m"), cos=(-5.0, 0.3, "N m"))
    label, value, note = tile(document)
    assert label == "Amplitude"
    assert value == "17.05 ± 0.39 N m"
    texts = [size.text for size in list_finding_sizes(document.effects[0], document)]
    assert texts == [value, "107.1 ± 1.0 °"]
    assert note == "of a balancer on joint 2 (shoulder_lift)"


@pytest.mark.parametrize("angle", [-2.8, -0.4, 0.0, 1.1, 3.0])
def test_the_wave_is_largest_where_it_is_told_to_be(angle):
    """a sin q + b cos q on a grid, against its amplitude and place in words."""
    balancer, q = load_effects()["balancer"], np.linspace(-np.pi, np.pi, 7201)
    values = 4.0 * np.array([np.sin(angle), np.cos(angle)])
    wave = values[0] * np.sin(q) + values[1] * np.cos(q)
    shown = balancer.display(values)
    assert shown["amplitude"][0] == pytest.approx(wave.max(), rel=1e-6)
    there = np.deg2rad(shown["largest at"][0])
    assert np.cos(there - q[np.argmax(wave)]) == pytest.approx(1, abs=1e-6)


def test_a_change_is_told_from_what_to_what():
    given = given_value("coulomb", 3, 8.0, 13.1, explained=True)
    more = verdict("coulomb", (3,), [given], ["coulomb"], level=(4.99, 0.12, "N m"))
    assert tile(more).value == "+4.99 ± 0.12 N m (8.0 → 13.0)"
    less = verdict("coulomb", (3,), [given], ["coulomb"], level=(-4.99, 0.12, "N m"))
    size = format_first_size(less.effects[0], less)[1]
    assert size == "-4.99 ± 0.12 N m (8.00 → 3.01)"
    lacking = verdict("coulomb", (3,), level=(4.99, 0.12, "N m"))
    assert tile(lacking).value == "4.99 ± 0.12 N m"  # no change of what it has


def test_every_effect_tells_what_it_tells_in_numbers():
    """Whatever its values are."""
    for own in load_effects().values():
        assert own.frame.format(flange="tool0").count("{") == 0
        if own.display:
            shown = own.display(np.linspace(0.1, 0.2, len(own.parameters)))
            assert all(np.isfinite(v) and unit for v, unit in shown.values())
