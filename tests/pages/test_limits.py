"""Every figure of the page of limits is the one that was recorded."""

import json
import re

import pytest

from tests.pages.page import ROOT

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
