"""Other authors' forms: the same physics, no textbook law of the diagnosis."""

from types import SimpleNamespace

import numpy as np
import pytest

from tests.synthetic import other_forms as forms


def _state(q, t):
    q = np.asarray(q, dtype=float)[:, None]
    qd = np.gradient(q, t, axis=0)
    return SimpleNamespace(t=t, q=q, qd=qd, bristle=np.sign(qd))


@pytest.fixture
def stroke():
    """Slowly there, fast back."""
    t = np.linspace(0, 4, 4001)
    return _state(np.where(t < 2, 0.01 * t, 0.02 + 3.0 * (2 - t)), t)


def test_lugre_yields_at_first_then_slides_and_fades_with_speed(stroke):
    p = {"level": 4.0, "velocity": 0.05, "displacement": 1e-3}
    torque = forms.lugre(stroke, p)[:, 0]
    assert torque[0] == pytest.approx(0, abs=1e-2)
    # Two bristle lengths on, the contact has nearly all of its level.
    assert torque[1500] == pytest.approx(4.0 * np.exp(-0.04), rel=0.01)
    assert abs(torque[-1]) < 0.05
