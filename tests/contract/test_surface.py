"""Nothing that others rely on goes or changes by accident."""

import json

from tests.contract.surface import RECORD, differences, surface

_TOLD = (
    "The program differs from what is promised to others. If that is on purpose, say "
    "so in CHANGELOG.md and record it: python -m tests.contract.surface"
)


def test_the_surface_is_what_was_recorded():
    was = json.loads(RECORD.read_text(encoding="utf-8"))
    assert list(differences(was, json.loads(json.dumps(surface())))) == [], _TOLD


def test_a_difference_says_where_and_what():
    was = {"a": {"b": ["x", "y"], "c": 1}, "gone": 2}
    now = {"a": {"b": ["y", "z"], "c": 3}}
    assert list(differences(was, now)) == [
        "/a/b: x is gone",
        "/a/b: z is new",
        "/a/c: was 1, is 3",
        "/gone: was 2, is null",
    ]
