"""What no arm can have: the sign and the size of every effect."""

from dataclasses import replace

import numpy as np
import pytest

from residual.effects import load_effects
from residual.effects.base import Effect, JointLimits

ARM = JointLimits(
    torque=40.0,
    lower=-2.0,
    upper=2.0,
    speed=1.5,
    weight=30.0,
    reach=1.2,
    nominal_coefficients=np.zeros(1),
)
LOAD = (0.1, 0.05, 0.05, *6 * (0.01,))  # mass * centre and inertia of a small load

# Effect, coefficients, shape: what an arm may well have, and what it cannot.
MAY = [
    ("viscous", (3.0,), ()),
    ("coulomb", (12.0,), ()),
    ("rotor_inertia", (0.4,), ()),
    ("spring", (20.0, 10.0), ()),
    ("spring", (20.0, -30.0), ()),
    ("balancer", (-60.0, 20.0), ()),
    ("offset", (-3.8,), ()),
    ("presliding", (8.0,), (0.01,)),
    ("stribeck", (8.0,), (0.1, 2.0)),
    ("load_friction", (0.1,), ()),
    ("torque_gain", (-0.435,), ()),
    ("torque_gain", (0.9,), ()),
    ("payload", (2.0, *LOAD), ()),
    ("tool_force", (30.0, 0.0, -20.0), ()),
    ("base_tilt", (0.1, -0.05), ()),
    ("elasticity", (1e-4,), ()),
    ("backlash", (1e-3,), (1.2e-3,)),
    ("delay", (0.011,), (0.01,)),
]
CANNOT = [
    ("viscous", (-0.13,), ()),
    ("viscous", (40.0,), ()),  # 60 N m at the speed that it was seen at
    ("coulomb", (-2.0,), ()),
    ("coulomb", (41.0,), ()),
    ("rotor_inertia", (-0.4,), ()),
    ("spring", (-20.0, 10.0), ()),  # pushes away
    ("spring", (0.06, 3.72), ()),  # at rest at -62 rad: a constant torque
    ("balancer", (-200.0, 20.0), ()),
    ("offset", (50.0,), ()),
    ("presliding", (1414.0,), (0.01,)),
    ("presliding", (-3.0,), (0.01,)),
    ("stribeck", (-8.0,), (0.1, 2.0)),
    ("quadratic_viscous", (-5.0,), ()),
    ("power_viscous", (-8.5,), (0.5,)),
    ("load_friction", (-0.1,), ()),
    ("torque_gain", (-1.2,), ()),  # that would be another sign
    ("payload", (35.0, *LOAD), ()),  # heavier than the arm
    ("payload", (-2.0, *LOAD), ()),  # lighter than the nothing that the model has
    ("payload", (1.0, 4.0, 0.0, 0.0, *6 * (0.0,)), ()),  # 4 m away
    ("tool_force", (400.0, 0.0, 0.0), ()),
    ("base_tilt", (1.5, 0.0), ()),
    ("encoder_offset", (0.7,), ()),
    ("warmup", (-2.0,), (60.0,)),
    ("elasticity", (-1e-4,), ()),
    ("backlash", (-1e-3,), (1.2e-3,)),
    ("backlash", (1e-4,), (1.2e-3,)),  # it bends as another size would
    ("delay", (-0.011,), (-0.01,)),
    ("delay", (-0.011,), (0.01,)),
    ("delay", (0.03,), (0.004,)),
]


def ask(name, theta, shape, had=(0.0,)):
    limits = replace(ARM, nominal_coefficients=np.array(had, dtype=float))
    return load_effects()[name].possible(np.array(theta, dtype=float), shape, limits)


def test_every_effect_says_for_itself_what_no_arm_can_have():
    usual = Effect.__dataclass_fields__["possible"].default
    silent = [n for n, e in load_effects().items() if e.possible is usual]
    assert silent == []


@pytest.mark.parametrize(("name", "theta", "shape"), MAY)
def test_what_arms_have_is_possible(name, theta, shape):
    assert ask(name, theta, shape, np.zeros(len(theta)))


@pytest.mark.parametrize(("name", "theta", "shape"), CANNOT)
def test_what_no_arm_has_is_not(name, theta, shape):
    assert not ask(name, theta, shape, np.zeros(len(theta)))


@pytest.mark.parametrize("name", ["viscous", "coulomb", "rotor_inertia"])
def test_a_value_that_the_model_has_may_fall_but_not_below_nothing(name):
    assert ask(name, (-4.0,), (), had=(5.0,))
    assert not ask(name, (-6.0,), (), had=(5.0,))


def test_a_load_that_the_model_has_may_be_gone():
    assert ask("payload", (-2.0, *(-x for x in LOAD)), (), had=(2.5, *9 * (0.0,)))
