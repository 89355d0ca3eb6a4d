"""The page of figures and the README's table are what the results files say."""

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
