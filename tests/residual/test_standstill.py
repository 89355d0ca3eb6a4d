"""What the direction of motion does while a joint stands."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from residual.effects import load_effects
from residual.model.model import Model, Term
from residual.model.nominal import choose_standstill_behaviour
from residual.robot.dynamics import read_inertial_parameters as read_inertias
from residual.signals.track import CHOICES, SMOOTH, StandstillFriction, build_tracks
from residual.signals.track import compute_friction_direction as friction_direction
from tests.residual.arms import arm, recording

FLOOR = 0.02


def motion(seed=0, n=400):
    """A wandering joint with stops; velocity at 100 Hz."""
    rng = np.random.default_rng(seed)
    steps = rng.normal(size=n) * 1e-3 * (rng.uniform(size=n) > 0.3)
    q = np.cumsum(np.convolve(steps, np.ones(9) / 9, "same"))
    return q, np.gradient(q, 0.01)


@pytest.mark.parametrize("shape", CHOICES, ids=str)
@settings(max_examples=10)
@given(seed=st.integers(0, 2000))
def test_direction_stays_within_one_and_turns_round_with_the_motion(shape, seed):
    q, qd = motion(seed)
    out = friction_direction(q, qd, FLOOR, shape)
    assert out.shape == q.shape
    assert np.abs(out).max() <= 1
    assert_allclose(friction_direction(-q, -qd, FLOOR, shape), -out, atol=1e-12)


@pytest.mark.parametrize("shape", CHOICES, ids=str)
def test_direction_is_the_sign_of_speed_in_steady_motion(shape):
    t = np.arange(300) / 100
    out = friction_direction(-2.0 * t, np.full(300, -2.0), FLOOR, shape)
    assert_allclose(out[100:], -1, atol=1e-3)


@pytest.mark.parametrize("shape", CHOICES, ids=str)
@pytest.mark.parametrize("hold", [0.0, 0.4, 1.0])
def test_the_share_held_counts_only_while_the_joint_stands(shape, hold):
    q, qd = motion()
    full = friction_direction(q, qd, FLOOR, replace(shape, hold=1.0))
    held = friction_direction(q, qd, FLOOR, replace(shape, hold=hold))
    stands = np.abs(qd) < shape.reach * FLOOR
    assert stands.any()
    assert not stands.all()
    assert_allclose(held[stands], hold * full[stands])
    np.testing.assert_array_equal(held[~stands], full[~stands])


def stop_and_go(dof=2):
    t = np.arange(2500) / 250
    speed = np.stack([np.where((t + j) % 2.5 < 1.5, 0.6, 0.0) for j in range(dof)], 1)
    speed *= np.where(t < 5, 1.0, -1.0)[:, None]
    return t, np.cumsum(speed, axis=0) / 250


@pytest.mark.parametrize("hold", [0.0, 0.3, 0.8])
def test_the_share_that_friction_holds_at_standstill_is_read_from_the_fit_logs(hold):
    """Joint 1 has friction that holds that share; joint 2 has none, so stays as is."""
    robot = arm()
    t, q = stop_and_go()
    friction = Term(load_effects()["coulomb"], (0,), (), np.array([5.0]))
    model = Model(robot, read_inertias(robot.model), (friction,), np.full(2, FLOOR))
    truth = replace(model, standstill=2 * (StandstillFriction("bristle", 1e-3, hold=hold),))
    log = recording(t, q, truth.predict(recording(t, q, 0 * q)))
    tracks, _ = build_tracks([log], model.filters, model.speed_floor)
    settled = choose_standstill_behaviour(model, tracks)
    assert settled.standstill[0].hold == pytest.approx(hold, abs=0.06)
    assert settled.standstill[1] == SMOOTH
    before, after = (np.linalg.norm((m.predict(log) - log.tau)[200:-200]) for m in (model, settled))
    assert after <= before + 1e-12
