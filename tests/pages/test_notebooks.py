"""The notebooks of the examples run in the order of their cells."""

import re
import shutil

import nbformat
import pytest
from nbclient import NotebookClient

from tests.pages.page import ROOT

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
