"""Ids: hashes of content, safe in any path."""

from dataclasses import dataclass

import numpy as np
import pytest

from residual.errors import InputError
from warehouse import record_ids


@dataclass(frozen=True)
class Half:
    seed: int
    kind: str


def test_the_canonical_form_does_not_depend_on_order_or_container():
    as_record = record_ids.encode_canonical_json({"a": Half(1, "é"), "b": np.array([1.0, 2.5])})
    as_lists = record_ids.encode_canonical_json({"b": [1.0, 2.5], "a": {"kind": "é", "seed": 1}})
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
        record_ids.encode_canonical_json(value)


def test_a_run_id_has_twenty_hex_digits_and_changes_with_every_part():
    parts = ({"seed": 1}, "ab" * 32, "cd" * 32)
    others = [({"seed": 2}, *parts[1:]), (parts[0], None, parts[2]), (*parts[:2], "x")]
    hashes = {record_ids.compute_simulated_run_id(*p) for p in (parts, *others)}
    assert len(hashes) == 4
    assert all(record_ids.check_record_id(id) == id and len(id) == 20 for id in hashes)
    # Written down: an id that changes with a release would orphan every store.
    assert record_ids.compute_simulated_run_id(*parts) == "99998db9eaa09fd955ac"


def test_the_data_hash_is_of_values_names_and_shapes():
    q = np.arange(6.0).reshape(3, 2)
    same = {"q": np.asfortranarray(q), "t": np.arange(3)}
    assert record_ids.hash_arrays({"t": np.arange(3.0), "q": q}) == record_ids.hash_arrays(same)
    for other in ({"x": q}, {"q": q.reshape(2, 3)}, {"q": np.nextafter(q, 9)}):
        assert record_ids.hash_arrays(other) != record_ids.hash_arrays({"q": q})


NO_ID = ["", "..", "../ab", "/etc/passwd", "ab/cd", "AB", "xyz", "0" * 21, "a\n", "*"]


@pytest.mark.parametrize("text", [*NO_ID, "a\0"])
def test_an_id_is_hex_digits_and_nothing_else(text):
    with pytest.raises(InputError, match="is not an id: expected up to 20 hex digits"):
        record_ids.check_record_id(text)
