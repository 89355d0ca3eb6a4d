"""A wheel, built and installed into a fresh environment, has all that it needs."""

import json
import os
import re
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest
import yaml

from tests.flows.prefect_server import free_port
from tests.pages.page import ROOT

PACKAGES = ("flows", "residual", "sim", "warehouse")


def _run(*words: str | Path, cwd: Path) -> str:
    # Where a checkout is on the path by hand, it would come before what was installed.
    clean = {key: text for key, text in os.environ.items() if key != "PYTHONPATH"}
    command = [str(word) for word in words]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True, env=clean)
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


@pytest.fixture(scope="module")
def clone(tmp_path_factory):
    """What is committed: a build leaves its traces there, and not in the checkout."""
    folder = tmp_path_factory.mktemp("wheel")
    _run("git", "clone", "--quiet", ROOT, folder / "clone", cwd=folder)
    return folder / "clone"


@pytest.fixture(scope="module")
def wheel(clone):
    build = ("wheel", "--no-deps", "--no-build-isolation", "--no-index", ".")
    _run(sys.executable, "-m", "pip", *build, "-w", clone.parent, cwd=clone)
    (path,) = clone.parent.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def program(wheel):
    """The command of a new environment; libraries are those of this one.

    A path file inside a path file is not read, so our own editable install is not seen.
    """
    place = wheel.parent / "env"
    venv.create(place, with_pip=False)
    (inside,) = place.glob("lib/python*/site-packages")
    libraries = "\n".join(path for path in sys.path if "site-packages" in path)
    (inside / "libraries.pth").write_text(f"{libraries}\n", encoding="utf-8")
    python = place / "bin" / "python"
    install = ("--python", python, "install", "--no-deps", "--no-index", wheel)
    _run(sys.executable, "-m", "pip", *install, cwd=wheel.parent)
    where = "import flows, modelgap; print(flows.__file__, modelgap.__file__)"
    places = _run(python, "-c", where, cwd=wheel.parent).split()
    assert all(Path(file).is_relative_to(place) for file in places)
    return place / "bin" / "modelgap"


@pytest.mark.long
def test_every_file_of_the_packages_is_in_the_wheel(clone, wheel):
    tracked = _run("git", "ls-files", *PACKAGES, "modelgap.py", cwd=clone).split()
    with zipfile.ZipFile(wheel) as archive:
        there = set(archive.namelist())
    assert set(tracked) - there == set()
    strange = {name.split("/")[0] for name in there} - {*PACKAGES, "modelgap.py"}
    assert all(name.endswith(".dist-info") for name in strange)


@pytest.mark.long
def test_it_says_its_commit_and_diagnoses(clone, program, tmp_path):
    head = _run("git", "rev-parse", "HEAD", cwd=clone).strip()
    version = _run(program, "--version", cwd=tmp_path).strip()
    assert re.fullmatch(rf"\S+ \(commit {head[:12]}\)", version)
    help_text = _run(program, "demo", "--help", cwd=tmp_path)
    assert "hidden effect of a simulated arm" in help_text
    own = ROOT / "examples" / "own_robot"
    logs = [own / f"{day}.csv" for day in ("monday", "tuesday", "thursday")]
    options = ("--robot", own / "arm", "--map", own / "COLUMNS.toml")
    outputs = ("--report", "out.html", "--json", "out.json")
    held = ("--holdout", logs.pop())
    _run(program, "diagnose", *logs, *held, *options, *outputs, cwd=tmp_path)
    verdict = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert verdict["effects"][0]["joints"] == [2]
    page = (tmp_path / "out.html").read_text(encoding="utf-8")
    assert page.startswith("<!doctype")
    built_in = ("trajectory", "cyclic", "--robot", "irb140", "--duration", "4")
    _run(program, *built_in, "--csv", "program.csv", cwd=tmp_path)
    assert (tmp_path / "program.csv").exists()


@pytest.mark.long
@pytest.mark.prefect
def test_a_service_comes_up_with_its_deployments_and_no_checkout(program, tmp_path):
    place = ("--store", tmp_path / "store")
    try:
        _run(program, "up", "--port", str(free_port()), *place, cwd=tmp_path)
        state = json.loads(_run(program, "status", "--json", *place, cwd=tmp_path))
    finally:
        _run(program, "down", "--wait", "0", *place, cwd=tmp_path)
    assert state["healthy"]
    served = {row["name"].split("/")[1] for row in state["deployments"]}
    file = yaml.safe_load((ROOT / "prefect.yaml").read_text(encoding="utf-8"))
    assert served == {row["name"] for row in file["deployments"]}
