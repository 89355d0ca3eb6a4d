"""modelgap identify: words in; tables, files and messages out."""

import json
from pathlib import Path

import pytest

from flows.cli import main
from residual.robot.robot import load_robot
from tests.residual.identified import workplace

KEYS = (
    "schema robot declared method prior logs held_out same_run condition noise rows "
    "independent_rows outliers parameters essential error acceleration_error "
    "least_mass_matrix consistent warnings"
)


def run(words):
    return main(words.split())


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A working directory with an arm and its logs A.csv, B.csv and C.csv."""
    monkeypatch.chdir(tmp_path)
    return workplace(tmp_path, "ABC", 8.0)


def test_parameters_and_errors_are_shown_and_written(place, capsys):
    words = "identify A.csv B.csv --robot arm.urdf --holdout C.csv --json o.json"
    assert run(f"{words} --export new") == 0
    shown = capsys.readouterr().out
    assert "fit: A B | baseline: – | held out: C" in shown
    assert "J1: inertia Izz of link 1" in shown
    assert "viscous coefficient of joint 2" in shown
    assert "wls on " in shown
    assert "least eigenvalue of M(q)" in shown
    made = json.loads(Path("o.json").read_text())
    assert " ".join(made) == KEYS
    errors = made["error"]["filtered"]
    assert errors["identified"]["overall"] < 0.3 * errors["nominal"]["overall"]
    by_name = {p["name"]: p for p in made["parameters"]}
    friction = by_name["coulomb level of joint 1"]
    assert abs(friction["value"] - 4.0) < 4 * friction["sd"] + 0.1
    assert (friction["unit"], friction["status"]) == ("N m", "fitted")
    assert made["consistent"] is None
    assert load_robot("new").name == "small_arm"
    assert "wrote new" in shown


def test_json_alone_on_standard_output(place, capsys):
    words = "identify A.csv --robot arm.urdf --method irls --essential --json -"
    assert run(words) == 0
    shown = capsys.readouterr()
    made = json.loads(shown.out)
    assert (made["method"], made["same_run"]) == ("irls", True)
    assert made["essential"]["f"] <= made["essential"]["f_limit"]
    assert "no --holdout given" in made["warnings"][0]
    assert "fit: A | baseline" in shown.err


def test_consistent_parameters_stand_beside_the_free_ones(place, capsys):
    words = "identify A.csv --robot arm.urdf --holdout C.csv --consistent --json o.json"
    assert run(f"{words} --prior 0.5") == 0
    made = json.loads(Path("o.json").read_text())
    assert min(made["consistent"]["masses"]) > 0
    assert min(made["consistent"]["least_eigenvalue"]) > 0
    assert made["least_mass_matrix"]["consistent"] > 0
    assert made["error"]["filtered"].keys() == {"nominal", "identified", "consistent"}
    assert "where the free fit reaches" in capsys.readouterr().out
