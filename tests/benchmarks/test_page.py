"""The page of figures and the README's table are what the results files say."""

import re

import pytest

from benchmarks import page


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


def test_the_readme_has_its_length_and_about_eight_rows_of_figures():
    assert 60 <= len(page.README.read_text(encoding="utf-8").splitlines()) <= 100
    rows = re.findall(r"^\| (?!tested on |---)", page.readme_table(), re.M)
    assert 7 <= len(rows) <= 9


def _figure(unit="", **entry):
    return {"n": 200, "bar": None, "ok": None} | entry, unit


@pytest.mark.parametrize(
    ("figure", "words"),
    [
        (_figure("share", value=0.125), "25 of 200 (12.5 %)"),
        (_figure("share", value=25), "25 of 200 (12.5 %)"),
        (_figure("count", value=0), "0 of 200"),
        (_figure("N m", value=3.1e-14, n=1), "3.1e-14 N m"),
        (_figure("", value=13379700.0), "13 400 000 (n = 200)"),
        (_figure("s", value=None), "not measured"),
    ],
)
def test_a_value_is_shown_with_its_unit(figure, words):
    assert page.value_of(*figure) == words


@pytest.mark.parametrize(
    ("figure", "words"),
    [
        (_figure("share", value=0.9, bar=0.95, ok=False, at_least=True), "≥ 95 % **missed**"),
        (_figure("share", value=20, bar=16, ok=True, at_least=True), "≥ 16"),
        (_figure("share", value=0.5, bar=0.65, ok=True, low=0.35), "35 % to 65 %"),
        (_figure("s", value=1.1, bar=1.0, ok=None), "≤ 1 *undecided*"),
        (_figure("s", value=1.1), "–"),
    ],
)
def test_a_missed_bar_is_named(figure, words):
    assert page.bar_of(*figure) == words
