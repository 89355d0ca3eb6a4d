"""modelgap check: what it says, in words and as JSON, and that it exits with 0."""

import json
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from flows.steps import check as steps
from residual.check.result import Fault, LogCheck, Repair, read_log_check
from residual.errors import InputError

HIDDEN = Path(__file__).parents[2] / "examples" / "hidden"


def run(words):
    return main(words.split())


@pytest.fixture
def log(tmp_path, monkeypatch):
    """Return a function that writes a spoiled copy of an example; it is A.csv."""
    monkeypatch.chdir(tmp_path)
    table = np.genfromtxt(HIDDEN / "fit_3.csv", delimiter=",", names=True)[:1500]

    def write(spoil=lambda table: None, name="A"):
        own = table.copy()
        spoil(own)
        np.savetxt(
            f"{name}.csv",
            np.array(own.tolist()),
            delimiter=",",
            header=",".join(own.dtype.names),
            comments="",
        )

    return write


@pytest.fixture
def fake_check(monkeypatch):
    """Replace the core of the check; returns a function that says what it finds."""

    def set(*faults):
        monkeypatch.setattr(steps, "check_logs", lambda *_: LogCheck(tuple(faults)))

    set()
    return set


SIGN = Fault(
    "torque_sign",
    (2,),
    True,
    "Friction of joint 2 is negative.",
    (Repair("tau", (2,), sign=(-1,)),),
)
LATE = Fault("delay", (), False, "Torque is late by 8 ms.", (), "A")


def test_the_json_is_whole_and_alone_on_standard_output(log, fake_check, capsys):
    log()
    fake_check(SIGN, LATE)
    assert run("check A.csv --robot irb140 --json -") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == 1
    assert document["verdict"] == "unusable"
    sign, late = document["faults"]
    assert (sign["kind"], sign["joints"], sign["certain"]) == ("torque_sign", [2], True)
    assert sign["repair"][0].startswith("tau = {columns = [")
    assert late == {
        "kind": "delay",
        "joints": [],
        "certain": False,
        "evidence": "A: Torque is late by 8 ms.",
        "repair": [],
        "rivals": [],
        "settle": "",
    }
    assert read_log_check(document).to_json() == document


def spoil(column, rows, value):
    def apply(table):
        table[column][rows] = value

    return apply


UNREADABLE = {
    "nan": (spoil("q2", slice(7, 507), np.nan), ("spike", [2])),
    "infinite": (spoil("tau3", 7, np.inf), ("spike", [3])),
    "clock back": (spoil("t", 9, 0.0), ("clock", [])),
    "clock stands": (spoil("t", slice(9, 12), 1.0), ("clock", [])),
    "clock nan": (spoil("t", 9, np.nan), ("clock", [])),
    "torque frozen": (spoil("tau2", slice(None), 1.0), ("frozen", [2])),
    "nothing moves": (
        lambda table: [spoil(f"q{i}", slice(None), 0.1)(table) for i in range(1, 7)],
        ("frozen", []),
    ),
    "degrees": (
        lambda table: [table[f"q{i}"].__imul__(57.3) for i in range(1, 7)],
        ("angle_unit", []),
    ),
    "outside": (lambda table: table["q2"].__iadd__(3), ("out_of_range", [2])),
    "micro": (lambda table: table["t"].__imul__(1e-3), ("too_short", [])),
    "milli": (lambda table: table["t"].__imul__(1e3), ("time_unit", [])),
}


@pytest.mark.parametrize(("spoiled", "fault"), UNREADABLE.values(), ids=UNREADABLE)
def test_what_other_commands_refuse_to_read_is_a_fault_here(
    log, fake_check, capsys, spoiled, fault
):
    log(spoiled)
    assert run("check A.csv --robot irb140 --json -") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["verdict"] == "unusable"
    assert fault in [(f["kind"], f["joints"]) for f in document["faults"]]


@pytest.mark.parametrize(("column", "size"), [("q2", 1e300), ("q2", -1.7e308), ("tau3", 1e308)])
def test_a_huge_sample_is_a_fault_and_no_failure(log, capsys, column, size):
    log(spoil(column, 700, size))
    assert run("check A.csv --robot irb140 --json -") == 0
    (fault,) = json.loads(capsys.readouterr().out)["faults"]
    assert (fault["kind"], fault["joints"]) == ("spike", [int(column[-1])])
    assert fault["certain"]
    assert f"{size:.3g} at sample 700" in fault["evidence"]


@pytest.mark.parametrize("document", [{}, {"schema": 2}, {"schema": 1, "faults": [{}]}])
def test_a_document_that_is_no_check_is_refused(document):
    with pytest.raises(InputError, match="check"):
        read_log_check(document)


ROBOT_FILE = """<robot name="two"><link name="b"/>
<link name="u"><inertial><origin xyz="0 0 0.2"/><mass value="1.6"/>
  <inertia ixx="0.05" iyy="0.05" izz="0.4" ixy="0" ixz="0" iyz="0"/></inertial></link>
<link name="w"><inertial><origin xyz="0 0 0.12"/><mass value="0.7"/>
  <inertia ixx="0.004" iyy="0.004" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
</link>
<joint name="shoulder" type="revolute"><parent link="b"/><child link="u"/>
  <axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="5" effort="60"/></joint>
<joint name="elbow" type="revolute"><parent link="u"/><child link="w"/>
  <origin xyz="0 0 0.35"/><axis xyz="0 1 0"/>
  <limit lower="-2" upper="2" velocity="5" effort="0.1"/></joint></robot>"""


def test_without_a_log_the_robot_file_is_told(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ROBOT_FILE)
    assert run("check --robot arm.urdf --json arm.json") == 0
    said = capsys.readouterr().out
    assert "The robot file is implausible in 2 points." in said
    assert "Link 'u': tensor ixx 0.05, iyy 0.05, izz 0.4 kg m^2: the moment" in said
    assert "torque limit is 0.1 N m, and the weight of the arm alone takes" in said
    assert "    w (joint 2: elbow)" in said
    document = json.loads(Path("arm.json").read_text())
    assert [(f["joints"], f["certain"]) for f in document["faults"]] == [([1], False), ([2], False)]
    assert [body["flaw"] for body in document["robot"]["bodies"]] == ["impossible", None]
    assert run("check --robot irb140") == 0
    assert "Nothing in the robot file is implausible." in capsys.readouterr().out
