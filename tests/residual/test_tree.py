"""Files that hold more than an arm, and joints that slide."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import modelgap as mg
from flows.cli import main
from flows.inputs import load_command_robot as load_arm
from flows.inputs import load_run_robot
from residual.effects import load_effects
from residual.errors import RobotError, UnknownNameError
from residual.quantity import convert_to_sliding_unit
from residual.robot.dynamics import (
    build_kinematic_chain,
    compute_inertial_regressor,
    compute_inverse_dynamics,
    find_flange_frame,
    read_inertial_parameters,
)
from residual.robot.robot import build_robot, load_robot
from residual.robot.urdf import ArmChoice, read_urdf
from sim.engine.pybullet_world import BulletWorld
from tests.plain_arm import SLIDING, logs, sizes, sliding_arm, true_model, with_load
from warehouse.robots import find_robot_by_hash

LIMIT = '<limit lower="{low}" upper="{high}" velocity="2" effort="90"/>'


def link(name, mass=2.0, at="0.03 0.02 0.1"):
    body = (
        f'<inertial><origin xyz="{at}" rpy="0.1 0.2 0"/><mass value="{mass}"/>'
        '<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0.001" ixz="0" iyz="0"/>'
        "</inertial>"
    )
    return f'<link name="{name}">{body if mass else ""}</link>'


def joint(name, parent, child, kind="revolute", axis="0 1 0", span=(-2, 2), extra=""):
    limit = LIMIT.format(low=span[0], high=span[1])
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/>'
        f'<child link="{child}"/><origin xyz="0.1 0 0.3" rpy="0.3 0 0.2"/>'
        f'<axis xyz="{axis}"/>{limit}{extra}</joint>'
    )


def robot_of(*parts, base="base"):
    return f'<robot name="made">{link(base)}{"".join(parts)}</robot>'


MIMIC = '<mimic joint="finger1" multiplier="-1" offset="0.01"/>'
ARM = [
    *(joint(f"j{i}", f"l{i - 1}" if i > 1 else "base", f"l{i}") for i in range(1, 5)),
    *(link(f"l{i}") for i in range(1, 5)),
]
HAND = [
    joint("hand_fix", "l4", "hand", "fixed"),
    link("hand", 0.4),
    joint("finger1", "hand", "f1", "prismatic", span=(0, 0.04)),
    link("f1", 0.1),
    joint("finger2", "hand", "f2", "prismatic", span=(0, 0.04), extra=MIMIC),
    link("f2", 0.1),
]
HEAD = [joint("pan", "base", "head", axis="0 0 1"), link("head", 1.5)]
LIFT = [
    joint("lift", "foot", "base", "prismatic", "0 0 1", (0.2, 0.6)),
    joint("wheel", "foot", "w", "continuous"),
    link("w", 3.0),
]
MANY = robot_of(*ARM, *HAND, *HEAD, *LIFT, link("foot"))


def write(folder, text, toml=None):
    (folder / "made.urdf").write_text(text)
    if toml is None:
        return folder / "made.urdf"
    (folder / "robot.toml").write_text(toml)
    return folder


@settings(max_examples=10, deadline=None)
@given(
    finger=st.floats(-0.5, 0.5),
    lift=st.floats(-1.0, 1.0),
    pan=st.floats(-3.0, 3.0),
    seed=st.integers(0, 99),
)
def test_locked_joints_are_those_of_pinocchios_reduced_model(finger, lift, pan, seed):
    locks = {"finger1": finger, "lift": lift, "pan": pan, "wheel": 0.4}
    names = tuple(f"j{i}" for i in range(1, 5))
    arm = read_urdf(MANY, "made.urdf", ArmChoice(names, locked=locks))
    ours = pin.buildModelFromXML(arm.urdf)
    model = pin.buildModelFromXML(MANY)  # without mimic: both fingers are free
    at = locks | {"finger2": 0.01 - finger}
    q0 = pin.neutral(model)
    for name, value in at.items():
        one = model.joints[model.getJointId(name)]
        turns = one.nq == 2  # a wheel, by cosine and sine
        q0[one.idx_q : one.idx_q + one.nq] = [np.cos(value), np.sin(value)] if turns else value
    reduced = pin.buildReducedModel(model, [model.getJointId(n) for n in at], q0)
    assert list(ours.names)[1:] == list(reduced.names)[1:] == list(names)
    motion = np.random.default_rng(seed).normal(size=(3, 1, 4))
    np.testing.assert_allclose(
        compute_inverse_dynamics(ours, *motion),
        compute_inverse_dynamics(reduced, *motion),
        atol=1e-10,
    )
    np.testing.assert_allclose(
        compute_inertial_regressor(ours, *motion),
        compute_inertial_regressor(reduced, *motion),
        atol=1e-10,
    )


@pytest.mark.parametrize(
    ("parts", "logged", "chain"),
    [
        ((*ARM, *HAND), (), "j1 j2 j3 j4"),  # fingers are no part of an arm
        ((*ARM, *HAND), ("finger1", "finger2", "j1", "j2", "j3", "j4"), "j1 j2 j3 j4"),
        ((*ARM, *HEAD), ("pan", "j1", "j2", "j3", "j4"), "j1 j2 j3 j4"),
        ((*ARM, *HEAD), ("j4", "j3", "j2", "j1"), "j1 j2 j3 j4"),
        ((*ARM, *HEAD), ("pan",), "pan"),
        ((*ARM,), ("j2", "j3"), "j2 j3"),
        ((*ARM,), ("j1", "j4"), "j1 j2 j3 j4"),  # none in the middle stands unseen
        ((*ARM,), ("other",), "j1 j2 j3 j4"),
    ],
)
def test_the_chain_is_what_the_log_names_else_the_only_one(parts, logged, chain):
    arm = read_urdf(robot_of(*parts), "made.urdf", ArmChoice(logged=logged))
    assert list(pin.buildModelFromXML(arm.urdf).names)[1:] == chain.split()


def test_the_hash_covers_chain_and_locks_and_only_what_was_chosen_survives(tmp_path):
    plain = load_arm(write(tmp_path, robot_of(*ARM, *HAND)))
    toml = '[chain]\njoints = ["j1", "j2", "j3", "j4"]\n'
    same = load_arm(write(tmp_path, robot_of(*ARM, *HAND), toml))
    assert same.content_hash == plain.content_hash
    other = load_arm(write(tmp_path, robot_of(*ARM, *HAND), "[locked]\nfinger1 = 0.02\n"))
    assert other.locked == {"finger1": 0.02, "finger2": pytest.approx(-0.01)}
    fewer = load_arm(tmp_path, chain=("j1", "j2", "j3"))
    assert len({plain.content_hash, other.content_hash, fewer.content_hash}) == 3
    again = build_robot(fewer.name, fewer.urdf, fewer.toml)
    assert again.joints == fewer.joints
    assert again.content_hash == fewer.content_hash


def test_a_file_with_odd_things_is_read_and_they_are_named(tmp_path):
    fixed = joint("f", "l3", "tip", "fixed", extra='<mimic joint="j1"/>')
    text = robot_of(
        *(joint("j1", "base", "l1"), link("l1", 0), link("l2", 0), link("l3")),
        joint("j2", "l1", "l2").replace('lower="-2" upper="2"', ""),
        *(joint("j3", "l2", "l3"), fixed, link("tip"), link("alone")),
    ).replace('velocity="2" effort="90"', 'velocity="inf"')
    robot = load_arm(write(tmp_path, text))
    assert robot.joints == ("j1", "j2", "j3")
    assert np.isinf([robot.velocity_limit, robot.torque_limit]).all()
    assert (robot.lower[0], robot.upper[1]) == (-2, np.inf)
    notes = " / ".join(robot.notes)
    for part in ("no joint: alone", "next: j1, j2", "'j2' has no range"):
        assert part in notes


@pytest.mark.parametrize(
    ("parts", "choice", "flange"),
    [
        ((*ARM, *HAND), {}, "hand"),  # no finger
        ((*ARM, *HAND), {"tip": "l4"}, "l4"),
        ((*ARM, *HAND), {"chain": ("j1", "j2")}, "l2"),
        ((*ARM, *HAND[:2]), {}, "hand"),
        ((*ARM, *HAND[:2]), {"tip": "l4"}, "l4"),
        ((*ARM, *HAND, '<modelgap flange="l4"/>'), {}, "l4"),
        ((*ARM, *HAND, '<modelgap flange="l4"/>'), {"tip": "hand"}, "hand"),
        ((*ARM, *HAND, '<modelgap flange="gone"/>'), {}, "hand"),
    ],
)
def test_the_flange_is_the_tip_else_the_last_link_before_fingers(tmp_path, parts, choice, flange):
    robot = load_arm(write(tmp_path, robot_of(*parts)), **choice)
    place = pin.buildModelFromXML(robot.urdf).frames
    (expected,) = (f.placement for f in place if f.name == flange)
    again = build_robot(robot.name, robot.urdf, robot.toml)
    assert again.content_hash == robot.content_hash
    for arm in (robot, again):
        frame = arm.model.frames[find_flange_frame(arm.model)]
        assert (frame.name, frame.placement) == (flange, expected)


def test_the_last_link_is_pinocchios(tmp_path):
    names = ["zz", "b", "Z", "a1", "j10", "j9"]
    fixed = [joint(n, "l4", f"end_{n}", "fixed") for n in names]
    fixed += [link(f"end_{n}") for n in names]
    text = robot_of(*ARM, *fixed, joint("c", "end_zz", "last", "fixed"), link("last"))
    model = pin.buildModelFromXML(text)
    flange = model.frames[find_flange_frame(model)].name
    robot = load_arm(write(tmp_path, text), tip=flange)
    assert flange == "last"
    assert "modelgap" not in robot.urdf


BAD = {
    "unknown joint": (dict(chain=("j1", "j9")), "joint of the chain.*'j9'"),
    "fixed joint": (dict(chain=("j1", "hand_fix")), "'hand_fix' of the chain is fixed"),
    "follower": (dict(chain=("j1", "finger2")), "'finger2' .*cannot move by itself"),
    "leader": (dict(chain=("j1", "finger1")), "'finger2' follows 'finger1'"),
    "two branches": (dict(chain=("pan", "j2")), "'pan' and 'j2' are on no one chain"),
    "unknown tip": (dict(tip="l9"), "link of made.urdf 'l9'"),
    "tip at rest": (dict(tip="foot"), "no joint moves link 'foot'"),
    "no choice": ({}, "branches: it has 3 chains"),
}


@pytest.mark.parametrize(("choice", "message"), BAD.values(), ids=BAD)
def test_a_choice_that_is_none_is_refused(tmp_path, choice, message):
    with pytest.raises((RobotError, UnknownNameError), match=message):
        load_arm(write(tmp_path, MANY), **choice)


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ("[chain]\njoint = []\n", "did you mean 'joints'"),
        ("[chain]\njoints = [1]\n", "expected a list of names"),
        ("chain = 3\n", "must be a table"),
        ("[locked]\nfinger1 = 'open'\n", "expected a position in rad or m"),
        ("[locked]\nfingr1 = 0\n", "did you mean 'finger1'"),
    ],
)
def test_a_robot_toml_that_says_no_choice_is_refused(tmp_path, toml, message):
    with pytest.raises((RobotError, UnknownNameError), match=message):
        load_robot(write(tmp_path, robot_of(*ARM, *HAND), toml))


def test_all_that_is_wrong_with_a_file_is_said_at_once(tmp_path):
    text = robot_of(
        *(joint("a", "base", "x", "ball"), joint("b", "base", "y", axis="0 0 0")),
        *(link("x", -2.0), link("x")),
    )
    with pytest.raises(RobotError) as caught:
        load_arm(write(tmp_path, text))
    for part in (
        *("'x' is not unique", "unknown type 'ball'", "'y', which is not found"),
        *("link 'x' has mass -2", "joint 'b' has an axis of length zero"),
    ):
        assert part in str(caught.value)


def test_runs_of_a_chain_bring_it_along_and_a_model_stays_with_its_own(tmp_path):
    file, store = write(tmp_path, MANY), tmp_path / "store"
    arm = load_arm(file, chain=("j1", "j2", "j3", "j4"))
    for n, log in enumerate(logs(arm, arm.model, "abc", 3, seconds=8.0)):
        names = ["t", *(f"{s}{j}" for s in ("q", "tau") for j in range(1, 5))]
        table = np.column_stack([log.t, log.q, log.tau])
        path = tmp_path / f"{n}.csv"
        np.savetxt(path, table, delimiter=",", header=",".join(names), comments="")
        words = ["import", str(path), "--robot", str(file), "--store", str(store)]
        assert main([*words, "--chain", "j4,j1,j2,j3"]) == 0
    runs = [p.name[7:] for p in (store / "samples/robot=made").iterdir()]
    assert load_run_robot(str(file), runs, store).content_hash == arm.content_hash
    assert load_arm(find_robot_by_hash(store, arm.content_hash)).joints == arm.joints


# Joints that slide: their dynamics, their units, and what is named on them.


def arm(name):
    return build_robot(name, sliding_arm(name), "{}")


# The SCARA has joints of both kinds.
ONE = ["scara", *(pytest.param(n, marks=pytest.mark.long) for n in ("gantry", "rail"))]


@pytest.mark.parametrize("name", ONE)
def test_an_identified_model_is_pinocchios_regressor_times_its_parameters(name):
    robot = arm(name)
    short = logs(robot, robot.model, ["a", "b"], 3, seconds=6.0)
    model = mg.identify(robot, short).best
    q, qd, qdd = np.random.default_rng(1).normal(size=(3, 50, robot.dof))
    rigid = replace(model, terms=()).torque(q, qd, qdd)
    data = robot.model.createData()
    for i in range(len(q)):
        own = pin.computeJointTorqueRegressor(robot.model, data, q[i], qd[i], qdd[i])
        want = own @ model.inertial
        np.testing.assert_allclose(rigid[i], want, atol=1e-10 * np.abs(want).max())


@pytest.mark.parametrize("name", SLIDING)
def test_where_joints_and_flange_are(name):
    robot, rng = arm(name), np.random.default_rng(2)
    q = rng.uniform(-1, 1, (20, robot.dof))
    origins = build_kinematic_chain(robot.model).compute_joint_origins(q)
    data = robot.model.createData()
    for row, places in zip(q, origins, strict=True):
        pin.framesForwardKinematics(robot.model, data, row)
        want = [data.oMi[i].translation for i in range(1, robot.model.njoints)]
        np.testing.assert_allclose(places[1:-1], want, atol=1e-12)


def test_units_follow_the_joint():
    robot = arm("rail")
    on_rail = {k: e.units((0,), robot) for k, e in load_effects().items()}
    assert on_rail["viscous"] == {"coefficient": "N s/m"}
    assert on_rail["rotor_inertia"] == {"inertia": "kg"}
    assert on_rail["ripple"] == {"amplitude": "N", "order": "rad/m", "phase": "rad"}
    assert on_rail["payload"] == load_effects()["payload"].parameters
    turning = load_effects()["spring"].units((1,), robot)
    assert turning == {"stiffness": "N m/rad", "rest": "rad"}
    assert convert_to_sliding_unit("N m (s/rad)^p") == "N (s/m)^p"


def test_the_engine_moves_them_by_the_same_dynamics():
    robot, dt = arm("rail"), 1e-3
    rng = np.random.default_rng(4)
    q, qd = rng.uniform(-0.4, 0.4, (2, robot.dof))
    tau = rng.normal(size=robot.dof) * 20
    with BulletWorld(robot.model, dt) as world:
        world.reset(q, qd)
        world.step(tau)
        _, after = world.state()
    qdd, data = (np.array(after) - qd) / dt, robot.model.createData()
    felt = pin.rnea(robot.model, data, q, qd, qdd)
    np.testing.assert_allclose(felt, tau, atol=1e-7)


def hidden(name, joint):
    """Effects on a linear axis: what it is, and its first parameter with the unit."""
    at = {
        "spring": (lambda q, qd: 300 * (q - 0.05), ("stiffness", 300.0, "N/m")),
        "ripple": (lambda q, qd: 12 * np.cos(80 * q), ("amplitude", 12.0, "N")),
        "coulomb": (lambda q, qd: 18 * np.tanh(qd / 0.002), ("level", 18.0, "N")),
        "viscous": (lambda q, qd: 60 * qd, ("coefficient", 60.0, "N s/m")),
        "stribeck": (
            lambda q, qd: 20 * np.tanh(qd / 0.002) * np.exp(-np.abs(qd) / 0.05),
            ("level", 20.0, "N"),
        ),
    }[name]

    def torque(q, qd, qdd):
        out = np.zeros_like(q)
        out[:, joint] = at[0](q[:, joint], qd[:, joint])
        return out

    return torque, at[1]


@pytest.mark.parametrize(
    ("name", "effect", "seed"),
    [
        ("scara", "spring", 1),
        pytest.param("gantry", "stribeck", 2, marks=pytest.mark.long),
        pytest.param("rail", "ripple", 3, marks=pytest.mark.long),
        pytest.param("rail", "coulomb", 5, marks=pytest.mark.long),
        pytest.param("scara", "viscous", 4, marks=pytest.mark.long),
    ],
)
def test_what_is_hidden_on_a_linear_axis_is_named_in_its_units(name, effect, seed):
    robot = arm(name)
    sliding = [j for j in range(robot.dof) if robot.prismatic[j]]
    joint = sliding[seed % len(sliding)]
    torque, (key, size, unit) = hidden(effect, joint)
    true = true_model(robot, np.random.default_rng(seed))
    if effect in ("coulomb", "viscous"):  # hidden is what is more than its file says
        usual, speed = sizes(robot, true)
        dry, wet = {"level": [*0.1 * usual]}, {"coefficient": [*0.06 * usual / speed]}
        toml = json.dumps({"declared": {"coulomb": dry, "viscous": wet}})
        robot = build_robot(name, sliding_arm(name), toml)
    fit = logs(robot, true, "abc", 1000 + seed, torque, seconds=12.0)
    held_out = logs(robot, true, "d", 2000 + seed, torque, seconds=12.0)
    diagnosis = mg.diagnose(robot, fit, held_out=held_out)
    first = diagnosis.effects[0]
    value = first.parameters[key]
    assert (first.name, first.joints, value.unit) == (effect, (joint + 1,), unit)
    assert abs(value.value - size) < max(2 * value.std, 0.02 * size)
    # Torques and forces have no sum.
    mixed = name != "gantry"
    assert (diagnosis.to_json()["error"]["overall"]["augmented"] is None) == mixed


@pytest.mark.long
def test_a_load_on_an_arm_on_a_rail_is_named_in_kilograms():
    robot = arm("rail")
    true = true_model(robot, np.random.default_rng(5))
    loaded = with_load(true, 2.5, np.array([0.06, 0.02, 0.05]))
    fit, held_out = logs(robot, loaded, "abc", 5), logs(robot, loaded, "d", 6)
    diagnosis = mg.diagnose(robot, fit, held_out=held_out)
    assert diagnosis.effects[0].name == "payload"
    mass = diagnosis.effects[0].parameters["mass"]
    assert mass.unit == "kg"
    assert abs(mass.value - 2.5) < 2 * mass.std
    assert read_inertial_parameters(loaded).shape == (50,)
    assert compute_inertial_regressor(loaded, *np.zeros((3, 1, 5))).shape == (1, 5, 50)
