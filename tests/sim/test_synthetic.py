"""Synthetic arms: their motions, their torque part by part, their logs."""

from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest

from residual.errors import InputError
from residual.robot.dynamics import read_inertial_parameters as read_inertias
from sim.engine.plant_records import create_random_stream
from sim.plant.typical_sizes import (
    compute_usual_motion_range,
    draw_effect,
    list_drawable_effects,
    scatter_inertias,
)
from tests.sim import plant_cases
from tests.sim.plant_cases import ROBOT
from tests.synthetic import other_forms as forms
from tests.synthetic.amounts import list_unnamed_effects as unnamed_effects
from tests.synthetic.examples import write_hidden
from tests.synthetic.laws import compute_bristle_states
from tests.synthetic.logs import LogPlan, make, make_case
from tests.synthetic.motions import FAMILIES, make_motion
from tests.synthetic.quasi_static import Plant, true_friction, true_model
from tests.synthetic.quasi_static import true_torque as torque

# What every motion of the synthetic logs keeps.


SPACE = compute_usual_motion_range(ROBOT)


def long_motion(family, seed=1, rate=250.0):
    return make_motion(family, ROBOT, 20.0, rate, create_random_stream(seed, "motion"))


@pytest.mark.parametrize("family", FAMILIES)
def test_limits_hold_between_samples_and_derivatives_are_those_of_position(family):
    m = long_motion(family, rate=5000.0)
    assert ((m.q >= ROBOT.lower) & (m.q <= ROBOT.upper)).all()
    assert (np.abs(m.qd) <= np.minimum(ROBOT.velocity_limit, SPACE.velocity)).all()
    least = np.minimum(ROBOT.acceleration_limit, SPACE.acceleration + 1e-9)
    assert (np.abs(m.qdd) <= least).all()
    qd, qdd = ((x[2:] - x[:-2]) / (2 * m.t[1]) for x in (m.q, m.qd))
    np.testing.assert_allclose(qd, m.qd[1:-1], atol=2e-4)
    np.testing.assert_allclose(qdd, m.qdd[1:-1], atol=6e-2)
    assert np.sqrt(np.mean((qdd - m.qdd[1:-1]) ** 2)) < 1e-3
    for end in (0, -1):  # at rest
        np.testing.assert_allclose(m.qd[end], 0, atol=1e-3)
        np.testing.assert_allclose(m.qdd[end], 0, atol=0.2)
    np.testing.assert_allclose(m.q[::20], long_motion(family).q, atol=1e-12)


IN_ENGINE = ("x_dead_zone", "x_wall")
LOCAL = sorted({*list_drawable_effects(), *unnamed_effects()} - {"payload", *IN_ENGINE})


def motion(family="fourier"):
    return plant_cases.motion(family, 8.0, rate=250.0)


def test_without_hidden_effects_torque_is_rnea_plus_friction():
    plant, m = Plant(ROBOT, (), 4), motion()
    model, friction = true_model(plant), true_friction(plant)
    data = model.createData()
    rigid = np.array([pin.rnea(model, data, *s) for s in zip(m.q, m.qd, m.qdd, strict=True)])
    z = compute_bristle_states(m.q, friction.displacement)
    expected = rigid + friction.coulomb * z + friction.viscous * m.qd
    expected += friction.rotor * m.qdd
    tau = torque(plant, m, "log").tau
    np.testing.assert_allclose(tau, expected, rtol=0, atol=1e-9)


@pytest.fixture(scope="module")
def plain():
    """A motion and its torque without a hidden effect."""
    m = motion()
    return m, torque(Plant(ROBOT, (), 2), m, "log").tau


@pytest.mark.parametrize("name", LOCAL)
def test_an_effect_changes_torque_on_its_joints_only(name, plain):
    hidden = draw_effect(ROBOT, name, create_random_stream(2, name))
    m, without = plain
    change = torque(Plant(ROBOT, (hidden,), 2), m, "log").tau - without
    rows = np.zeros(6, dtype=bool)
    rows[[j - 1 for j in hidden.joints]] = True
    if name == "x_cogging_sum":
        rows[hidden.joints[1] - 1] = False
    assert (np.abs(change).max(axis=0)[rows] > 1e-2).all()
    assert not change[:, ~rows].any()


@pytest.mark.parametrize("seed", range(2))
def test_scattered_bodies_are_possible_ones(seed):
    true = scatter_inertias(ROBOT.model, 0.02, create_random_stream(seed, "scatter"))
    pairs = zip(list(true.inertias)[1:], list(ROBOT.model.inertias)[1:], strict=True)
    for body, nominal in pairs:
        pseudo = pin.PseudoInertia.FromInertia(body).toMatrix()
        assert np.linalg.eigvalsh(pseudo).min() > 0
        assert body.mass != nominal.mass
    masses, nominal = (read_inertias(model)[::10] for model in (true, ROBOT.model))
    assert 0.002 < np.abs(masses / nominal - 1).mean() < 0.05


@pytest.mark.parametrize(("name", "joint"), [("magic", None), ("stribeck", 7)])
def test_what_cannot_be_drawn_is_refused(name, joint):
    with pytest.raises(InputError, match=name):
        draw_effect(ROBOT, name, create_random_stream(1, "draw"), joint)


# Other authors' forms: the same physics, no textbook law of the diagnosis.


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


SHORT = tuple(
    LogPlan(f"{part}_{i}", part, family, duration=3.0)
    for i, (part, family) in enumerate(
        [("fit", "fourier"), ("fit", "cyclic"), ("held_out", "move_stop_move")]
    )
)


def logs(*effects, seed=5):
    hidden = tuple(draw_effect(ROBOT, e, create_random_stream(seed, e)) for e in effects)
    return make(Plant(ROBOT, hidden, seed), SHORT, seed)


def test_an_effect_does_not_change_noise_or_motion():
    null, one, two = logs(), logs("offset"), logs("offset", "x_random_walk")
    for a, b in zip(null, one, strict=True):
        np.testing.assert_array_equal(a.q, b.q)
        np.testing.assert_array_equal(a.t, b.t)
        change = b.tau - a.tau
        np.testing.assert_allclose(change, change[:1] + 0 * change, atol=1e-9)
    for a, b in zip(null, two, strict=True):
        np.testing.assert_array_equal(a.q, b.q)


def test_the_session_clock_runs_on_through_pauses():
    plan = (LogPlan("before", "baseline", "fourier", duration=3.0), *SHORT)
    case = make_case(Plant(ROBOT, (), 3), plan)
    recordings = [*case.baseline, *case.fit, *case.held_out]
    for before, after in pairwise(recordings):
        assert after.t[0] - before.t[-1] >= 5.0
    assert case.fit[0].t[0] - case.baseline[-1].t[-1] > 3000
    assert len({r.id for r in recordings}) == len(recordings) == 4


def test_the_shipped_example_is_the_demo(tmp_path):
    shipped = Path(__file__).parents[2] / "examples" / "hidden"
    for path in write_hidden(tmp_path, 7, "payload"):
        assert (shipped / path.name).read_text() == path.read_text()
