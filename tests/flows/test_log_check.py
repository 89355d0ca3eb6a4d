"""A certain fault of logs stops every command; trusted, it is a warning."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import modelgap as mg
from flows.cli import main
from flows.inputs import read_logs
from flows.report.sentences import format_headline
from flows.requests import Check, Diagnose
from flows.steps import check as steps
from flows.steps.diagnose import diagnose_stored_runs
from residual.check.result import Fault, LogCheck, Repair
from residual.errors import InputError
from residual.verdict.result import Diagnosis
from tests.checkout import ROOT
from tests.residual.identified import workplace
from tests.verdict_documents import typed
from warehouse.store_catalogue import read_record

LINE = 'tau = {columns = ["tau1", "tau2", "tau3"], sign = [1, -1, 1]}'
SIGN = Fault("torque_sign", (2,), True, "Friction gives.", (Repair("tau", (2,), sign=(-1,)),))
DOUBT = Fault("filtered", (), False, "No noise near 50 Hz.")
VERBS = ("diagnose", "identify", "calibrate", "import")


def run(words):
    return main(words.split())


@pytest.fixture
def place(own_folder):
    return workplace(own_folder, "ABCD", 4.0)


@pytest.fixture
def fake_check(monkeypatch):
    """Replace the core of the check; returns what it is asked and what it is to say."""
    said = {"faults": [], "asked": []}

    def check_logs(robot, recordings):
        said["asked"].append([recording.id for recording in recordings])
        faulty = said.get("of", recordings[0].id) == recordings[0].id
        return LogCheck(tuple(said["faults"]) if faulty else ())

    monkeypatch.setattr(steps, "check_logs", check_logs)
    return said


@pytest.fixture
def named(monkeypatch):
    """Replace the diagnosis by one that names a payload."""
    effect = {"name": "payload", "joints": [3], "probability": 0.99}

    def diagnose(*args, check, warnings, **rest):
        content = {
            "verdict": "effects",
            "effects": [effect],
            "log_check": check.to_json(),
            "warnings": [*warnings, *check.sentences],
        }
        return Diagnosis(typed(content, dof=3), sentences=("There is a load.",))

    monkeypatch.setattr("residual.diagnosis.diagnose.diagnose", diagnose)


@pytest.mark.parametrize("verb", VERBS)
def test_a_certain_fault_ends_with_two_and_the_line_that_mends_it(place, fake_check, capsys, verb):
    fake_check["faults"] = [SIGN]
    assert main([verb, "A.csv", "B.csv", "--robot", "arm.urdf"]) == 2
    first, second = capsys.readouterr().err.strip().splitlines()
    assert first == ("modelgap: The logs have a fault (torque sign, joint 2): Friction gives.")
    assert second.startswith(f"Fix: add this line (--map): {LINE}")
    assert "--trust-log" in second
    assert not Path("store").exists()


def test_trusted_logs_with_a_certain_fault_are_diagnosed_with_a_warning(place, fake_check, named):
    fake_check["faults"] = [SIGN, DOUBT]
    words = "diagnose A.csv --robot arm.urdf --trust-log --json o.json --report o.html"
    assert run(words) == 0
    verdict = json.loads(Path("o.json").read_text())
    assert [effect["name"] for effect in verdict["effects"]] == ["payload"]
    check = verdict["log_check"]
    assert (check["schema"], check["verdict"]) == (1, "unusable")
    assert [f["repair"] for f in check["faults"]] == [[LINE], []]
    warning = (
        "The logs have a fault (torque has the opposite sign (joint 2)): what follows "
        "may be due to it."
    )
    assert format_headline(typed(verdict)).startswith(warning)
    assert warning in Path("o.html").read_text(encoding="utf-8")


def test_lines_of_one_reading_that_is_suspected_mend_the_whole_signal(place, fake_check, capsys):
    order = Fault("joint_order", (1, 2), False, "", (Repair("tau", order=(2, 1, 3)),))
    unit = Fault("torque_unit", (), False, "", (Repair("tau", scale=1e-3),))
    fake_check["faults"] = [order, unit]
    assert run("check A.csv --robot arm.urdf --json -") == 0
    faults = json.loads(capsys.readouterr().out)["faults"]
    lines = {line for fault in faults for line in fault["repair"]}
    assert lines == {'tau = {columns = ["tau2", "tau1", "tau3"], unit = "N mm"}'}


def test_every_log_is_checked_healthy_runs_by_themselves(place, fake_check, named):
    words = "diagnose A.csv --robot arm.urdf --baseline B.csv --holdout C.csv"
    assert run(words) == 0
    # None of these by itself: they are of one arm.
    assert fake_check["asked"] == [["A", "C"], ["B"]]
    fake_check["of"] = "B"
    fake_check["faults"] = [SIGN]
    assert run(words) == 2


@pytest.mark.usefixtures("few_tables")
@pytest.mark.parametrize(
    "verb",
    ["identify", pytest.param("calibrate --levels 3 --components 2", marks=pytest.mark.long)],
)
def test_trusted_the_other_commands_go_on_with_a_warning(place, fake_check, verb):
    fake_check["faults"] = [SIGN]
    logs = "A.csv B.csv C.csv D.csv"  # of fewer runs blocks are left out: more fits
    assert run(f"{verb} {logs} --robot arm.urdf --trust-log --json o.json") == 0
    warnings = json.loads(Path("o.json").read_text())["warnings"]
    (warning,) = (w for w in warnings if "fault" in w)
    assert "torque sign, joint 2, certain" in warning
    assert LINE in warning


def test_what_is_imported_keeps_what_was_found(place, fake_check, capsys):
    fake_check["faults"] = [SIGN]
    assert run("import A.csv --robot arm.urdf --dry-run") == 2
    assert "ignored columns: none" in capsys.readouterr().out
    assert run("import A.csv --robot arm.urdf --trust-log") == 0
    shown = capsys.readouterr().out
    assert "warning: fault of the logs (torque sign, joint 2, certain)" in shown
    (kept,) = Path("store", "samples").glob("*/*")
    manifest = read_record(Path("store"), kept.name.removeprefix("run_id="))
    assert manifest["log_check"]["verdict"] == "unusable"


def test_runs_of_the_store_are_checked_too(place, fake_check, named):
    assert run("import A.csv B.csv --robot arm.urdf") == 0
    one, two = sorted(p.name[7:] for p in Path("store", "samples").glob("*/*"))
    fake_check["faults"], fake_check["asked"] = [SIGN], []
    for verb in ("diagnose", "identify", "calibrate"):
        assert main([verb, one, two, "--robot", "arm.urdf"]) == 2
    # A diagnosis is stored, and says which runs by their whole ids.
    assert fake_check["asked"] == [[one, two], *2 * [[one[:8], two[:8]]]]
    request = Diagnose((one,), robot="arm.urdf", held_out=(two,), store=Path("store"))
    with pytest.raises(InputError, match="torque sign, joint 2"):
        diagnose_stored_runs(request)
    trusted = Diagnose(
        (one,), robot="arm.urdf", held_out=(two,), store=Path("store"), trust_log=True
    )
    diagnosis, _ = diagnose_stored_runs(trusted)
    record = read_record(Path("store"), diagnosis)
    assert record["document"]["verdict"] == "effects"
    assert record["request"]["trust_log"] is True


def test_the_door_checks_and_refuses_likewise(place, fake_check):
    robot = mg.load_robot("arm.urdf")
    fit = mg.read_logs(["A.csv", "B.csv"], robot)
    assert repr(mg.check(robot, fit)) == "LogCheck(clean)"
    fake_check["faults"] = [SIGN, DOUBT]
    report = mg.check(robot, fit)
    assert report.verdict == "unusable"
    assert report.faults[0].repair == (LINE,)
    assert repr(report).splitlines() == [
        "LogCheck(unusable)",
        "  torque sign, joint 2 (certain): Friction gives.",
        f"    {LINE}",
        "  filtered (suspect): No noise near 50 Hz.",
    ]
    for verb in (mg.diagnose, mg.identify, mg.calibrate):
        with pytest.raises(InputError, match="torque sign, joint 2"):
            verb(robot, fit)
    identification = mg.identify(robot, fit, trust_log=True)
    assert any("torque sign" in warning for warning in identification.warnings)


@pytest.fixture(scope="module")
def hidden_logs():
    folder = ROOT / "examples" / "hidden"
    files = tuple(str(folder / f"fit_{number}.csv@:6") for number in (1, 2, 3))
    return read_logs(Check(files, robot="irb140"), "to check")


def test_two_joints_swapped_in_one_log_of_three_are_refused_with_its_name(hidden_logs):
    first, second, third = hidden_logs.fit
    order = [0, 2, 1, 3, 4, 5]
    second = replace(second, q=second.q[:, order], tau=second.tau[:, order])
    mixed = replace(hidden_logs, fit=(first, second, third))
    with pytest.raises(InputError, match=r"joint order, joints 2, 3.*Only in log fit_2@:6"):
        steps.refuse_faulty_logs(mixed, False)


def test_a_sound_log_that_alone_fits_a_wrong_reading_is_not_refused(hidden_logs, monkeypatch):
    wrong = Fault("torque_sign", (3,), True, "-", (Repair("tau", (3,), sign=(-1,)),))
    mounted = Fault("mounting", (), True, "-", (Repair("robot", gravity=(0, 0, 9.8)),))

    def check_logs(robot, recordings):
        return LogCheck((mounted, wrong) if len(recordings) == 1 else ())

    monkeypatch.setattr(steps, "check_logs", check_logs)
    assert not steps.refuse_faulty_logs(hidden_logs, False)[1].certain


def test_a_log_with_nan_is_to_be_cut_and_not_to_be_recorded_again(place, capsys):
    lines = Path("A.csv").read_text().splitlines()
    for i in range(100, 100 + len(lines) // 5):  # some are masked, so many are not
        lines[i] = ",".join([*lines[i].split(",")[:-1], "nan"])
    Path("A.csv").write_text("\n".join(lines))
    assert run("diagnose A.csv B.csv --robot arm.urdf") == 2
    err = capsys.readouterr().err
    assert "Cut the log there with a window" in err
    assert "Record the log again" not in err
    assert "\nTo continue anyway: --trust-log" in err
