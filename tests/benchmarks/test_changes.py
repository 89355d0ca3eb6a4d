"""Cases, sizes, peer and bars of the benchmark of what changed."""

from argparse import Namespace

import pytest

from benchmarks.changes_parts import answers, bars, draw
from benchmarks.changes_parts.answers import Answer, Claim, compare
from benchmarks.hidden.score import Name

TRUTH = Name("offset", (2,)), {"torque": 4.0}
ROW = {
    "method": answers.PROGRAM,
    "group": draw.CHANGE,
    "arm": "seven",
    "dof": 7,
    "target": 0.1,
    "effect": "offset",
    "refused": "",
}
RIGHT = Answer((Claim(TRUTH[0], (), {"torque": (4.1, 0.1)}),), (), 3.0)
SILENT = Answer((), (), 3.0)


DECIDING = Namespace(deciding=True)


def _row(answer, **other):
    return {**ROW, **compare(TRUTH, answer), **other}


def test_silence_is_a_miss_and_a_crash_is_counted():
    rows = [_row(RIGHT), _row(SILENT), {"error": "ValueError: no"}]
    figures = bars.all_figures(rows, DECIDING)
    entry = figures["change_10_right_first"]
    assert (entry["value"], entry["n"], entry["ok"]) == (0.5, 2, False)
    assert figures["change_10_nothing_else"]["n"] == 1
    assert figures["crashes"]["ok"] is False
    assert figures["change_within_two_deviations"]["value"] == 1.0
    few = bars.all_figures(rows, Namespace(deciding=False))
    assert few["change_10_right_first"]["ok"] is None


OTHER = Name("coulomb_asymmetry", (2,))


@pytest.mark.parametrize(
    ("claims", "right", "extra"),
    [
        ((Claim(OTHER),), False, ["coulomb_asymmetry"]),
        ((Claim(OTHER, (TRUTH[0],)),), True, []),
        ((Claim(Name("offset", (3,))),), False, ["offset"]),
        ((Claim(OTHER), Claim(TRUTH[0])), False, ["coulomb_asymmetry"]),
    ],
)
def test_another_name_is_right_only_where_the_answer_states_it(claims, right, extra):
    row = compare(TRUTH, Answer(claims, (), 1.0))
    assert (row["right_first"], row["extra"]) == (right, extra)
