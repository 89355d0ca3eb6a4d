"""What a synthetic arm hides is found, on its joint, by its size.

The arm's formulas are others than those of the library, its inertia is 2 % off its
URDF, its friction is anything. One clear case per effect, of short logs: how often it
goes right over many draws is the matter of `benchmarks/run.py diagnosis`.
"""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from sim.engine.plant_records import SyntheticEffect as Effect
from tests.residual.arms import Y, Z, arm, diagnose_case, searched, short_case
from tests.residual.arms import bare_irb140 as irb140
from tests.synthetic.logs import CHANGES
from tests.synthetic.quasi_static import Plant, true_friction

# Seed of the draw, and how near each parameter must come (relative to the truth).
# None where the arm's formula has no such parameter, or two of them trade off.
CASES = {
    "balancer": (33, {"sin": 0.2}),
    "coulomb_asymmetry": (35, None),
    "coupled_friction": (32, {"level": 0.15, "coefficient": 0.25, "sign": 0}),
    "load_friction": (33, {"coefficient": 0.15}),
    "offset": (33, None),
    "payload": (33, {"mass": 0.1, "com_x": 0.15}),
    "position_friction": (34, None),
    "power_viscous": (31, None),
    "quadratic_viscous": (32, {"coefficient": 0.1}),
    "ripple": (33, {"amplitude": 0.15, "order": 0.02}),
    "rotor_inertia": (32, {"inertia": 0.1}),
    "spring": (35, {"stiffness": 0.1}),
    "stribeck": (38, {"level": 0.6, "velocity": 0.5}),
    "torque_gain": (33, {"gain": 0.25}),
    "viscous": (32, {"coefficient": 0.05}),
    "viscous_asymmetry": (33, {"coefficient": 0.1}),
    "warmup": (38, {"time_constant": 0.6}),
}
# What a load, the gears of a wrist or the body's own inertia has a part in is hidden in
# the arm of six joints; what one drive does is the same in an arm of three.
OF_THE_WHOLE = {"coupled_friction", "payload"}
THREE = (Z, Y, Y)


# Like another of the list, or recovered elsewhere: on short logs, since a baseline.
LIKE = {"balancer", "coupled_friction", "payload", "power_viscous"}
LIKE |= {"viscous_asymmetry", "delay", "encoder_eccentricity"}


def quick_first(effects):
    marks = {True: [pytest.mark.long], False: []}
    return [pytest.param(e, marks=marks[e in LIKE]) for e in sorted(effects)]


@pytest.mark.parametrize("effect", quick_first(set(CASES) - set(CHANGES)))
def test_a_hidden_effect_is_named_first_on_its_joint_and_alone(effect):
    seed, tolerances = CASES[effect]
    robot = irb140() if effect in OF_THE_WHOLE else arm(THREE)
    case = short_case(robot, effect, seed=seed, duration=8.0)
    _, findings = searched(case)
    assert len(findings) == 1
    (finding,) = findings
    same = {(finding.effect.name, finding.joints), *finding.equivalent}
    assert (case.truth.name, case.truth.joints) in same
    if tolerances is None:
        return
    assert finding.effect.name == effect
    for key, share in tolerances.items():
        (value,), (sd,), *_ = finding.parameters[key]
        truth = case.truth.parameters[key]
        assert value == pytest.approx(truth, rel=share)
        assert 0 <= sd < abs(truth)


# Coulomb friction that grows: below, and in test_change.
@pytest.mark.parametrize(
    "effect", ["rotor_inertia", pytest.param("viscous", marks=pytest.mark.long)]
)
def test_what_every_drive_has_is_named_where_there_is_more_than_before(effect):
    seed, tolerances = CASES[effect]
    case = short_case(arm(THREE), effect, seed=seed, duration=8.0)
    (finding,) = diagnose_case(case).effects
    assert (finding.name, finding.joints) == (case.truth.name, case.truth.joints)
    for key, share in tolerances.items():
        parameter, truth = finding.parameters[key], case.truth.parameters[key]
        assert parameter.value == pytest.approx(truth, rel=share)
        assert 0 <= parameter.std < abs(truth)


def test_nothing_is_named_and_nothing_flagged_where_nothing_is_missing():
    diagnosis, findings = searched(short_case(irb140(), seed=36, duration=8.0))
    assert findings == []
    assert diagnosis.adequacy.doubted == ()
    assert diagnosis.prior.scale <= 0.1


def test_what_has_no_name_is_flagged_on_its_joint_without_one():
    case = short_case(arm(THREE), "x_friction_jump", seed=38, duration=8.0)
    diagnosis, findings = searched(case)
    assert findings == []
    assert [j + 1 for j in diagnosis.adequacy.doubted] == list(case.truth.joints)


def test_two_effects_at_once_are_both_found():
    hidden = ("payload", "quadratic_viscous")
    case = short_case(irb140(), *hidden, seed=37, duration=8.0)
    assert sorted(f.effect.name for f in searched(case)[1]) == [*hidden]


def test_friction_that_is_declared_nowhere_is_one_finding_on_all_joints():
    robot = arm(THREE)
    case = short_case(robot, seed=40, duration=8.0)
    (finding,) = searched(case, ("viscous", "rotor_inertia"))[1]
    assert (finding.effect.name, finding.joints) == ("coulomb", (1, 2, 3))
    levels, sds, unit, _ = finding.parameters["level"]
    assert unit == "N m"
    assert levels.shape == sds.shape == (3,)
    truth = true_friction(Plant(robot, (), 40)).coulomb
    np.testing.assert_allclose(levels, truth, rtol=0.1)


# On the small arm of two parallel axes: joints from 1, size, seed, and how near the
# first parameter must come. Angles and bodies there are in one class with one another.
WEAK = {
    "base_tilt": ((), {"tilt_x": 0.05, "tilt_y": 0.0}, 52, None),
    "tool_force": ((), {"x": 4.0, "y": 0.0, "z": -3.0}, 51, 0.1),
    "delay": ((), {"delay": 0.015}, 51, 0.1),
    "encoder_offset": ((1,), {"angle": 0.08}, 51, None),
    "encoder_eccentricity": ((1,), {"cos": 0.03, "sin": 0.04}, 51, 0.25),
    "elasticity": ((1,), {"stiffness": 500.0}, 51, 0.6),
    "presliding": ((1,), {"level": 4.0, "displacement": 0.02}, 51, 0.1),
    "saturation": ((1,), {"level": 22.3}, 51, 0.02),
}


@pytest.mark.parametrize("effect", quick_first(WEAK))
def test_bodies_angles_and_reports_that_are_wrong_are_named(effect):
    joints, size, seed, share = WEAK[effect]
    case = short_case(arm(), Effect(effect, joints, size), seed=seed, duration=8.0)
    (finding,) = searched(case)[1]
    same = {(finding.effect.name, finding.joints), *finding.equivalent}
    assert (effect, joints) in same
    if share is not None:
        assert finding.effect.name == effect
        key, truth = next(iter(size.items()))
        (value,), (sd,), *_ = finding.parameters[key]
        assert value == pytest.approx(truth, rel=share)
        assert sd > 0


# Named among six, and not the other of two.
@pytest.mark.parametrize(
    ("robot", "link"), [(arm, 2), pytest.param(irb140, 3, marks=pytest.mark.long)]
)
def test_a_link_of_another_mass_is_named(robot, link):
    heavier = Effect("link_inertia", (link,), {"scale": 0.5})
    (finding,) = searched(short_case(robot(), heavier, seed=51, duration=8.0))[1]
    assert (finding.effect.name, finding.joints) == ("link_inertia", (link,))
    # The arm of two joints may take a part of it for the other link's.
    near = 0.1 if link == 3 else 0.2
    assert finding.parameters["scale"][0] == pytest.approx([0.5], rel=near)


@pytest.mark.parametrize(
    ("scale", "others"),
    [(0.7, [("payload", (6,))]), pytest.param(-0.5, [], marks=pytest.mark.long)],
)
def test_a_heavier_last_link_may_as_well_be_a_load(scale, others):
    """No load is lighter than nothing."""
    model = pin.Model(irb140().model)
    model.inertias[6] = pin.Inertia(2.0, 0.08 * np.eye(3)[2], 8e-3 * np.eye(3))
    robot = replace(irb140(), model=model)
    changed = Effect("link_inertia", (6,), {"scale": scale})
    (finding,) = searched(short_case(robot, changed, seed=51, duration=8.0))[1]
    assert (finding.effect.name, finding.joints) == ("link_inertia", (6,))
    assert [*finding.equivalent] == others
