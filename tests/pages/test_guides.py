"""The guides: what they tell to type works, and prints what they show."""

import re
import shutil

import pytest

import modelgap as mg
from tests.pages.page import ROOT, run

EXAMPLES = ROOT / "examples"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    return tmp_path


@pytest.mark.long
def test_your_own_robot(folder, capsys):
    shutil.copytree(EXAMPLES / "own_robot", folder, dirs_exist_ok=True)
    (folder / "COLUMNS.toml").unlink()
    assert run("guide/own_robot.md", folder, capsys) == 6
    mended = (folder / "COLUMNS.toml").read_text(encoding="utf-8")
    kept = (EXAMPLES / "own_robot" / "COLUMNS.toml").read_text(encoding="utf-8")
    assert kept.endswith(mended)


@pytest.mark.long
def test_the_first_hour(folder, capsys, monkeypatch):
    monkeypatch.delenv("MODELGAP_STORE", raising=False)
    shutil.copytree(EXAMPLES / "hidden", folder, dirs_exist_ok=True)
    assert run("guide/first_hour.md", folder, capsys) == 8
    assert (folder / "friction.html").exists()


def _mistakes() -> list[tuple[str, str]]:
    text = (ROOT / "docs/guide/own_robot.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| [^|]+ \| `(\w+ = [^`]+)` \| (.+) \|$", text, re.M)
    return [(line, says) for line, says in rows]


@pytest.mark.long
def test_every_mistake_of_the_table_is_seen_as_it_says(tmp_path):
    own = EXAMPLES / "own_robot"
    robot = mg.load_robot(str(own / "arm"))
    right = (own / "COLUMNS.toml").read_text(encoding="utf-8")
    assert len(_mistakes()) >= 8
    for line, says in _mistakes():
        signal = line.split()[0]
        wrong = re.sub(rf"^{signal} .*$", line, right, flags=re.M)
        path = tmp_path / "COLUMNS.toml"
        path.write_text(wrong, encoding="utf-8")
        logs = [str(own / f"{day}.csv") for day in ("monday", "tuesday")]
        faults = mg.check(robot, logs, columns=str(path)).faults
        sure = [f"`{f.kind}`, {'certain' if f.certain else 'suspected'}" for f in faults]
        assert (sure[:1] or ["nothing"]) == [says], line
