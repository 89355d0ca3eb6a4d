"""Where PyBullet and Prefect are not to be had, as on Windows or a newer Python."""

import json
import os
import subprocess
import sys
import tomllib

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement

from sim.engine.plant_records import SyntheticEffect
from tests.checkout import ROOT
from tests.residual.arms import arm, short_case, urdf_text
from tests.synthetic.logs import write_csv

# Windows has no fcntl either.
REFUSED = ("prefect", "pybullet", "pybullet_data", "fcntl")
WITHOUT = f"""
import sys

class Refusing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {REFUSED}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)

sys.modules.pop("fcntl", None)
sys.meta_path.insert(0, Refusing())
from flows.cli import main

for line in sys.argv[1:]:
    print(f"exit {{main(line.split())}}", file=sys.stderr)
loaded = {{name.partition(".")[0] for name in sys.modules}} & set({REFUSED})
assert not loaded, loaded
"""
CHURN = SyntheticEffect("quadratic_viscous", (2,), {"coefficient": 1.5})


def run(lines, folder):
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT, *lines],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MODELGAP_STORE": ""},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


READS = ("check A.csv --robot arm.urdf", "map A.csv --robot arm.urdf", "--help")


@pytest.mark.slow
def test_logs_are_diagnosed_right_and_what_reads_logs_needs_none_of_them(tmp_path):
    case = short_case(arm(), CHURN, seed=51, duration=6.0)
    for name, log in zip("ABC", (*case.fit[:2], *case.held_out), strict=True):
        write_csv(tmp_path / f"{name}.csv", log)
    (tmp_path / "arm.urdf").write_text(urdf_text())
    command = "diagnose A.csv B.csv --holdout C.csv --robot arm.urdf"
    command += " --json out.json --report out.html --save-model model.json"
    lines = [command, "predict A.csv --model model.json", *READS]
    output = run(lines, tmp_path)
    assert output.count("exit 0") == len(lines), output
    verdict = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    effects = [(one["name"], tuple(one["joints"])) for one in verdict["effects"]]
    assert effects == [(CHURN.name, CHURN.joints)]
    assert (tmp_path / "out.html").stat().st_size > 10_000


SPEC = """
schema = 1
robot = "irb140"
seed = 5
[trajectory]
kind = "cyclic"
duration = 9.0
"""


def test_a_command_that_needs_one_says_what_is_missing_and_what_to_do(tmp_path):
    (tmp_path / "spec.toml").write_text(SPEC)
    lines = ["up", "experiment spec.toml", "demo --seed 3"]
    up, experiment, demo, _ = run(lines, tmp_path).split("exit 2")
    assert "modelgap: This needs locks" in up
    assert "Linux and macOS" in up
    assert "modelgap: This needs " in experiment
    assert "PyBullet" in experiment
    assert "diagnosed without" in experiment
    assert demo.count("PyBullet") == 1  # once, not of each experiment
    assert "unexpected failure" not in up + experiment + demo


PLACES = {
    ("Linux", "x86_64", "3.11"): {"pybullet", "prefect", "pin"},
    ("Linux", "x86_64", "3.13"): {"prefect", "pin"},
    ("Linux", "aarch64", "3.11"): {"prefect", "pin"},
    ("Darwin", "arm64", "3.12"): {"prefect", "pin"},
    ("Windows", "AMD64", "3.12"): set(),
}


@pytest.mark.parametrize("place", PLACES)
def test_the_markers_ask_for_what_there_is_in_a_place(place):
    system, machine, python = place
    here = {
        **default_environment(),
        "platform_system": system,
        "platform_machine": machine,
        "python_version": python,
    }
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    wanted = map(Requirement, project["project"]["dependencies"])
    needed = {w.name for w in wanted if w.marker is None or w.marker.evaluate(here)}
    assert needed & {"pybullet", "prefect", "pin"} == PLACES[place]
    assert {"numpy", "scipy", "pyarrow", "cyclopts"} <= needed
