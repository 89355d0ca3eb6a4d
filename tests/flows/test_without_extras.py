"""Where PyBullet and Prefect are not to be had, as on Windows or a newer Python."""

import json
import os
import subprocess
import sys
import tomllib

import pytest
from packaging.markers import default_environment
from packaging.requirements import Requirement

from residual.errors import LACKING, not_installed
from tests.checkout import ROOT

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
code = main(sys.argv[1:])
loaded = {{name.partition(".")[0] for name in sys.modules}} & set({REFUSED})
assert not loaded, loaded
sys.exit(code)
"""
HIDDEN = ROOT / "examples" / "hidden"


def run(words, folder):
    """Run a command where none of these can be imported."""
    return subprocess.run(
        [sys.executable, "-c", WITHOUT, *words],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(ROOT), "MODELGAP_STORE": ""},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.slow
def test_logs_are_diagnosed_right_and_the_model_is_saved(tmp_path):
    logs = [str(HIDDEN / f"fit_{n}.csv") for n in (1, 2, 3)]
    words = ["diagnose", *logs, "--holdout", str(HIDDEN / "held_out.csv")]
    words += ["--robot", "irb140", "--json", "out.json", "--report", "out.html"]
    done = run([*words, "--save-model", "model.json"], tmp_path)
    assert done.returncode == 0, done.stderr
    verdict = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    truth = json.loads((HIDDEN / "truth.json").read_text(encoding="utf-8"))
    found = [(one["name"], one["joints"]) for one in verdict["effects"]]
    assert found == [(truth["name"], truth["joints"])]
    assert (tmp_path / "out.html").stat().st_size > 10_000
    done = run(["predict", logs[0], "--model", "model.json"], tmp_path)
    assert done.returncode == 0, done.stderr


READS = ["check A.csv --robot irb140", "map A.csv --robot irb140", "--help", "explain"]


@pytest.mark.parametrize("words", READS)
def test_what_reads_logs_needs_none_of_them(tmp_path, words):
    text = (HIDDEN / "fit_3.csv").read_text(encoding="utf-8").splitlines()
    (tmp_path / "A.csv").write_text("\n".join(text[:1200]))
    done = run(words.split(), tmp_path)
    assert done.returncode == 0, done.stderr


NEED = {
    "up": "Linux and macOS",
    "experiment spec.toml": "PyBullet",
}
SPEC = """
schema = 1
robot = "irb140"
seed = 5
[trajectory]
kind = "fourier"
duration = 5.0
"""


@pytest.mark.parametrize("words", NEED)
def test_a_command_that_needs_one_says_what_is_missing_and_what_to_do(tmp_path, words):
    (tmp_path / "spec.toml").write_text(SPEC)
    done = run(words.split(), tmp_path)
    assert done.returncode == 2, done.stderr + done.stdout
    assert f"modelgap: This needs {'locks' if words == 'up' else ''}" in done.stderr
    assert NEED[words] in done.stderr
    assert "diagnosed without" in done.stderr or words == "up"
    assert "unexpected failure" not in done.stderr


@pytest.mark.parametrize("module", LACKING)
def test_every_such_package_has_its_words(module):
    assert "it is not installed here" in str(not_installed(module))


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
    asked = {w.name for w in wanted if w.marker is None or w.marker.evaluate(here)}
    assert asked & {"pybullet", "prefect", "pin"} == PLACES[place]
    assert {"numpy", "scipy", "pyarrow", "cyclopts"} <= asked
