"""The file of the container: what it copies is there, and it listens to nobody else."""

import json
import re

import pytest

from flows.project.deployments import deployments
from flows.settings import is_loopback
from tests.checkout import ROOT

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
    assert is_loopback(words[words.index("--host") + 1])
    assert "--trust-network" not in TEXT
    assert _values("USER") == ["modelgap"]
    assert not _values("EXPOSE")


def test_packages_come_pinned_with_their_hashes():
    (first, _) = (line for line in _values("RUN") if "pip install" in line)
    assert "--require-hashes -r requirements.lock" in first


def test_a_wheel_has_copies_of_what_its_schedules_start(monkeypatch, tmp_path):
    """As setup.py puts them; deployments are made from those alone."""
    listed = re.findall(
        r'"((?:examples/)?[a-z]+\.(?:yaml|toml))"', (ROOT / "setup.py").read_text()
    )
    assert sorted(listed) == [
        "examples/nightly.toml",
        "examples/weekly.toml",
        "prefect.yaml",
    ]
    (tmp_path / "examples").mkdir()
    for name in listed:
        (tmp_path / name).write_bytes((ROOT / name).read_bytes())
    monkeypatch.setattr("flows.project.deployments.SHARED", tmp_path)
    for each in deployments(None)["deployments"]:
        file = each.get("parameters", {}).get("campaign_file")
        assert file is None or (tmp_path / file).is_file()
