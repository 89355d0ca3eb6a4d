"""A model on logs and in other programs: modelgap predict and modelgap export."""

import json
import re
from dataclasses import replace

import numpy as np
import pyarrow.csv as pc
import pyarrow.parquet as pq
import pytest

from flows.cli import main
from flows.steps.export import export_model
from flows.steps.model_choice import read_model
from residual.calibration.correction_choice import MAIN
from residual.errors import InputError
from residual.export.model_export import NoiselessMotion, build_reference_motion
from residual.export.urdf_mjcf import to_mujoco
from residual.model.compare import EDITED, WHOLE
from residual.model.lookup import CorrectedModel, JointCorrection
from residual.recording import Recording
from residual.robot.robot import load_robot
from residual.signals.track import CHOICES
from tests.exports.back import BACK, CREEP, inverse, needs_compiler, passive
from tests.exports.models import ARMS, NAMES, model_with, robot_of
from tests.residual.arms import smooth_motion, urdf_text
from tests.residual.test_model_record import lookup
from tests.synthetic.logs import write_csv
from warehouse.record_commit import commit_record

# modelgap predict: the torque of a model on logs, whole and edited.


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robot = robot_of("irb140")
    model = model_with(robot, "payload", "viscous", "spring")
    first, second, *rest = model.terms
    second = replace(second, nominal=replace(second, theta=second.theta / 2))
    model = replace(model, terms=(first, second, *rest))
    t = np.arange(1500) / 250
    q, qd, qdd = smooth_motion(robot, t)
    log = Recording("log", robot.name, t, q, model.along(t, (q, qd, qdd)))
    write_csv("log.csv", log, "%.10g")
    model.save("model.json")
    return model, log


def test_the_error_of_a_model_and_of_the_edited_one(place, tmp_path, capsys):
    words = ["log.csv", "--model", "model.json", "--json", "e.json"]
    assert main(["predict", *words]) == 0
    document = json.loads((tmp_path / "e.json").read_text())["error"]
    assert document["overall_filtered"][WHOLE] < 0.5
    assert EDITED not in document["overall"]
    assert main(["predict", *words, "--without", "payload", "spring"]) == 0
    both = json.loads((tmp_path / "e.json").read_text())
    assert both["without"] == ["payload", "spring"]
    assert both["error"]["overall_filtered"][WHOLE] < 0.5
    assert both["error"]["overall_filtered"][EDITED] > 5
    output = capsys.readouterr().out
    assert "Error in % of torque (log)" in output
    assert "edited: Model(irb140: rigid body, viscous" in output
    assert "), without payload, spring\n" in output
    heads = output[output.rindex("Error in %") :].split("───")[0]
    assert [heads.count(word) for word in ("without", "payload", "spring")] == [3] * 3
    assert main(["predict", *words, "--without", "viscous@4"]) == 0
    shown = capsys.readouterr().out
    assert "viscous J4, spring J4), without viscous@4 (at its nominal value)\n" in shown
    # All joints together have each of the six errors that a joint has.
    (last,) = (row.split() for row in output.splitlines()[-12:] if row[:3] == "all")
    moving = both["error"]["overall_moving"]
    assert len(last) == 7
    assert float(last[-1]) == pytest.approx(moving[EDITED], rel=0.01)


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_samples_are_those_of_the_model_in_python(place, tmp_path, form):
    model, log = place
    out = tmp_path / f"o.{form}"
    words = ["log.csv", "--model", "model.json", "--without", "payload"]
    assert main(["predict", *words, "--out", str(out)]) == 0
    rows = pq.read_table(out) if form == "parquet" else pc.read_csv(out)
    heads = [f"{c}{j}" for c in ("tau", "tau_model", "tau_edited") for j in range(1, 7)]
    assert rows.column_names == ["log", "t", *heads]
    for head, one in (("tau_model", model), ("tau_edited", model.without("payload"))):
        got = np.column_stack([rows[f"{head}{j}"] for j in range(1, 7)])
        np.testing.assert_allclose(got, one.predict(log), atol=1e-3)


@pytest.mark.parametrize(
    ("more", "word"),
    [
        (["--without", "stribeck"], "Valid: payload, spring, viscous"),
        (["--without", "spring@x"], "expected NAME or NAME@JOINT"),
        (["--without", "payload@2"], "no payload on joints [2]"),
        (["--out", "o.txt"], "*.csv or *.parquet"),
        (["--which", "nominal"], "--which chooses"),
    ],
)
def test_what_cannot_be_done_is_said(place, capsys, more, word):
    assert main(["predict", "log.csv", "--model", "model.json", *more]) == 2
    assert word in capsys.readouterr().err
    assert main(["predict", "--model", "model.json"]) == 2


# modelgap export, from the shell and from Python, through each target and back.


TOLERANCES = {"mjcf": 1e-9, "mujoco": 1e-9, "urdf": 1e-12, "json": 0.0, "c99": 1e-11, "rrd": 1e-12}
OTHERS = sorted(set(ARMS) - {"seven"})
REASON = {"c99": needs_compiler, "mujoco": (needs_compiler, pytest.mark.long)}
NEEDS = {"mjcf": "mujoco", "mujoco": "mujoco", "rrd": "rerun"}


def _every(robot):
    shapes = tuple(replace(CHOICES[-j - 1], hold=0.7) for j in range(robot.dof))
    source = model_with(robot, *NAMES, standstill=shapes)
    columns = (("qd", (1,), ""), ("q", (0, 2), "difference"))
    rngs = {j: np.random.default_rng(j) for j in (0, 3)}
    own = tuple(JointCorrection(j, columns, lookup(g), MAIN) for j, g in rngs.items())
    return CorrectedModel(source, own)


@pytest.mark.parametrize(
    "arm", ["seven", *(pytest.param(a, marks=pytest.mark.long) for a in OTHERS)]
)
@pytest.mark.parametrize("target", [pytest.param(t, marks=REASON.get(t, ())) for t in TOLERANCES])
def test_what_is_carried_comes_back_as_the_same_torque(target, arm):
    if target in NEEDS:
        pytest.importorskip(NEEDS[target])
    source = _every(robot_of(arm))
    if target in ("mjcf", "mujoco"):
        # Gravity that a tilted base turns acts here on links as they were described.
        bare = source.model.without("link_inertia").without("link_body")
        source = replace(source, model=bare)
    got, want = BACK[target](export_model(source, target))
    assert np.abs(got - want).max() <= TOLERANCES[target]
    assert len(want) >= 1000
    assert np.abs(want).max() > 20.0


def test_support_points_are_those_of_the_curves():
    source = model_with(robot_of("irb140"), "viscous", "coulomb", "position_friction")
    got, want = BACK["table"](export_model(source, "table"))
    assert np.abs(got - want).max() < 0.02 * np.abs(want).max()
    assert len(want) > 1000


@needs_compiler
def test_a_time_that_comes_twice_is_remembered_once():
    mujoco = pytest.importorskip("mujoco")
    source = model_with(robot_of("irb140"), "viscous", "rotor_inertia", "presliding")
    export, motion = to_mujoco(source), build_reference_motion(robot_of("irb140"), 2.0)
    with passive(export) as simulated:
        callback = mujoco.get_mjcb_passive()
        once = [callback.torque(*x).copy() for x in zip(*_all(motion), strict=True)]
        callback.reset()
        often = []
        for row in zip(*_all(motion), strict=True):
            for _ in range(3):
                last = callback.torque(*row).copy()
            often.append(last)
        assert simulated.nv == 6
    np.testing.assert_array_equal(often, once)
    dry = source.without("presliding").along(motion.t, motion.parts)
    wanted = source.along(motion.t, motion.parts) - dry
    np.testing.assert_allclose(once, wanted, atol=1e-9)


def _all(motion):
    return motion.t, *motion.parts


def test_friction_has_its_value_in_mujoco_where_the_joint_creeps():
    pytest.importorskip("mujoco")
    source = model_with(robot_of("irb140"), "coulomb", speed_floor=np.full(6, 1e-5))
    export = export_model(source, "mjcf")
    zero = np.zeros((2, 6))
    qd = CREEP * np.array([[1.0], [-1.0]]) * np.ones(6)
    (text,) = export.files.values()
    states = NoiselessMotion(np.arange(2.0), zero, qd, zero)
    usual = re.sub(r'(solref|solimp)friction="[^"]*"', "", text.decode())
    (own,) = source.terms
    (j,) = own.joints
    shares = [
        np.diff(inverse(each, states)[:, j])[0] / -2 / own.theta[0]
        for each in (text.decode(), usual)
    ]
    assert shares[0] == pytest.approx(1.0, rel=1e-6)
    assert shares[1] < 0.05


def _saved(tmp_path, *names):
    path = tmp_path / "model.json"
    model_with(robot_of("irb140"), *names).save(path)
    return str(path)


def test_the_command_writes_and_lists(tmp_path, capsys):
    path, out = _saved(tmp_path, "viscous", "load_friction"), tmp_path / "out"
    report = tmp_path / "told.json"
    words = ["export", path, "--to", "mjcf", "--out", str(out), "--json", str(report)]
    assert main(words) == 0
    shown = capsys.readouterr().out
    assert [p.name for p in out.iterdir()] == ["irb140.xml"]
    assert "not exported: load_friction J4: up to " in shown
    assert "MJCF cannot represent it" in shown
    document = json.loads(report.read_text())
    (left,) = document["left"]
    assert (left["name"], left["joints"]) == ("load_friction", [4])
    assert f"up to {left['largest']:.3g} N m" in shown
    assert set(document) == {"schema", "files", "left", "missing"}
    assert document["missing"]["largest"] == pytest.approx(left["largest"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--to", "mjfc"], "Unknown target 'mjfc': did you mean 'mjcf'?"),
        (["--to", "urdf", "--which", "nominal"], "--which chooses among"),
    ],
)
def test_a_wrong_word_says_what_is_right(tmp_path, capsys, words, message):
    path, out = _saved(tmp_path, "viscous"), tmp_path / "out"
    assert main(["export", path, "--out", str(out), *words]) == 2
    assert message in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("content", ["", "[1]", "{}", '{"form": 99}', None])
def test_a_file_that_cannot_be_exported_leaves_no_folder(tmp_path, capsys, content):
    path, out = tmp_path / "model.json", tmp_path / "out"
    if content is None:
        source = model_with(robot_of("irb140"), "viscous")
        replace(source, inertial=np.append(-1.0, source.inertial[1:])).save(path)
    else:
        path.write_text(content)
    assert main(["export", str(path), "--to", "mjcf", "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.startswith("modelgap: ")
    assert content is not None or "Link 1 has mass -1 kg" in error
    assert not out.exists()


def test_models_of_the_store_are_found_by_their_id(tmp_path):
    source = model_with(robot_of("irb140"), "viscous")
    record = {"robot": "irb140", "stage": "identified", "request": None}
    ids = [
        commit_record(tmp_path, "models", {**record, **more})
        for more in ({"model": source.to_record()}, {"nominal": source.to_record()}, {})
    ]
    for id in ids[:2]:
        assert read_model(tmp_path, id[:8]).to_record() == source.to_record()
    with pytest.raises(InputError, match="without its values"):
        read_model(tmp_path, ids[2])


FINGER = """<link name="jaw"><inertial><mass value="0.1"/><inertia ixx="1e-4" ixy="0"
ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link><joint name="finger"
type="prismatic"><parent link="flange"/><child link="jaw"/><axis xyz="0 1 0"/>
<limit lower="0" upper="0.04" effort="9" velocity="1"/></joint>"""


@pytest.mark.parametrize(("to", "told"), [("urdf", 1), ("mjcf", 1), ("c99", 0)])
def test_fingers_that_become_fixed_joints_are_named(tmp_path, capsys, to, told):
    arm = tmp_path / "arm"
    arm.mkdir()
    (arm / "arm.urdf").write_text(urdf_text(extra=FINGER))
    (arm / "robot.toml").write_text("[locked]\nfinger = 0.01\n")
    model = model_with(load_robot(arm), "viscous")
    model.save(tmp_path / "m.json")
    record = {"robot": "arm", "stage": "identified", "model": model.to_record()}
    store = tmp_path / "store"
    id = commit_record(store, "models", record)
    for number, word in enumerate((str(tmp_path / "m.json"), id)):
        words = ["export", word, "--to", to, "--out", str(tmp_path / f"o{number}")]
        assert main([*words, "--store", str(store)]) == 0
        out = capsys.readouterr().out
        line = "locked joints, exported as fixed: finger = 0.01\n"
        assert out.count(line) == told
