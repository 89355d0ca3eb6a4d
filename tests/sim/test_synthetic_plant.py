import numpy as np
import pinocchio as pin
import pytest

from benchmarks.synthetic.amounts import list_unnamed_effects as unnamed_effects
from benchmarks.synthetic.laws import compute_bristle_states
from benchmarks.synthetic.quasi_static import Plant, true_friction, true_model
from benchmarks.synthetic.quasi_static import true_torque as torque
from residual.errors import InputError
from residual.robot.dynamics import read_inertial_parameters as read_inertias
from sim.engine.plant_records import create_random_stream
from sim.plant.typical_sizes import draw_effect, list_drawable_effects, scatter_inertias
from tests.sim import plant_cases
from tests.sim.plant_cases import ROBOT

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
