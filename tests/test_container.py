"""The file of the container: what it copies is there, and it listens to nobody else."""

import json
import re
from configparser import ConfigParser
from pathlib import Path

import pytest
import yaml

from flows.cli import main
from flows.service.state import DATABASE, database_url
from flows.service.up import _CANCEL, _WAIT
from tests.checkout import ROOT
from warehouse.bucket import is_loopback_host

TEXT = (ROOT / "Containerfile").read_text(encoding="utf-8")
LINES = TEXT.replace("\\\n", " ").splitlines()


def _values(word: str) -> list[str]:
    return [line.partition(" ")[2] for line in LINES if line.startswith(f"{word} ")]


@pytest.mark.parametrize("copied", _values("COPY"))
def test_what_it_copies_is_there(copied):
    *sources, _ = copied.split()
    assert [name for name in sources if not (ROOT / name).exists()] == []


def test_all_packages_and_what_the_build_reads_are_copied():
    copied = {name for line in _values("COPY") for name in line.split()[:-1]}
    project = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    packages = re.search(r"include = \[(.*)\]", project)[1]
    needed = {name.strip('*"') for name in packages.split(", ")}
    assert needed | {"setup.py", "pyproject.toml", "prefect.yaml", "LICENSE"} <= copied


def test_it_runs_as_nobody_special_and_listens_on_loopback():
    (command,) = _values("CMD")
    words = json.loads(command)
    assert words[0] == "up"
    assert is_loopback_host(words[words.index("--host") + 1])
    assert "--trust-network" not in TEXT
    assert _values("USER") == ["modelgap"]
    assert not _values("EXPOSE")


def test_packages_come_pinned_with_their_hashes():
    (first, _) = (line for line in _values("RUN") if "pip install" in line)
    assert "--require-hashes -r requirements.lock" in first


def _block(page: str, language: str) -> str:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return re.search(rf"```{language}\n(.*?)```", text, re.DOTALL)[1]


def test_the_compose_file_builds_ours_and_shows_nothing_to_the_network():
    services = yaml.safe_load(_block("project.md", "yaml"))["services"]
    own, database = services["modelgap"], services["database"]
    assert (ROOT / own["build"]["dockerfile"]).is_file()
    assert database_url(own["environment"][DATABASE]).startswith("postgresql+asyncpg://")
    assert own["volumes"] == [f"./store:{_values('VOLUME')[0]}"]
    assert set(own["depends_on"]) == {"database"}
    assert all(is_loopback_host(port.partition(":")[0]) for port in database["ports"])


def test_the_unit_starts_a_command_that_stays_and_is_started_again():
    unit = ConfigParser()
    unit.optionxform = str
    unit.read_string(_block("project.md", "ini"))
    service = unit["Service"]
    program, *words = service["ExecStart"].split()
    assert Path(program).name == "modelgap"
    assert main([*words, "--help"]) == 0
    # It ends with 1 where server or worker have ended, and takes its time to stop.
    assert service["Restart"] == "on-failure"
    assert float(service["TimeoutStopSec"]) > _WAIT + _CANCEL
