"""modelgap map: from a log with a foreign header and an own URDF to a verdict."""

import json
import tomllib

import numpy as np
import pytest

from flows.cli import main
from residual.robot.robot import load_robot
from tests.residual.arms import SEVEN, short_case, urdf_text
from tests.warehouse.foreign_logs import FOLDER, FORMATS


@pytest.fixture
def arm(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my arm.urdf").write_text(urdf_text(SEVEN))
    (tmp_path / "a log.csv").write_bytes((FOLDER / "franka_log.csv").read_bytes())
    return tmp_path


def test_a_log_with_other_names_is_refused_with_all_of_them_and_command(arm, capsys):
    assert main(["diagnose", "a log.csv", "--robot", "my arm.urdf"]) == 2
    complaint = capsys.readouterr().err
    for column in ("state.q[6]", "cmd.tau_J_d[6]"):
        assert column in complaint
    line = "modelgap map 'a log.csv' --robot 'my arm.urdf' --out COLUMNS.toml"
    assert line in complaint


def test_it_prints_a_map_or_writes_it_and_applies_nothing(arm, capsys):
    before = {path.name: path.read_bytes() for path in arm.iterdir()}
    assert main(["map", "a log.csv", "--robot", "my arm.urdf"]) == 0
    printed = capsys.readouterr().out
    assert tomllib.loads(printed)["time"] == {"column": "time", "unit": "ms"}
    assert {path.name: path.read_bytes() for path in arm.iterdir()} == before
    words = ["map", "a log.csv", "--robot", "my arm.urdf", "--out"]
    assert main([*words, "C.toml"]) == 0
    assert (arm / "C.toml").read_text(encoding="utf-8") == printed
    assert main([*words, "C.toml"]) == 0
    (arm / "C.toml").write_text(f"{printed}# mine\n", encoding="utf-8")
    assert main([*words, "C.toml"]) == 2
    assert "exists with other content" in capsys.readouterr().err
    assert (arm / "C.toml").read_text(encoding="utf-8").endswith("# mine\n")
    assert main([*words, "a log.csv"]) == 2
    assert "would overwrite an input" in capsys.readouterr().err


def test_a_robot_toml_holds_the_map_and_is_the_same_robot(arm, capsys):
    folder = arm / "arm"
    folder.mkdir()
    (arm / "my arm.urdf").rename(folder / "arm.urdf")
    bare = load_robot(folder)
    main(["map", "a log.csv", "--robot", "arm"])
    lines = capsys.readouterr().out
    (folder / "robot.toml").write_text(f"[columns]\n{lines}", encoding="utf-8")
    assert load_robot(folder).content_hash == bare.content_hash
    assert main(["import", "a log.csv", "--robot", "arm", "--dry-run"]) == 2
    # It is read by the map: what is wrong now is that 24 ms are too short.
    assert "lasts 0.0" in capsys.readouterr().err
    (folder / "robot.toml").write_text("[columns]\ntime = {colum = 't'}\n")
    assert main(["import", "a log.csv", "--robot", "arm", "--dry-run"]) == 2
    assert "robot.toml, [columns]" in capsys.readouterr().err


# Logs as people have them: three commands from a stranger's log to the verdict.


NAMES = ("base", "shoulder", "elbow", "roll", "pitch", "flange")


def write_german(path, log):
    names = ["Zeit [s]", *(f"{n}_pos [deg]" for n in NAMES)]
    names += [f"{n}_effort [Nm]" for n in NAMES]
    rows = np.column_stack([log.t, np.rad2deg(log.q), log.tau])
    lines = [";".join(f"{x:.9g}".replace(".", ",") for x in row) for row in rows]
    path.write_text("\n".join([";".join(names), *lines, ""]), encoding="utf-8")


@pytest.mark.parametrize(
    "name", ["german", *(pytest.param(f, marks=pytest.mark.long) for f in FORMATS)]
)
def test_three_commands_lead_from_a_log_as_it_is_to_the_right_verdict(name, own_folder):
    form, tmp_path = FORMATS.get(name), own_folder
    dof = form.dof if form else len(NAMES)
    (tmp_path / "arm.urdf").write_text(urdf_text(SEVEN[:dof]))
    case = short_case(load_robot("arm.urdf"), "payload", seed=5, duration=5.0)
    logs = [f"log_{n}.csv" for n in range(len(case.fit) + len(case.held_out))]
    for name, log in zip(logs, (*case.fit, *case.held_out), strict=True):
        if form:
            form.write(tmp_path / name, log)
        else:
            write_german(tmp_path / name, log)
    arm = "--robot arm.urdf --map COLUMNS.toml --json out.json"
    assert main(f"map {logs[0]} --robot arm.urdf --out COLUMNS.toml".split()) == 0
    assert main(f"check {' '.join(logs)} {arm}".split()) == 0
    assert json.loads((tmp_path / "out.json").read_text())["verdict"] != "unusable"
    words = f"diagnose {' '.join(logs[:-1])} {arm} --holdout {logs[-1]}"
    assert main(words.split()) == 0
    verdict = json.loads((tmp_path / "out.json").read_text())
    assert [(e["name"], e["joints"]) for e in verdict["effects"]] == [("payload", [dof])]
    mass = verdict["effects"][0]["parameters"]["mass"]
    assert abs(mass["value"] - case.truth.parameters["mass"]) < 4 * mass["std"]
