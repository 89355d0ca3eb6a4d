"""modelgap map: from a log with a foreign header and an own URDF to a verdict."""

import tomllib

import pytest

from flows.cli import main
from residual.robot.robot import load_robot
from tests.residual.arms import SEVEN, urdf_text
from tests.warehouse.foreign_logs import FOLDER


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
