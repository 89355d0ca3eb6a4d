"""Options of benchmarks over drawn cases, and rows of cases that crash."""

from argparse import Namespace

from benchmarks.harness.cases import crash_figures, guarded
from benchmarks.harness.figures import figure, finish, missing, undecided


def test_a_crash_is_a_row_that_says_its_case():
    def broken():
        raise ValueError("no")

    row = guarded({"what": "offset"}, broken)
    assert row == {"what": "offset", "error": "ValueError: no"}
    crashes = crash_figures([row, {}, {}])["crashes"]
    assert (crashes["value"], crashes["n"], crashes["ok"]) == (1, 3, False)


def test_the_exit_code_is_one_for_a_missed_bar_only(capsys):
    args = Namespace(full_json=None)
    assert finish(args, {"a": figure(1.0, 2.0, 3), "b": missing(1.0, "no data")}) == 0
    assert finish(args, undecided({"a": figure(3.0, 1.0, 2)})) == 0
    assert finish(args, {"a": figure(3.0, 1.0, 2)}) == 1
    assert capsys.readouterr().out.strip().splitlines()[-1].startswith("{")
