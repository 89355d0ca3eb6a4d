"""The gate: what of a verdict speaks against its model."""

from dataclasses import replace

import pytest

from flows.steps.model_choice import _of_verdict
from residual.verdict.result import Edit
from tests.verdict_documents import typed

GOOD = Edit("payload", (6,), error=1.2, kept=9.0, least_squares=4.0, reference=1.0)


def doubts(*edits):
    return _of_verdict(replace(typed({}), edit=edits))


def test_an_effect_that_can_be_taken_out_again_is_no_doubt():
    assert doubts(GOOD) == doubts()


@pytest.mark.parametrize("error", [2.5, 10.0])
def test_one_that_leaves_the_healthy_logs_unexplained_is_refused(error):
    doubts_more = set(doubts(replace(GOOD, error=error))) - set(doubts())
    assert len(doubts_more) == 1
    assert "edit test fails" in doubts_more.pop()


def test_what_was_not_measured_is_no_doubt():
    assert doubts(replace(GOOD, reference=None)) == doubts()
