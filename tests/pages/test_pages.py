"""The site and its pages: limits, guides, notebooks."""

import json
import re
import shutil
import subprocess
import sys

import nbformat
import numpy as np
import pytest
import yaml
from nbclient import NotebookClient

import modelgap as mg
from residual.effects import load_effects
from scripts.docs_site import curve, pages
from scripts.docs_site.pages import how_often_found
from scripts.docs_site.schemas import schemas
from tests.pages.page import ROOT, run

# The site of the documents: built without a network, every link leads somewhere.


@pytest.mark.long
def test_it_is_built_strictly_and_asks_nothing_of_a_network(tmp_path):
    site = ["--site-dir", str(tmp_path)]
    words = ["-m", "mkdocs", "build", "--strict", "--quiet", *site]
    done = subprocess.run([sys.executable, *words], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    for name in load_effects():
        page = (tmp_path / "effects" / f"{name}.html").read_text(encoding="utf-8")
        assert "<svg" in page
        assert "hidden on a simulated arm" in page or "Not measured" in page
    # What the theme asks for where a page is opened from the disk.
    assert (tmp_path / "search" / "search_index.js").is_file()
    index = (tmp_path / "llms.txt").read_text(encoding="utf-8")
    linked = re.findall(r"\]\(([^)]+)\)", index)
    assert len(linked) > 50
    assert [page for page in linked if not (tmp_path / page).is_file()] == []
    for place, schema in schemas().items():
        text = (tmp_path / place).read_text(encoding="utf-8")
        assert json.loads(text) == schema
    home = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "img/report.png" in home
    assert "http.server -b 127.0.0.1 -d site" in home
    for path in tmp_path.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        fetched = re.findall(r"<(?:script|link|img|iframe)[^>]*(?:https?:)?//[^>]*>", text)
        assert fetched == [], path.name


def test_the_navigation_lists_pages_that_exist_and_each_once(monkeypatch):
    for writer in ("_effect", "commands_page", "python_page"):  # names are enough
        monkeypatch.setattr(pages, writer, lambda *_: "")
    listed = yaml.safe_load((ROOT / "mkdocs.yml").read_text(encoding="utf-8"))["nav"]
    places = re.findall(r"[\w/]+\.md", json.dumps(listed))
    assert len(places) == len(set(places))
    written = set(places) - set(pages.generated())
    assert [page for page in written if not (ROOT / "docs" / page).is_file()] == []


@pytest.mark.parametrize("name", sorted(load_effects()))
def test_an_effect_has_a_curve_of_its_own_columns(name):
    x, y, label = curve.points(load_effects()[name])
    assert np.isfinite(x).all()
    assert np.abs(y).max() == pytest.approx(1.0)
    assert "[" in label
    assert f"Torque of {name} over {label}" in curve.svg(load_effects()[name])


def test_an_effect_s_rate_is_that_of_the_recorded_figure():
    path = ROOT / "benchmarks" / "results" / "diagnosis.json"
    figures = json.loads(path.read_text(encoding="utf-8"))["figures"]
    for share in (10, 5, 2, 1):
        rates = figures[f"singles_of_{share}_right"]["per_effect"]
        assert rates
        for name, (right, total) in rates.items():
            told = f"alone, {share} % of the joint's torque | {right} of {total} |"
            assert told in how_often_found(name)


# Every figure of the page of limits is the one that was recorded.


PAGE = (ROOT / "docs" / "guide" / "limits.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| .* \| (\d+) of (\d+) \| `([\w.]+)` \|$", PAGE, re.M)


def test_every_row_of_its_tables_names_a_figure():
    rows = re.findall(r"^\| .* \|$", PAGE, re.M)
    tables = len(re.findall(r"^\| ---", PAGE, re.M))
    assert len(ROWS) == len(rows) - 2 * tables


@pytest.mark.parametrize(("part", "whole", "name"), ROWS)
def test_a_figure_is_the_recorded_one(part, whole, name):
    file, figure, *effect = name.split(".")
    path = ROOT / "benchmarks" / "results" / f"{file}.json"
    recorded = json.loads(path.read_text(encoding="utf-8"))["figures"][figure]
    if effect:
        assert recorded["per_effect"][effect[0]] == [int(part), int(whole)]
    else:
        assert recorded["n"] == int(whole)
        assert round(recorded["value"] * recorded["n"], 6) == int(part)


# The guides: what they tell to type works, and prints what they show.


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


# The notebooks of the examples run in the order of their cells.


BOOKS = sorted((ROOT / "examples").glob("*.ipynb"))


def _run(name: str, folder) -> str:
    """Run a notebook in a copy of the examples; return all that it shows."""
    shutil.copytree(ROOT / "examples", folder, dirs_exist_ok=True)
    book = nbformat.read(folder / f"{name}.ipynb", as_version=4)
    place = {"metadata": {"path": str(folder)}}
    NotebookClient(book, timeout=600, resources=place).execute()
    shown = [out for cell in book.cells for out in cell.get("outputs", ())]
    parts = [(out.get("text", ""), out.get("data", {})) for out in shown]
    return "\n".join(f"{text}{data.get('text/plain', '')}" for text, data in parts)


@pytest.mark.parametrize("path", BOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_its_answers(path):
    book = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") for cell in book.cells)
    nbformat.validate(book)


@pytest.mark.long
def test_the_notebook_of_run_history_answers_from_its_store(tmp_path):
    shown = _run("run_history", tmp_path)
    assert shown.count(": stored in") == 3
    assert "joint_6" in shown
    assert "findings" in shown


@pytest.mark.long
def test_the_notebook_of_an_own_robot_finds_the_hose_and_settles_what_is_open(tmp_path):
    shown = _run("own_robot", tmp_path)
    assert "gear_ratio () certain" in shown
    assert "LogCheck(clean)" in shown
    assert "cannot be told from: []" in shown
    assert "cannot be told from: ['spring']" in shown
    answers = re.findall(r"^Diagnosis\(bench-arm: (.+?), prob", shown, re.M)
    assert answers == ["spring on joint 2", "spring on joint 2"]


@pytest.mark.long
def test_the_notebook_of_the_first_hour_names_the_payload(tmp_path):
    assert "Diagnosis(irb140: payload" in _run("first_hour", tmp_path)
    assert (tmp_path / "out.html").exists()
