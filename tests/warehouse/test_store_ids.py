"""Ids: hashes of content, safe in any path."""

from dataclasses import dataclass

import numpy as np
import pytest

from residual.errors import InputError
from warehouse import ids


@dataclass(frozen=True)
class Half:
    seed: int
    kind: str


def test_the_canonical_form_does_not_depend_on_order_or_container():
    as_record = ids.canonical({"a": Half(1, "é"), "b": np.array([1.0, 2.5])})
    as_lists = ids.canonical({"b": [1.0, 2.5], "a": {"kind": "é", "seed": 1}})
    assert as_record == as_lists == '{"a":{"kind":"é","seed":1},"b":[1.0,2.5]}'.encode()


@pytest.mark.parametrize(
    ("value", "words"),
    [
        ({"a": float("nan")}, "NaN or infinity"),
        ({"a": [np.inf]}, "NaN or infinity"),
        ({1: 2}, "expected texts"),
        ({"a": {1, 2}}, "holds a set"),
        ({"a": object()}, "holds a object"),
    ],
)
def test_what_json_cannot_hold_is_refused(value, words):
    with pytest.raises(InputError, match=words):
        ids.canonical(value)


def test_a_run_id_has_twenty_hex_digits_and_changes_with_every_part():
    parts = ({"seed": 1}, "ab" * 32, "cd" * 32)
    others = [({"seed": 2}, *parts[1:]), (parts[0], None, parts[2]), (*parts[:2], "x")]
    hashes = {ids.run_id(*p) for p in (parts, *others)}
    assert len(hashes) == 4
    assert all(ids.check_id(id) == id and len(id) == 20 for id in hashes)
    # Written down: an id that changes with a release would orphan every store.
    assert ids.run_id(*parts) == "99998db9eaa09fd955ac"


def test_the_data_hash_is_of_values_names_and_shapes():
    q = np.arange(6.0).reshape(3, 2)
    same = {"q": np.asfortranarray(q), "t": np.arange(3)}
    assert ids.data_hash({"t": np.arange(3.0), "q": q}) == ids.data_hash(same)
    for other in ({"x": q}, {"q": q.reshape(2, 3)}, {"q": np.nextafter(q, 9)}):
        assert ids.data_hash(other) != ids.data_hash({"q": q})


NO_ID = ["", "..", "../ab", "/etc/passwd", "ab/cd", "AB", "xyz", "0" * 21, "a\n", "*"]


@pytest.mark.parametrize("text", [*NO_ID, "a\0"])
def test_an_id_is_hex_digits_and_nothing_else(text):
    with pytest.raises(InputError, match="is not an id: expected up to 20 hex digits"):
        ids.check_id(text)
