"""A verdict in half a line."""

import pytest

from flows.report.words.verdict import brief
from tests.verdict_documents import typed

LEFT = {"nominal": 15.0, "identified": 9.6, "augmented": 7.1}
LOAD = {"name": "load_friction", "joints": [2], "probability": 0.99}
SPRING = {"name": "spring", "joints": [2]}
BALANCER = {"name": "balancer", "joints": [2]}
SIX = {"name": "offset", "joints": [1, 2, 3, 4, 5, 6], "probability": 0.9}


def verdict(**part):
    return typed({"error": {"overall_filtered": LEFT}, **part})


@pytest.mark.parametrize(
    ("words", "part"),
    [
        ("load friction on joint 2, 9.6 → 7.1 %", {"effects": [LOAD]}),
        (
            "spring on joint 2 (or balancer), 9.6 → 7.1 %",
            {"effects": [{**SPRING, "probability": 0.6, "equivalent": [BALANCER]}]},
        ),
        (
            "load friction on joint 2, offset on all six joints, 1 more, 9.6 → 7.1 %",
            {"effects": [LOAD, SIX, {**SPRING, "probability": 0.9}]},
        ),
        ("nothing missing, 9.6 %", {"verdict": "none"}),
        (
            "unknown on joint 3, 9.6 %",
            {"verdict": "unknown", "unexplained": {"joints": [3]}},
        ),
        ("nothing missing", {"verdict": "none", "error": {}}),
    ],
)
def test_it_names_what_is_missing_and_what_that_costs(words, part):
    assert brief(verdict(**part)) == words
