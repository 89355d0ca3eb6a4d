"""What a server starts when for a project: of each robot and inbox its own."""

import ast
from pathlib import Path

import pytest

from flows.project import (
    build_deployments,
    find_inbox_deployment,
    read_current_project,
    read_project,
)
from flows.project import list_nightly_deployments as nightly_deployments
from flows.service.up import hash_deployments
from flows.settings import ROOT, resolve_store_folder

TEXT = """schema = 1
[[robot]]
name = "cell"
urdf = "irb140"
serial = "1"
nightly = "30 3 * * *"
timezone = "Europe/Zurich"
[[robot]]
name = "trial"
urdf = "irb140"
simulated = true
nightly = ""
auto = true
[[inbox]]
robot = "cell"
folder = "in"
"""


@pytest.fixture
def project(own_folder):
    (own_folder / "modelgap.toml").write_text(TEXT)
    return read_project(own_folder)


def by_name(project):
    return {d["name"]: d for d in build_deployments(project)["deployments"]}


def test_a_real_robot_has_its_night_and_starts_when_logs_were_stored(project):
    deployed = by_name(project)
    cell = deployed["cell"]
    assert cell["entrypoint"].endswith(".diagnose_new")
    assert cell["parameters"] == {"project": str(project.folder), "robot": "cell"}
    assert cell["schedules"] == [
        {"cron": "30 3 * * *", "timezone": "Europe/Zurich", "slug": "nightly"}
    ]
    (trigger,) = cell["triggers"]
    assert trigger["match"] == {"prefect.resource.id": "modelgap.inbox.cell"}
    for name in ("monitor", "alarm"):
        assert deployed[name]["parameters"] == {"project": str(project.folder)}
    assert set(deployed["alarm"]["triggers"][0]["parameters"]) == {"runs", "good"}
    assert deployed["inbox"]["schedules"][0]["cron"] == "*/5 * * * *"
    assert find_inbox_deployment(project) == "inbox/inbox"
    assert nightly_deployments(project) == ("diagnose-new/cell", "nightly/trial")


def test_a_simulated_robot_runs_its_campaign(project):
    trial = by_name(project)["trial"]
    assert trial["entrypoint"] == "flows.pipelines.flows.nightly"
    assert Path(trial["parameters"]["campaign_file"]).is_file()
    assert (trial["parameters"]["auto"], trial["schedules"]) == (True, [])


def test_the_night_of_the_built_in_arm_is_not_that_of_a_project(project):
    own, program = by_name(project), by_name(None)
    assert "nightly" in program
    assert set(program) - set(own) == {"nightly"}
    assert nightly_deployments(None) == ("nightly/nightly",)
    assert find_inbox_deployment(None) is None


def test_every_entrypoint_of_a_project_is_a_flow(project):
    for each in build_deployments(project)["deployments"]:
        module, _, name = each["entrypoint"].rpartition(".")
        body = ast.parse((ROOT / f"{module.replace('.', '/')}.py").read_text()).body
        defined = {n.name for n in body if isinstance(n, ast.FunctionDef)}
        targets = (t for n in body if isinstance(n, ast.Assign) for t in n.targets)
        defined |= {target.id for target in targets if isinstance(target, ast.Name)}
        assert name in defined, each["entrypoint"]


def test_up_in_its_folder_serves_it_and_takes_a_change_over(project):
    here = read_current_project(resolve_store_folder(None))
    assert here is not None
    assert here.folder == project.folder
    assert read_current_project(project.folder / "another") is None
    before = hash_deployments(here)
    assert before != hash_deployments(None)
    (project.folder / "modelgap.toml").write_text(TEXT.replace("30 3", "31 3"))
    changed = read_current_project(here.store)
    assert hash_deployments(changed) != before
