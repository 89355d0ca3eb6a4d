"""Models as records and as exports: what is carried comes back, the rest is said."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from residual.calibration.correction_choice import MAIN
from residual.effects import load_effects
from residual.effects.base import MotionSpan
from residual.errors import InputError, UnknownNameError
from residual.export.c99 import to_c99
from residual.export.model_export import build_reference_motion, remove_tables, to_json
from residual.export.urdf_mjcf import to_mjcf, to_urdf
from residual.model.lookup import (
    NONE,
    CorrectedModel,
    JointCorrection,
    LevelAxis,
    Lookup,
    LookupTable,
    build_lookup_files,
)
from residual.model.model import Model, Term
from residual.model.model_files import load_model, model_from_record
from residual.robot.dynamics import read_inertial_parameters
from residual.robot.robot import Robot, load_robot
from residual.signals.track import CHOICES, FilterSettings, build_tracks
from tests.exports.models import NAMES, model_with, robot_of
from tests.residual.arms import SEVEN, arm, recording, smooth_motion, urdf_text

# A model as a record: it comes back whole, and can be taken apart.


AGAIN = r"Write it again: modelgap diagnose LOG\.\.\. --save-model FILE"
SPEEDS = (0.01, 0.02)


def term(robot: Robot, name: str, seed: int) -> Term:
    """An effect somewhere on the arm, with coefficients drawn."""
    rng, effect = np.random.default_rng(seed), load_effects()[name]
    places = effect.candidates(robot.dof)
    joints = places[seed % len(places)]
    dof = robot.dof
    span = MotionSpan(np.full(dof, 1.5), np.full(dof, 2.0), 60.0, 8.0, np.full(dof, 5.0))
    shapes = effect.shapes(span, joints[0] if joints else 0)
    shape = shapes[seed % len(shapes)] if shapes else ()
    seen = Model(robot, read_inertial_parameters(robot.model), (), np.full(dof, 0.01))
    count = effect.columns(seen.observe(seen_track(robot)), joints, shape).shape[2]
    return Term(effect, joints, shape, 1e-3 * rng.normal(size=count))


def seen_track(robot: Robot):
    (track,), _ = build_tracks([log_of(robot)], FilterSettings(), full_rate=True)
    return track


def log_of(robot: Robot):
    t = 3.7 + np.arange(400) / 200
    q, _, _ = smooth_motion(robot, t)
    return recording(t, q, 0 * q)


def model_of(names, robot=None, seed=0) -> Model:
    robot = robot or arm(SEVEN)
    rng = np.random.default_rng(seed)
    inertial = read_inertial_parameters(robot.model)
    return Model(
        robot,
        inertial * (1 + 0.05 * rng.normal(size=len(inertial))),
        tuple(term(robot, name, seed + i) for i, name in enumerate(names)),
        np.linspace(*SPEEDS, robot.dof),
        tuple(CHOICES[(seed + j) % len(CHOICES)] for j in range(robot.dof)),
        clock=1.25 if seed % 2 else None,
    )


def lookup(rng) -> Lookup:
    edges = np.sort(rng.normal(size=3))
    return Lookup(
        names=("qd1", "q1", "load"),
        joints=("J1",),
        axes=(LevelAxis(0, edges), LevelAxis(1, edges + 0.1)),
        tables=(
            LookupTable((0,), rng.normal(size=(4, 1))),
            LookupTable((0, 1), rng.normal(size=(4, 4, 1))),
        ),
        offset=rng.normal(size=1),
        slope=rng.normal(size=(3, 1)),
        low=np.full(3, -1e3),
        high=np.full(3, 1e3),
    )


def through_text(record: dict) -> dict:
    return json.loads(json.dumps(record, allow_nan=False))


@pytest.mark.parametrize("name", NAMES)
def test_every_effect_comes_back_with_the_very_bits(name):
    model = model_of([name, "viscous"])
    again = model_from_record(through_text(model.to_record()))
    log = log_of(model.robot)
    assert_array_equal(again.predict(log), model.predict(log))
    assert through_text(again.to_record()) == through_text(model.to_record())


def test_tables_on_top_of_a_model_come_back_with_the_very_bits(tmp_path):
    rng = np.random.default_rng(4)
    columns = (("qd", (0,), ""), ("q", (0, 1), "difference"))
    model = model_of(["coulomb"], arm())
    tables = (
        JointCorrection(0, columns, lookup(rng), MAIN),
        JointCorrection(1, (), lookup(rng), NONE),
    )
    corrected = CorrectedModel(model, tables)
    again = model_from_record(through_text(corrected.to_record()))
    corrected.save(tmp_path / "model.json")
    log = log_of(model.robot)
    for one in (again, load_model(tmp_path / "model.json")):
        assert_array_equal(one.predict(log), corrected.predict(log))
    assert np.abs(corrected.predict(log) - model.predict(log))[:, 0].max() > 0.01
    assert again.uncorrected_joints == (1,)
    assert repr(corrected).endswith("tables on J1)")


def test_a_term_that_is_no_effect_is_refused():
    record = through_text(model_of(["coulomb"]).to_record())
    record["background"] = [{**record["terms"][0], "name": "table_of_speed"}]
    with pytest.raises(InputError, match="table_of_speed"):
        model_from_record(record)


def test_the_robot_comes_back_without_its_files(tmp_path):
    text = urdf_text().replace('type="revolute"', 'type="continuous"', 1)
    (tmp_path / "arm.urdf").write_text(text)
    (tmp_path / "robot.toml").write_text(
        "[robot]\nname = 'lab'\ngravity = [0, 1.0, -9.7]\n[declared.coulomb]\nlevel = [3, 4]\n"
    )
    robot = load_robot(tmp_path)
    again = model_from_record(through_text(model_of([], robot).to_record())).robot
    assert (again.name, again.content_hash) == ("lab", robot.content_hash)
    assert not np.isfinite(again.upper[0])
    assert_array_equal(again.upper, robot.upper)
    assert_array_equal(again.model.gravity.linear, robot.model.gravity.linear)
    assert_array_equal(again.declared["coulomb"].values["level"], [3, 4])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"form": 1, "t', f"JSON, got an error in line 1, column 13. {AGAIN}"),
        ("\xff", f"expected JSON, got other data. {AGAIN}"),
        ("[1]", f"not the file of a model: expected a JSON object. {AGAIN}"),
        ('{"form": 9}', "form 9, expected 1"),
        ('{"form": 1}', f"damaged: it lacks the key 'speed_floor'. {AGAIN}"),
        ('{"form": 1, "speed_floor": 1, "robot": 3}', f"a value has another kind or size. {AGAIN}"),
        (None, "holds the tables of a calibration, expected a model: that is corrected"),
    ],
)
def test_what_is_no_model_is_refused(tmp_path, text, message):
    tables = build_lookup_files(lookup(np.random.default_rng(0)))["model.json"]
    content = tables if text is None else text.encode("latin-1")
    (tmp_path / "model.json").write_bytes(content)
    with pytest.raises(InputError, match=message):
        load_model(tmp_path / "model.json")


def test_an_effect_is_taken_out_of_all_or_of_some_joints_and_nothing_else():
    model = model_of(["payload", "coulomb", "stribeck"])
    log = log_of(model.robot)
    less = model.without("payload")
    expected = replace(model, terms=model.terms[1:]).predict(log)
    assert_array_equal(less.predict(log), expected)
    assert np.abs(less.predict(log) - model.predict(log)).max() > 1e-6
    robot = arm()
    terms = [Term(load_effects()["coulomb"], (j,), (), np.ones(1)) for j in (0, 1)]
    model = replace(model_of([], robot), terms=tuple(terms))
    assert model.without("coulomb", joints=[2]).terms == (terms[0],)
    with pytest.raises(InputError, match="no coulomb on joints"):
        model.without("coulomb", joints=[3])
    with pytest.raises(UnknownNameError, match="Valid: coulomb"):
        model_of(["coulomb"]).without("payload")


def test_a_parameter_is_set_and_the_others_stay():
    model = model_of(["payload"])
    heavy = model.with_parameters("payload", mass=2.0, com_z=0.1)
    (before,), (after,) = model.terms, heavy.terms
    expected = before.parameters(model.robot) | {"mass": 2.0, "com_z": 0.1}
    assert after.parameters(model.robot) == pytest.approx(expected, abs=1e-9)
    with pytest.raises(UnknownNameError, match="parameter of payload"):
        model.with_parameters("payload", weight=1.0)


def changed_friction() -> Model:
    """A model whose declared friction was refitted, with a change found beside it."""
    coulomb, viscous = load_effects()["coulomb"], load_effects()["viscous"]
    nominal = [Term(coulomb, (j,), (), np.array([4.0])).as_nominal() for j in (0, 1)]
    free = Term(viscous, (1,), (), np.zeros(1)).as_nominal()
    terms = [replace(t, theta=np.array([4.2])) for t in nominal]
    terms.append(replace(free, theta=np.array([0.7])))
    terms.append(Term(coulomb, (1,), (), np.array([3.0])))
    return replace(model_of([]), terms=tuple(terms))


def test_a_declared_value_goes_back_to_the_nominal_one_and_a_new_one_is_whole():
    model = changed_friction()
    less = model.without("coulomb", [2])
    assert [t.theta.tolist() for t in less.terms] == [[4.2], [4.0], [0.7]]
    every = model.without("coulomb")
    assert [t.theta.tolist() for t in every.terms] == [[4.0], [4.0], [0.7]]
    again = every.without("coulomb")
    assert [t.theta.tolist() for t in again.terms] == [[4.0], [4.0], [0.7]]
    # Of what no value was given, nothing is the nominal value.
    assert [t.effect.name for t in model.without("viscous").terms] == 3 * ["coulomb"]
    model = changed_friction()
    set_ = model.with_parameters("coulomb", [2], level=5.0)
    assert [t.theta.tolist() for t in set_.terms] == [[4.2], [5.0], [0.7]]
    assert set_.without("coulomb", [2]).terms[1].theta.tolist() == [4.0]


def test_the_torque_at_states_is_that_of_the_log():
    model = model_of(["payload", "viscous", "spring", "torque_gain"])
    smooth = replace(model, standstill=())
    track = seen_track(model.robot)
    expected = smooth.torque_on(track)
    torque = smooth.torque(track.q, track.qd, track.qdd)
    np.testing.assert_allclose(torque, expected, rtol=1e-12, atol=1e-12)
    few = slice(7, 9)
    np.testing.assert_allclose(
        smooth.torque(track.q[few], track.qd[few], track.qdd[few]), expected[few]
    )


@pytest.mark.parametrize("name", ["delay", "warmup", "presliding"])
def test_what_depends_on_more_than_the_state_is_refused(name):
    model = model_of([name])
    q = np.zeros((2, 7))
    with pytest.raises(InputError, match=f"{name} depends on more than the state"):
        model.torque(q, q, q)
    assert model.without(name).torque(q, q, q).shape == (2, 7)


# Laws of the exports: what is carried is right, and the rest is said with its size.


WRITERS = {"json": to_json, "urdf": to_urdf, "mjcf": to_mjcf, "c99": to_c99}
# What each target can say of one effect alone; all else must be listed.
JOINTS = {"drive_damping", "viscous", "coulomb"}
BODIES = {"payload", "link_body", "link_inertia"}
MUJOCO = {"rotor_inertia", "spring", "quadratic_viscous", "base_tilt"}
AHEAD = {"backlash", "elasticity"}  # they look ahead in time
CARRIED = {
    "json": set(NAMES),
    "urdf": JOINTS | BODIES,
    "mjcf": JOINTS | BODIES | MUJOCO,
    "c99": set(NAMES) - AHEAD,
}


@pytest.mark.parametrize("target", sorted(WRITERS))
@pytest.mark.parametrize("name", NAMES)
def test_a_target_carries_an_effect_or_lists_it_with_its_torque(target, name):
    source = model_with(robot_of("irb140"), "viscous", name)
    export = WRITERS[target](source)
    omissions = [each for each in export.omissions if each.name == name]
    kept = [t.effect.name for t in remove_tables(export.carried).terms]
    if name in CARRIED[target]:
        assert omissions == []
        assert name in kept
    else:
        (omission,) = omissions
        assert name not in kept
        motion = build_reference_motion(source.robot)
        gap = source.along(motion.t, motion.parts)
        gap = gap - source.without(name).along(motion.t, motion.parts)
        assert omission.largest == pytest.approx(np.abs(gap).max())
        assert 0 < omission.rms <= omission.largest
        assert export.largest == pytest.approx(omission.largest)
        assert str(omission).startswith(f"{name}")
        assert omission.why


def _corrected(robot) -> CorrectedModel:
    rng = np.random.default_rng(4)
    columns = (("qd", (0,), ""), ("q", (1,), ""))
    own = tuple(JointCorrection(j, columns, lookup(rng), MAIN) for j in (1, 2))
    return CorrectedModel(model_with(robot, "viscous", "torque_gain"), own)


@pytest.mark.parametrize("target", ["urdf", "mjcf"])
def test_tables_that_a_target_has_no_place_for_are_listed(target):
    export = WRITERS[target](_corrected(robot_of("seven")))
    (tables,) = (each for each in export.omissions if each.name == "tables")
    assert tables.joints == (2, 3)
    assert tables.largest > 0
    assert isinstance(export.carried, Model)


@pytest.mark.parametrize(
    ("write", "change", "message"),
    [
        (to_urdf, {20: -1.0}, r"Link 3 has mass -1 kg.*--consistent"),
        (to_mjcf, {20: -1.0}, r"Link 3 has mass -1 kg.*--consistent"),
        (to_mjcf, {24: 50.0}, r"Link 3 has principal inertias.*c99"),
    ],
)
def test_a_body_that_cannot_be_is_refused_with_what_to_do(write, change, message):
    source = model_with(robot_of("irb140"))
    wrong = source.inertial.copy()
    wrong[list(change)] = list(change.values())
    with pytest.raises(InputError, match=message):
        write(replace(source, inertial=wrong))


def test_a_strangers_name_makes_no_path_and_no_code():
    robot = replace(robot_of("irb140"), name='../x*/"""\nimport os')
    source = model_with(robot, "viscous")
    for write in WRITERS.values():
        export = write(source)
        assert all(re.fullmatch(r"[\w-]+\.(?:\w+)", name) for name in export.files)
        for name, content in export.files.items():
            if name.endswith(".h"):
                assert b"import os" not in content
