"""Options of benchmarks over drawn cases, and rows of cases that crash."""

from argparse import Namespace

import pytest

from benchmarks.harness.cases import crash_figures, guarded
from benchmarks.harness.figures import figure, finish, missing, read_options, undecided


def test_a_quick_run_takes_seeds_of_its_own(monkeypatch):
    def read(*words):
        monkeypatch.setattr("sys.argv", ["benchmark", *words])
        return read_options("about", ("a", "b"), "8:9")

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
    crashes = crash_figures([row, {}, {}])["crashes"]
    assert (crashes["value"], crashes["n"], crashes["ok"]) == (1, 3, False)


def test_only_a_crash_is_decided_by_too_few_draws():
    entry = {"value": 2, "bar": 1, "ok": False, "n": 1}
    figures = undecided({"crashes": entry, "missed": entry, "due": {**entry, "why": "x"}})
    assert figures["crashes"] == entry
    assert figures["missed"]["ok"] is None
    assert "full run" in figures["missed"]["why"]
    assert figures["due"]["why"] == "x"


def test_the_exit_code_is_one_for_a_missed_bar_only(capsys):
    args = Namespace(full_json=None)
    assert finish(args, {"a": figure(1.0, 2.0, 3), "b": missing(1.0, "no data")}) == 0
    assert finish(args, undecided({"a": figure(3.0, 1.0, 2)})) == 0
    assert finish(args, {"a": figure(3.0, 1.0, 2)}) == 1
    assert capsys.readouterr().out.strip().splitlines()[-1].startswith("{")
