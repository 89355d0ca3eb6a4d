"""The numbers that decide a name are few, and all in one record."""

import ast
import re
from dataclasses import fields
from pathlib import Path

import pytest

from residual.check import check, evidence, readings, slips
from residual.check import thresholds as of_check
from residual.diagnosis import epoch_outcome, epochs, outcome, score, search, select
from residual.evidence import epoch_design, thresholds

MOST, MOST_OF_EPOCHS, MOST_OF_CHECK = 30, 21, 40
FREE = {0, 1, 2, 0.5}
# Grids (joined blocks, sizes, a finer shape), rounds of fits, and where a signal ends.
GRIDS = {
    score: {0.02, 0.03, 0.1, 0.3, 3, 4, 5},
    search: {0.001, 0.2, 3, 6, 7},
    select: {0.001, 3, 4},
    outcome: set(),
    epoch_design: {0.001, 1e-9},
    epochs: {1e-5, 0.02, 0.1, 0.2, 1.25, 1.48, 4, 5, 10, 50, 100, 1000},
    epoch_outcome: {4},
    # Of the check: odds and units of its hypotheses, rounds, scales of the bodies.
    check: {0.1, 10, 200},
    # Of its columns: filters, rows, shapes and priors of what may be there.
    evidence: {1e-06, 0.001, 0.005, 0.02, 0.05, 0.1, 0.15, 0.2, 0.3}
    | {1.5, 3, 4, 5, 6, 7, 8, 9, 10, 20, 60, 64, 100, 360},
    readings: {0.002, 0.025, 0.05, 0.1, 0.2, 0.8, 0.9, 3, 12},
    slips: {0.001, 0.01, 0.0980665, 0.1, 0.15, 0.25, 0.3, 1.2, 1.5, 3, 7, 10, 16}
    | {32, 100, 180, 1000},
}


@pytest.mark.parametrize(
    ("heading", "most"), [("decides", MOST), ("two epochs share", MOST_OF_EPOCHS)]
)
def test_few_numbers_decide(heading, most):
    text = Path(thresholds.__file__).read_text(encoding="utf-8")
    part = re.split(r"^    # (?:What|How)", text.split(f"# What {heading}")[1], flags=re.M)
    fields = re.findall(r"^    [a-z_]+: (?:int|float) =", part[0], re.M)
    assert 15 < len(fields) <= most


def test_few_numbers_decide_a_fault():
    assert 30 < len(fields(of_check.CHECK)) <= MOST_OF_CHECK


@pytest.mark.parametrize("module", GRIDS, ids=lambda m: m.__name__.split(".")[-1])
def test_the_engine_has_no_number_of_its_own(module):
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    numbers = {
        n.value
        for n in ast.walk(tree)
        if isinstance(n, ast.Constant) and type(n.value) in (int, float)
    }
    assert {x for x in numbers if x >= 1e-6} - FREE <= GRIDS[module]
