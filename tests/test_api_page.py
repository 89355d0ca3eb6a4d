"""docs/api.md and the notebook of the examples run, and print what they show."""

import doctest
import re
import shutil
from pathlib import Path

import pytest

import modelgap as mg
from warehouse.record_commit import commit_run

ROOT = Path(__file__).parents[1]
_FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def _sections() -> dict[str, str]:
    page = (ROOT / "docs" / "api.md").read_text(encoding="utf-8")
    _, first, *rest = re.split(r"^#+ (.*)$", page, flags=re.M)
    below = iter([first, *rest])
    return dict(zip(below, below, strict=True))


def _run(text: str, known: dict) -> None:
    cells = doctest.DocTestParser().get_doctest(text, known, "api.md", None, 0)
    told: list[str] = []
    done = doctest.DocTestRunner(optionflags=_FLAGS).run(cells, out=told.append)
    assert done.attempted
    assert told == []


@pytest.fixture
def folder(tmp_path, monkeypatch):
    shutil.copytree(ROOT / "examples" / "hidden", tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    (log,) = mg.read_logs("fit_1.csv@0:2", mg.load_robot("irb140"))
    commit_run(tmp_path / "store", log, {"spec": {"robot": "irb140"}})
    return tmp_path


@pytest.mark.long
def test_the_cells_of_the_page_print_what_it_shows(folder):
    page = _sections()
    page.pop("Calibrate")
    _run("\n".join(page.values()), {})
    assert (folder / "out.html").read_text(encoding="utf-8").startswith("<!doctype")


@pytest.mark.long
def test_the_cell_that_calibrates_prints_what_it_shows(folder):
    known = {"mg": mg, "robot": mg.load_robot("irb140")}
    _run(_sections()["Calibrate"], known)
