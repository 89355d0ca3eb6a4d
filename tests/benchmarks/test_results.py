"""Figures are of the code that ships: rows, results, their hash, pages made of them."""

import re
from argparse import Namespace

import pytest

from benchmarks import bench, page
from benchmarks.harness import origin
from benchmarks.harness.cases import crash_figures, guarded, run_kept
from benchmarks.harness.figures import figure, finish, missing, undecided
from flows.workers import InlineExecutor
from tests.pages.page import ROOT

DOCS = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
# The one page of figures that is written by hand; test_limits compares it.
BY_HAND = ROOT / "docs" / "guide" / "limits.md"


@pytest.mark.parametrize(
    ("text", "same"),
    [
        ('"""Another word."""\nx = 1\n\n\ndef f(a):\n    return a + x  # why\n', True),
        ("x = 1\ndef f(a):\n    'doc'\n    return (a\n      + x)\n", True),
        ("x = 2\ndef f(a):\n    return a + x\n", False),
        ("x = 1\ndef f(a):\n    return a - x\n", False),
    ],
)
def test_the_hash_is_of_what_code_does(tmp_path, monkeypatch, text, same):
    monkeypatch.setattr(origin, "ROOT", tmp_path)
    hashes = []
    for words in ("x = 1\ndef f(a):\n    return a + x\n", text):
        (tmp_path / "room").mkdir(exist_ok=True)
        (tmp_path / "room" / "one.py").write_text(words, encoding="utf-8")
        hashes.append(origin.code_hash.__wrapped__("room"))
    assert (hashes[0] == hashes[1]) == same


def test_a_page_says_of_which_figures_the_code_has_changed_since():
    facts = {"dirty": False, "commit": "a" * 40, "date": "2026-01-01"}
    now = page._origin("measured", facts | {"code": origin.code_of("measured")})
    then = page._origin("measured", facts | {"code": "0" * 16})
    assert then == now + " **of older code**"


@pytest.mark.parametrize("name", page.results())
def test_a_results_file_is_of_a_whole_run_of_clean_code(name):
    content = page.results()[name]
    assert not content["quick"]
    if content.get("code"):
        assert content["whole"]
        assert not content["dirty"]


def test_figures_in_the_docs_stand_in_pages_that_are_made_of_results():
    generated = {page.PAGE, page.PUBLIC, BY_HAND}
    cited = r"results/\w+\.json"
    texts = {p: p.read_text(encoding="utf-8") for p in DOCS if p not in generated}
    assert [p.name for p, text in texts.items() if re.search(cited, text)] == []
    # Shares of cases, as benchmarks give them: "302 of 320".
    readme = texts[ROOT / "README.md"].replace(page.readme_table(), "")
    assert re.findall(r"\b\d+ of \d+\b", readme) == []


@pytest.mark.long
@pytest.mark.parametrize("name", bench.PLAN)
def test_no_figure_is_older_than_the_code(name):
    assert bench.is_finished(name), "make bench"


# The page of figures and the README's table are what the results files say.


def test_the_page_is_what_the_script_writes():
    assert page.PAGE.read_text(encoding="utf-8") == page.page()
    assert page.PUBLIC.read_text(encoding="utf-8") == page.public_page()


def test_the_table_of_the_readme_is_what_the_script_makes():
    text = page.README.read_text(encoding="utf-8")
    assert page.readme_table() in text


@pytest.mark.parametrize("name", page.results())
def test_every_figure_of_a_results_file_has_a_row(name):
    content = page.results()[name]
    rows = page.list_rows(name, content["figures"])
    assert {key for _, _, keys in rows for key in keys} >= set(content["figures"])


# Cases and bars of the diagnosis benchmark, and results that outlive a kill.


def test_results_are_kept_line_by_line_and_a_torn_one_is_done_again(tmp_path, capsys):
    path, numbers = tmp_path / "kept.jsonl", []

    def work(number):
        numbers.append(number)
        if number == 3:
            raise ValueError("no")
        return {"number": number}

    jobs = {"one": 1, "two": 2, "three": 3}
    first = run_kept(path, str, work, jobs, InlineExecutor())
    assert first["three"] == {"error": "ValueError: no"}
    path.write_text(path.read_text()[:-9])  # killed within the last line
    numbers.clear()
    again = run_kept(path, str, work, jobs, InlineExecutor())
    assert numbers == [2, 3]
    assert again["one"] == {"number": 1}
    run_kept(path, str, work, {"one": 1, "two": 2}, InlineExecutor())
    assert numbers == [2, 3]


# Options of benchmarks over drawn cases, and rows of cases that crash.


def test_a_crash_is_a_row_that_says_its_case():
    def broken():
        raise ValueError("no")

    row = guarded({"what": "offset"}, broken)
    assert row == {"what": "offset", "error": "ValueError: no"}
    crashes = crash_figures([row, {}, {}])["crashes"]
    assert (crashes["value"], crashes["n"], crashes["ok"]) == (1, 3, False)


def test_the_exit_code_is_one_for_a_missed_bar_only(capsys):
    args = Namespace(full_json=None)
    assert finish(args, {"a": figure(1.0, 2.0, 3), "b": missing(1.0, "no data")}) == 0
    assert finish(args, undecided({"a": figure(3.0, 1.0, 2)})) == 0
    assert finish(args, {"a": figure(3.0, 1.0, 2)}) == 1
    assert capsys.readouterr().out.strip().splitlines()[-1].startswith("{")
