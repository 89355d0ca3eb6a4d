"""Options of benchmarks over drawn cases, and rows of cases that crash."""

import pytest

from benchmarks.harness.cases import crash_figures, guarded, read_options, seed_range
from benchmarks.harness.figures import undecided


def test_both_ends_of_the_seeds_are_included():
    assert list(seed_range("5:7")) == [5, 6, 7]


def test_a_quick_run_takes_seeds_of_its_own(monkeypatch):
    def read(*words):
        monkeypatch.setattr("sys.argv", ["benchmark", *words])
        return read_options("about", "8:9", ("a", "b"))

    assert read().seeds == "8:9"
    assert read("--quick").seeds == "1:1"
    assert read("--groups", "b").groups == ["b"]
    assert [(read(*w).deciding, read(*w).whole) for w in ((), ("--groups", "b"))] == [
        (True, True),
        (True, False),
    ]
    assert not read("--seeds", "8:8").deciding
    assert not read("--quick").deciding
    with pytest.raises(SystemExit):
        read("--groups", "c")


def test_a_crash_is_a_row_that_says_its_case():
    def broken():
        raise ValueError("no")

    row = guarded({"what": "offset"}, broken)
    assert row == {"what": "offset", "error": "ValueError: no"}
    told = crash_figures({"one": [row], "other": [{}, {}]})["crashes"]
    assert (told["value"], told["n"], told["ok"]) == (1, 3, False)


def test_only_a_crash_is_decided_by_too_few_draws():
    entry = {"value": 2, "bar": 1, "ok": False, "n": 1}
    told = undecided({"crashes": entry, "missed": entry, "due": {**entry, "why": "x"}})
    assert told["crashes"] == entry
    assert told["missed"]["ok"] is None
    assert "full run" in told["missed"]["why"]
    assert told["due"]["why"] == "x"
