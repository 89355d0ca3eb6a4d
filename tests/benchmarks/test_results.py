"""Figures are of the code that ships: results, their hash, pages made of them.

A change of the method makes every figure of it old. The pages say so at once (a test
of every change), and a release has none that is old (a long test).
"""

import re

import pytest

from benchmarks import bench, page
from benchmarks.harness import origin
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
