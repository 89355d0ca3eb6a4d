"""Laws of the effects: what each one does, by which parameters, and what no arm has."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from residual import effects
from residual.effects import load_effects
from residual.effects.base import Effect, EffectTrait, JointLimits, MotionSpan, State
from residual.model.model import Term
from residual.robot import dynamics
from tests.residual.arms import SEVEN, arm, bare_irb140

NAMES = sorted(load_effects())


ROUNDING = 1e-9
# They look along the log: at rates, at what was a while ago, at the last reversal.
WITH_MEMORY = {"backlash", "delay", "elasticity", "presliding"}


def state(robot, seed=0, n=60):
    """Any motion: nothing here depends on its being smooth."""
    q, qd, qdd = np.random.default_rng(seed).normal(size=(3, n, robot.dof))
    regressor = dynamics.compute_inertial_regressor(robot.model, q, qd, qdd)
    rigid = regressor @ dynamics.read_inertial_parameters(robot.model)
    return State(
        robot=robot,
        rate=100.0,
        t=np.arange(n) / 100,
        q=q,
        qd=qd,
        qdd=qdd,
        sign=np.sign(qd),
        regressor=regressor,
        rigid=rigid,
        tau_model=rigid + 3 * np.sign(qd),
    )


def span(dof):
    return MotionSpan(np.full(dof, 1.5), np.full(dof, 2.0), 60.0, 8.0, np.full(dof, 0.02))


def terms(name, robot, theta=None):
    """The effect on every joint it may sit on, in every shape it may start from."""
    effect = load_effects()[name]
    seen = state(robot, n=2)
    for joints in effect.candidates(robot.dof):
        for shape in effect.shapes(span(robot.dof), joints[0] if joints else 0):
            k = effect.columns(seen, joints, shape).shape[2]
            own = np.ones(k) if theta is None else theta(k)
            yield Term(effect, joints, shape, own)


def test_the_registry_is_the_folder():
    folder = Path(effects.__file__).parent
    files = {p.stem for p in folder.glob("[!_]*.py")} - {"base", "limits", "sensitivity"}
    assert files == set(load_effects())
    assert all(name == effect.name for name, effect in load_effects().items())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("dof", [1, 2, 6, 7])
def test_it_sits_on_joints_that_are_there(name, dof):
    effect = load_effects()[name]
    candidates = effect.candidates(dof)
    assert len(set(candidates)) == len(candidates)
    for joints in candidates:
        assert all(0 <= j < dof for j in joints)
        assert set(effect.rows(joints, dof)) <= set(range(dof))
    if effect.scope == "local":
        assert candidates == tuple((j,) for j in range(dof))
    if effect.scope == "flange":
        assert candidates == ((dof - 1,),)


@pytest.mark.parametrize("name", NAMES)
def test_columns_act_on_the_rows_of_the_effect_and_on_no_other(name):
    robot = arm(SEVEN)
    seen = state(robot)
    for term in terms(name, robot):
        rows = term.effect.rows(term.joints, robot.dof)
        columns = term.effect.columns(seen, term.joints, term.shape)
        assert columns.shape == (len(seen.t), len(rows), len(term.theta))
        assert np.isfinite(columns).all()
        others = np.delete(term.torque(seen), list(rows), axis=1)
        np.testing.assert_array_equal(others, 0)
        # Nothing weighs on an upright axis: where its encoder starts does not show.
        if (name, term.joints) != ("encoder_offset", (0,)):
            assert np.abs(term.torque(seen)[:, list(rows)]).max() > 0


@pytest.mark.parametrize("name", sorted(set(NAMES) - WITH_MEMORY))
def test_columns_look_at_nothing_but_the_same_sample(name):
    """Held-out motion is predicted as it was fitted, whatever else its log holds."""
    robot = arm()
    seen = state(robot)
    fields = ("t", "q", "qd", "qdd", "sign", "regressor", "rigid", "tau_model")
    part = replace(seen, **{f: getattr(seen, f)[10:20] for f in fields})
    for term in terms(name, robot):
        assert_allclose(term.torque(part), term.torque(seen)[10:20], atol=ROUNDING)


# Plain functions of the joint's own state: what a reader could type into a calculator.
PLAIN = {
    "q": lambda s: s.q[:, 0],
    "qd": lambda s: s.qd[:, 0],
    "qdd": lambda s: s.qdd[:, 0],
    "t": lambda s: s.t,
    "sgn": lambda s: np.sign,
    "sin": lambda s: np.sin,
    "cos": lambda s: np.cos,
    "exp": lambda s: np.exp,
    "tau": lambda s: s.tau_model[:, 0],
    "rigid": lambda s: s.rigid[:, 0],
    "clip": lambda s: np.clip,
}


LOCAL = [
    n
    for n in NAMES
    if load_effects()[n].scope == "local" and EffectTrait.MEMORY not in load_effects()[n].traits
]


def _evaluate(equation, values, seen):
    """The right-hand side as Python: bars are sizes, a caret a power."""
    right = equation.partition("=")[2].partition(":")[0].partition(", exponent")[0]
    right = right.replace("rigid-body torque", "rigid").replace("^", "**")
    right = re.sub(r"\|([^|]+)\|", r"abs(\1)", right)
    known = {name: of(seen) for name, of in PLAIN.items()}
    # A name before a bracket is a function, also where a parameter is called so.
    functions = {f"f_{name}": known[name] for name in ("sin", "cos", "exp")}
    right = re.sub(r"\b(sin|cos|exp)\(", r"f_\1(", right)
    return eval(right, {"abs": np.abs}, {**known, **functions, **values})


def from_parameters(name, joints, parameters):
    effect = load_effects()[name]
    numbers = np.array([parameters[key] for key in effect.parameters])
    theta, shape = effect.from_values(numbers, arm())
    return Term(effect, joints, shape, np.asarray(theta))


@pytest.mark.parametrize("name", LOCAL)
def test_the_equation_is_what_the_columns_compute_from_values_that_come_back(name):
    effect, robot = load_effects()[name], arm()
    numbers = [1.3, 0.7, 0.4][: len(effect.parameters)]
    if "exponent" in effect.parameters:
        numbers[-1] = 0.6
    theta, shape = effect.from_values(np.array(numbers), robot)
    seen = state(robot)
    columns = effect.columns(seen, (0,), shape)[:, 0, :]
    values = dict(zip(effect.parameters, numbers, strict=True))
    assert_allclose(
        np.broadcast_to(_evaluate(effect.equation, values, seen), len(seen.t)),
        columns @ theta,
        atol=1e-12,
    )
    assert_allclose(effect.values(theta, shape, robot), numbers)


COUPLED = {"level": 1.2, "coefficient": 0.4, "inertia": 0.05, "sign": -1.0}


def test_coupled_friction_loads_both_joints_of_the_shared_gear():
    """By the principle of virtual work: the torques of u = qd_i ± qd_j are (f, ±f)."""
    seen = state(arm(SEVEN))
    for sign in (1.0, -1.0):
        term = from_parameters("coupled_friction", (4, 6), {**COUPLED, "sign": sign})
        torque = term.torque(seen)
        u, du = (x[:, 4] + sign * x[:, 6] for x in (seen.qd, seen.qdd))
        assert_allclose(torque[:, 6], sign * torque[:, 4])
        smooth = torque[:, 4] - COUPLED["coefficient"] * u - COUPLED["inertia"] * du
        fast = np.abs(u) > 1.0
        assert_allclose(smooth[fast], COUPLED["level"] * np.sign(u[fast]), rtol=1e-3)


# Of coupled friction the width of its step at standstill is no parameter; delay,
# saturation and backlash have one number for both coefficient and shape.
NOT_ALL = ("payload", "coupled_friction", "delay", "saturation", "backlash")


@pytest.mark.parametrize("name", [n for n in NAMES if n not in NOT_ALL])
def test_coefficients_come_back_from_the_values(name):
    robot, rng = arm(), np.random.default_rng(5)
    seen = state(robot)
    for term in terms(name, robot, lambda k: rng.normal(size=k)):
        values = term.effect.values(term.theta, term.shape, robot)
        assert len(values) == len(term.effect.parameters)
        theta, shape = term.effect.from_values(np.asarray(values), robot)
        back = replace(term, theta=np.asarray(theta), shape=tuple(shape))
        assert_allclose(back.torque(seen), term.torque(seen), atol=1e-9, rtol=1e-9)


def test_where_there_is_nothing_to_divide_by_all_is_finite():
    assert np.isfinite(load_effects()["spring"].values(np.array([0.0, 1.0]), (), arm())).all()
    values = load_effects()["payload"].values(np.zeros(10), (), arm())
    assert np.isfinite(values).all()
    robot, effect = arm(), load_effects()["stribeck"]
    seen = state(robot)
    still = replace(seen, qd=0 * seen.qd, sign=0 * seen.sign)
    for shape in effect.shapes(replace(span(2), speed=np.zeros(2)), 0):
        assert np.isfinite(effect.columns(still, (0,), shape)).all()


LOSSES = {
    "viscous": {"coefficient": 2.0},
    "coulomb": {"level": 3.0},
    "quadratic_viscous": {"coefficient": 1.0},
    "power_viscous": {"coefficient": 1.0, "exponent": 0.3},
    "stribeck": {"level": 2.0, "velocity": 0.2, "exponent": 1.0},
    "load_friction": {"coefficient": 0.05},
    "warmup": {"level": 2.0, "time_constant": 30.0},
    "coupled_friction": {"level": 1.0, "coefficient": 0.3, "inertia": 0, "sign": -1},
}


@pytest.mark.parametrize("name", sorted(LOSSES))
@given(seed=st.integers(0, 10_000))
def test_friction_takes_power_and_never_gives_any(name, seed):
    joints = (0, 1) if name == "coupled_friction" else (1,)
    seen = state(arm(), seed)
    torque = from_parameters(name, joints, LOSSES[name]).torque(seen)
    power = (torque * seen.qd).sum(axis=1)
    assert power.min() >= -1e-12
    assert power.max() > 0


ODD = sorted({*LOSSES, "position_friction"})


@pytest.mark.parametrize("name", ODD)
def test_friction_turns_round_with_the_motion_and_stands_with_it(name):
    seen = state(arm())
    still = replace(seen, qd=0 * seen.qd, sign=0 * seen.sign)
    back = replace(seen, qd=-seen.qd, sign=-seen.sign)
    for term in terms(name, arm()):
        if name == "coupled_friction":
            term = replace(term, theta=np.array([1.0, 1.0, 0.0]))
        assert_allclose(term.torque(back), -term.torque(seen), atol=ROUNDING)
        if name != "coupled_friction":
            np.testing.assert_array_equal(term.torque(still), 0)


def load():
    inertia = np.array([[0.03, 0.004, -0.002], [0.004, 0.05, 0.001], [-0.002, 0.001, 0.04]])
    return pin.Inertia(2.5, np.array([0.4, -0.05, 0.12]), inertia)


CAMERA = """<link name="zz_camera"/><joint name="zz_mount" type="fixed">
  <parent link="l0"/><child link="zz_camera"/><origin xyz="0 0 3"/></joint>"""
ROBOTS = {
    "two": arm(),
    "seven": arm(SEVEN),
    "irb140": bare_irb140(),
    "camera on the base": arm(extra=CAMERA),
}
every_robot = pytest.mark.parametrize("robot", ROBOTS.values(), ids=ROBOTS)


@every_robot
def test_payload_is_the_body_merged_into_the_last_link(robot):
    seen = state(robot)
    term = Term(load_effects()["payload"], (robot.dof - 1,), (), load().toDynamicParameters())
    loaded = pin.Model(robot.model)
    loaded.inertias[robot.dof] = loaded.inertias[robot.dof] + load()
    with_it, without = (
        dynamics.compute_inverse_dynamics(m, seen.q, seen.qd, seen.qdd)
        for m in (loaded, robot.model)
    )
    assert_allclose(term.torque(seen), with_it - without, atol=1e-8)


@every_robot
def test_payload_is_reported_in_the_flange_frame(robot):
    """Mass, center and inertia about it as a caliper at the flange would measure."""
    body, effect = load(), load_effects()["payload"]
    placement = dynamics.find_flange_placement(robot.model)
    inertia = placement.rotation.T @ body.inertia @ placement.rotation
    numbers = body.mass, *placement.actInv(body.lever), *inertia[np.triu_indices(3)]
    keys = ["mass", "com_x", "com_y", "com_z", "ixx", "ixy", "ixz", "iyy", "iyz", "izz"]
    values = effect.values(body.toDynamicParameters(), (), robot)
    reported = dict(zip(effect.parameters, values, strict=True))
    expected = dict(zip(keys, numbers, strict=True))
    assert reported == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10)
@given(speed=st.floats(1e-3, 5), travel=st.floats(1e-3, 6), duration=st.floats(0, 4000))
def test_shapes_are_usable_however_the_arm_moved(name, speed, travel, duration):
    effect, robot = load_effects()[name], arm()
    moved = MotionSpan(np.full(2, speed), np.full(2, travel), duration, 8.0)
    seen = state(robot, n=5)
    for shape in list(effect.shapes(moved, 0))[:3]:
        for joints in effect.candidates(2)[:1]:
            assert np.isfinite(effect.columns(seen, joints, shape)).all()
        if effect.refine is not None:
            assert effect.refine.lower <= shape[0] <= effect.refine.upper


# What no arm can have: the sign and the size of every effect.


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


# Sizes as people say them: a change, a balancer, the frame of a vector, a joint.


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
