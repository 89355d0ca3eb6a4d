"""Values that are known for sure: how they are said, held, and what they tighten."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.attribution_parts.arms import make
from flows.inputs import parse_known_values
from residual.diagnosis.diagnose import diagnose
from residual.effects import load_effects
from residual.errors import InputError, RobotError
from residual.evidence.design import Design
from residual.evidence.fit import fit_jointly
from residual.evidence.priors import build_relative_prior
from residual.model.nominal import build_free_nominal as free_nominal
from residual.model.nominal import list_known_values, prepare_fit_logs
from residual.robot.dynamics import compute_inverse_dynamics, read_inertial_parameters
from residual.robot.robot import add_known_values, load_robot
from residual.signals.track import FilterSettings
from tests.exports.bodies import cases, diagnosed
from tests.residual.arms import TWO, arm, bare_irb140, plain_logs, recording

FRICTION = ("viscous", "coulomb")
MASS = 1.5  # kg


@pytest.mark.parametrize(
    ("word", "value", "told"),
    [
        ("payloud.mass", 2.0, "did you mean 'payload'"),
        ("foo", 3.0, "^Unknown effect of a known value 'foo': Valid: back"),
        ("payload.mas", 2.0, "did you mean 'mass'"),
        ("payload.com_x", 0.1, "parameter of payload that can be known"),
        ("payload.2.mass", 2.0, "payload has no joint; write payload.mass"),
        ("payload", 2.0, "parameter of payload that can be known"),
        ("coulomb.level", 8.0, "expected from 1 to 6 or a joint of the URDF"),
        ("coulomb.7.level", 8.0, "as in coulomb.2.level"),
        ("delay.delay", 0.1, "No value of delay can be known"),
        ("link.3.mas", 4.0, "did you mean 'mass'"),
        ("link.3.mass", -4.0, "expected a mass above 0 kg"),
    ],
)
def test_what_cannot_be_known_is_told_with_what_can(word, value, told):
    with pytest.raises((InputError, RobotError), match=told):
        list_known_values(add_known_values(bare_irb140(), {word: value}))


def test_a_robot_has_them_by_its_file_and_by_word(tmp_path):
    (tmp_path / "arm.urdf").write_text(bare_irb140().urdf)
    text = '[known]\n"payload.mass" = 2.8\n"coulomb.joint2.level" = 8\n'
    (tmp_path / "robot.toml").write_text(text)
    robot = load_robot(tmp_path)
    more = add_known_values(robot, {"payload.mass": 3.0})
    assert robot.known_values == {"payload.mass": 2.8, "coulomb.joint2.level": 8.0}
    assert more.known_values["payload.mass"] == 3.0
    assert {k.joints for k in list_known_values(more)} == {(), (1,)}
    (tmp_path / "robot.toml").write_text('[known]\n"payload.mass" = "2.8"\n')
    with pytest.raises(RobotError, match="expected a number, as in"):
        load_robot(tmp_path)


def test_the_model_has_what_is_known_and_holds_it():
    """The file says 6 kg and 3 kg and the logs speak of them; what is known stays."""
    robot = add_known_values(arm(TWO), {"link.2.mass": 2.0, "coulomb.1.level": 3.5})
    nominal_model = free_nominal(prepared(robot, 0.0), FRICTION)
    model = nominal_model.model
    assert model.inertial[10] == 2.0
    assert model.inertial[11] == pytest.approx(
        2.0 / 3.0 * read_inertial_parameters(robot.model)[11]
    )
    design = Design(prepared(robot, 0.0).tracks, model)
    own = fit_jointly(design, build_relative_prior(design, nominal_model, 1.0), (), design.rows / 5)
    coulomb = next(t for t in model.terms if t.effect.name == "coulomb")
    assert (coulomb.joints, coulomb.theta) == ((0,), pytest.approx(3.5))
    assert np.abs(own.theta[[10, (20 + model.terms.index(coulomb))]]).max() < 0.02
    assert np.abs(own.theta).max() > 0.1


def test_what_is_known_of_a_candidate_is_its_value_in_the_fit():
    scores = {}
    for known in (None, MASS, 1.2 * MASS):
        words = {} if known is None else {"payload.mass": known}
        logs = prepared(add_known_values(arm(TWO), words), MASS)
        nominal_model = free_nominal(logs, FRICTION)
        design = Design(logs.tracks, nominal_model.model)
        (group,) = design.add([(load_effects()["payload"], (1,), ())])
        prior = build_relative_prior(design, nominal_model, 0.01)
        own = fit_jointly(design, prior, (group,), design.rows / 5)
        scores[known] = own.score
        if known:
            assert own.of(group)[0] == pytest.approx(known, rel=5e-3)
    assert scores[MASS] > scores[1.2 * MASS]
    assert scores[MASS] > scores[None]


def prepared(robot, load):
    """Logs of an arm with a point of so many kilograms a hand off the last joint."""
    logs = plain_logs(robot, range(robot.dof), np.zeros(robot.dof))
    logs = [replace(log, q=log.q - 0.1) for log in logs]
    if load:
        body = robot.model.copy()
        body.inertias[robot.dof] += pin.Inertia(load, np.array([0.3, 0.05, 0.1]), 1e-3 * np.eye(3))
        out = []
        for log in logs:
            qd = np.gradient(log.q, log.t, axis=0)
            qdd = np.gradient(qd, log.t, axis=0)
            more = compute_inverse_dynamics(body, log.q, qd, qdd)
            less = compute_inverse_dynamics(robot.model, log.q, qd, qdd)
            out.append(recording(log.t, log.q, log.tau + more - less, log.id))
        logs = out
    return prepare_fit_logs(robot, logs, None, FilterSettings())


@pytest.mark.long  # two diagnoses of six joints
def test_a_load_that_was_weighed_is_known_twice_as_well_in_all_else():
    (case,) = cases(1)
    true = dict(case.hidden[0].parameters)
    logged = make(case.arm, case.hidden)
    robot = add_known_values(logged.robot, {"payload.mass": true["mass"]})
    before = diagnosed(case)
    after = diagnose(robot, logged.fit, (), logged.held_out)
    (loose,), (sharp,) = before.effects, after.effects
    assert sharp.parameters["mass"].value == pytest.approx(true["mass"], rel=5e-3)
    assert sharp.parameters["mass"].determined
    for axis in ("com_x", "com_y", "com_z"):
        own = sharp.parameters[axis]
        assert own.std <= loose.parameters[axis].std / 2
        assert abs(own.value - true[axis]) < 4 * own.std


def test_words_of_the_command_are_names_and_numbers():
    assert parse_known_values(("payload.mass=2.8", "coulomb.2.level=8")) == {
        "payload.mass": 2.8,
        "coulomb.2.level": 8.0,
    }
    for wrong in ("payload.mass", "payload.mass=", "payload.mass=heavy"):
        with pytest.raises(InputError, match=r"NAME\.PARAMETER=NUMBER"):
            parse_known_values((wrong,))


def test_a_baseline_compares_two_states_and_takes_no_known_value():
    robot = add_known_values(arm(TWO), {"payload.mass": 2.0})
    logs = plain_logs(robot, range(2), np.zeros(2))
    with pytest.raises(InputError, match="belong to one state of the arm"):
        diagnose(robot, logs[:2], logs[2:])
