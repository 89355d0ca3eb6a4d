"""A wheel, built and installed into a fresh environment, has all that it needs."""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
import yaml

from tests.flows.prefect_server import free_port
from tests.pages.page import ROOT
from tests.waiting import until

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


def _link(source: str, place: str) -> None:
    """A second name of a file; on another disk, a link to it."""
    try:
        os.link(source, place)
    except OSError:
        os.symlink(source, place)


@pytest.fixture(scope="module")
def program(wheel):
    """The command of a new environment, its libraries beside it as pip leaves them.

    Those are hard links to the ones of this environment, without what it has of ours.
    """
    place = wheel.parent / "env"
    venv.create(place, with_pip=False)
    (inside,) = place.glob("lib/python*/site-packages")
    shutil.copytree(
        sysconfig.get_path("purelib"),
        inside,
        ignore=shutil.ignore_patterns("*modelgap*"),
        copy_function=_link,
        dirs_exist_ok=True,
    )
    python = place / "bin" / "python"
    install = ("--python", python, "install", "--no-deps", "--no-index", wheel)
    _run(sys.executable, "-m", "pip", *install, cwd=wheel.parent)
    where = "import flows, modelgap as m, numpy as n; all = flows, m, n\n"
    where += "print(*(module.__file__ for module in all))"
    places = _run(python, "-c", where, cwd=wheel.parent).split()
    assert all(Path(file).is_relative_to(inside) for file in places)
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


CAMPAIGN = """
schema = 1
[grid]
seed = [1, 2]
[trajectory]
duration = 2.0
"""
ORIGIN = """
import sys
from flows.specs import load_spec
from flows.steps.experiment import compute_run_id
from warehouse.code_provenance import list_plant_files, read_code_provenance as known
print(len(list_plant_files()), known().code_hash, known().program_hash)
print(compute_run_id(load_spec(sys.argv[1])))
"""
EVERY = """
import sys
from pathlib import Path
from flows.service.api import Api
from flows.service.state import read_access_key
from flows.service.up import schedule_every
url, home, file, seconds = sys.argv[1:]
with Api(url, read_access_key(Path(home))).client() as client:
    schedule_every(client, "campaign/campaign", int(seconds), {"campaign_file": file})
"""


def _query(program, store, query):
    words = ("sql", query, "--format", "json", "--store", store)
    return json.loads(_run(program, *words, cwd=store.parent))


@pytest.mark.long
@pytest.mark.prefect
def test_it_simulates_and_serves_as_the_checkout_does(clone, program, tmp_path):
    python = program.with_name("python")
    one, both = tmp_path / "one.toml", tmp_path / "both.toml"
    both.write_text(CAMPAIGN)
    one.write_text(CAMPAIGN.replace("[grid]\nseed = [1, 2]", "seed = 1"))
    # The checkout is the clone: what is not committed is in no wheel.
    here = _run(sys.executable, "-c", ORIGIN, one, cwd=clone).split()
    assert _run(python, "-c", ORIGIN, one, cwd=tmp_path).split() == here
    assert int(here[0]) > 0

    first, second = tmp_path / "first", tmp_path / "second"
    for command, file in (("experiment", one), ("campaign", both)):
        _run(program, command, file, "--store", first, cwd=tmp_path)
    ids = "SELECT run_id FROM runs ORDER BY run_id"
    stored = _query(program, first, ids)
    assert len(stored) == 2
    assert {"run_id": here[-1]} in stored
    again = _run(program, "rerun", here[-1], "--store", first, cwd=tmp_path)
    assert "identical bit for bit" in again

    port = free_port()
    place = ("--store", second)
    schedule = (f"http://127.0.0.1:{port}/api", second / "_prefect")
    try:
        _run(program, "up", "--port", str(port), *place, cwd=tmp_path)
        state = json.loads(_run(program, "status", "--json", *place, cwd=tmp_path))
        _run(python, "-c", EVERY, *schedule, both, "5", cwd=tmp_path)
        until(lambda: _query(program, second, ids) == stored, "it has run", 1)
    finally:
        _run(program, "down", "--wait", "0", *place, cwd=tmp_path)
    assert state["healthy"]
    served = {row["name"].split("/")[1] for row in state["deployments"]}
    prefect = yaml.safe_load((ROOT / "prefect.yaml").read_text(encoding="utf-8"))
    assert served == {row["name"] for row in prefect["deployments"]}


@pytest.mark.long
def test_its_demo_finds_the_hidden_effect(program, tmp_path):
    store = tmp_path / "store"
    _run(program, "demo", "--store", store, cwd=tmp_path)
    (effect,) = _query(program, store, "SELECT DISTINCT name FROM effects")
    seals = [json.loads(p.read_text()) for p in store.glob("sealed/*/spec.json")]
    assert len(seals) == 8
    hidden = {each["name"] for seal in seals for each in seal["effects"]}
    assert hidden == {effect["name"]}
