"""The numbers that decide a name are few, and all in one record."""

import ast
import re
from pathlib import Path

import pytest

from residual.diagnosis import outcome, score, search, select
from residual.evidence import thresholds

MOST = 30
FREE = {0, 1, 2, 0.5}
# Grids (joined blocks, sizes, a finer shape), rounds of fits, and where a signal ends.
GRIDS = {
    score: {0.02, 0.03, 0.1, 0.3, 3, 4, 5},
    search: {0.001, 0.2, 3, 6, 7},
    select: {0.001, 3, 4},
    outcome: set(),
}


def test_at_most_thirty_numbers_decide():
    text = Path(thresholds.__file__).read_text(encoding="utf-8")
    decide = text.split("# What decides")[1].split("# How much is tried")[0]
    assert 20 < len(re.findall(r"^    [a-z_]+: (?:int|float) =", decide, re.M)) <= MOST


@pytest.mark.parametrize("module", GRIDS, ids=lambda m: m.__name__.split(".")[-1])
def test_the_engine_has_no_number_of_its_own(module):
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    numbers = {
        n.value
        for n in ast.walk(tree)
        if isinstance(n, ast.Constant) and type(n.value) in (int, float)
    }
    assert {x for x in numbers if x >= 1e-6} - FREE <= GRIDS[module]
