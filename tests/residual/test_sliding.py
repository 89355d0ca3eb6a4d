"""Joints that slide: their dynamics, their units, and what is named on them."""

import json
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import modelgap as mg
from residual.effects import load_effects
from residual.quantity import convert_to_sliding_unit
from residual.robot.dynamics import build_kinematic_chain, read_inertial_parameters
from residual.robot.dynamics import compute_inertial_regressor as inertial_regressor
from residual.robot.robot import build_robot
from sim.engine.pybullet_world import BulletWorld
from tests.plain_arm import SLIDING, logs, sizes, sliding_arm, true_model, with_load


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
    assert inertial_regressor(loaded, *np.zeros((3, 1, 5))).shape == (1, 5, 50)
