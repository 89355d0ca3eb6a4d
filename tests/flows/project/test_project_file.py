"""modelgap.toml: every option is there, every fault is named; what a server starts."""

import ast
import re
from pathlib import Path

import pytest

from flows import project as tables
from flows.cli import main
from flows.project import (
    _TEMPLATE,
    build_deployments,
    create_project,
    find_inbox_deployment,
    read_current_project,
    read_project,
)
from flows.project import list_nightly_deployments as nightly_deployments
from flows.service.up import hash_deployments
from flows.settings import ROOT, resolve_store_folder
from residual.errors import InputError
from tests.residual.arms import urdf_text
from tests.residual.identified import AXES
from warehouse.toml_records import read_toml

SECOND = "[[robot]]\nname = 'b'\nurdf = 'arm.urdf'\n"
HEAD = "schema = 1\n[[robot]]\nname = 'a'\nurdf = 'arm.urdf'\n"


@pytest.fixture
def place(own_folder):
    (own_folder / "arm.urdf").write_text(urdf_text(AXES))
    return own_folder


def test_init_writes_a_project_that_is_usable_at_once(place, capsys):
    assert main(["init", "--robot", "arm.urdf"]) == 0
    project = read_project(place)
    (robot,) = project.table.robot
    assert (robot.name, robot.urdf, robot.simulated) == ("small_arm", "arm.urdf", False)
    assert [i.folder for i in project.table.inbox] == ["inbox"]
    assert (place / "inbox").is_dir()
    assert "modelgap up" in capsys.readouterr().out
    before = (place / "modelgap.toml").read_bytes()
    assert main(["init"]) == 2
    assert "and is not changed" in capsys.readouterr().err
    assert (place / "modelgap.toml").read_bytes() == before


def test_a_simulated_robot_has_a_campaign_and_no_inbox(place):
    project = create_project(place / "trial")
    (robot,) = project.table.robot
    assert (robot.urdf, robot.simulated) == ("irb140", True)
    assert project.table.inbox == ()
    assert project.campaign(robot).is_file()


def test_every_option_stands_in_the_file_with_its_default(tmp_path):
    text = re.sub(r"@([A-Z]+)@", "", _TEMPLATE.read_text())
    parts = re.split(r"^(?:# )?\[\[?(\w+)\]?\]", text, flags=re.M)
    sections = dict(zip(["", *parts[1::2]], parts[::2], strict=True))
    kinds = {"": tables.ProjectTable, "robot": tables.RobotTable}
    kinds |= {"inbox": tables.InboxTable, "notify": tables.NotifyTable}
    own = {"robot", "inbox", "notify"}
    for name, kind in kinds.items():
        defaults = dict(re.findall(r"^(?:# )?(\w+) = (.*?)(?:\s{2,}#.*)?$", sections[name], re.M))
        fields = kind.__pydantic_fields__
        assert set(defaults) == set(fields) - (own if name == "" else set())
        for key, value in defaults.items():
            if fields[key].is_required() or key in ("port", "simulated"):
                continue
            (tmp_path / "one.toml").write_text(f"key = {value}\n")
            got = read_toml(tmp_path / "one.toml")["key"]
            default = fields[key].default
            assert (tuple(got) if isinstance(got, list) else got) == default, key


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "modelgap.toml: the file needs the key 'schema'."),
        ("schema = 2\n", "modelgap.toml: schema is 2"),
        (HEAD + "serail = 'x'\n", ".*'serail'.*'serial'"),
        (HEAD + "tags = ['a', 'b c']\n", ".*expected a word or KEY=VALUE"),
        (HEAD + "nightly = '2 o'\n", ".*expected five fields of cron"),
        (HEAD + "timezone = 'Mars'\n", ".*such as 'Europe/Zurich'"),
        (HEAD + "most = 1\n", r"\[\[robot\]\] 1 most is 1"),
        (HEAD + HEAD.partition("\n")[2] + "\n", "two robots of the name 'a'"),
        (HEAD + "[[inbox]]\nrobot = 'b'\nfolder = 'i'\n", "one of the robots that"),
        (HEAD.replace("arm.urdf", "gone.urdf"), "robot 'a': No file or folder"),
        (HEAD + "serial = 'a b'\n", ".*serial"),
        (f"{HEAD}{SECOND}most = 0\n", r"\[\[robot\]\] 2 most is 0"),
    ],
)
def test_a_fault_is_named_with_what_was_expected(place, text, message):
    (place / "modelgap.toml").write_text(text)
    with pytest.raises(InputError, match=message):
        read_project(place)


def test_commands_in_a_project_use_its_store(place, monkeypatch):
    (place / "modelgap.toml").write_text("schema = 1\nstore = 'kept/here'\n")
    assert resolve_store_folder(None) == place / "kept/here"
    assert resolve_store_folder("other") == place / "other"
    monkeypatch.setenv("MODELGAP_STORE", str(place / "set"))
    assert resolve_store_folder(None) == place / "set"


# What a server starts when for a project: of each robot and inbox its own.


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
