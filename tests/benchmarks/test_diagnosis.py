"""Bars of the diagnosis benchmark, and results that outlive a kill."""

from benchmarks.diagnosis_parts import bars
from benchmarks.harness.cases import run_kept
from flows.workers import InlineExecutor

ROW = {
    "outcome": "right",
    "data": "synthetic",
    "hides": "offset",
    "effect": "offset",
    "joints": [2],
    "second_effect": None,
    "multiple": 5.0,
    "second_multiple": 5.0,
    "named": 1,
    "found": 1,
    "extra": 0,
    "joint_right": True,
    "unexplained": [],
    "error_after": 4.4,
    "error_oracle": 4.0,
    "z": 0.5,
    "names": [],
    "seconds": 1.0,
}


def _rows(good, bad, **wrong):
    return [ROW] * good + [{**ROW, **wrong}] * bad


def test_singles_are_counted_where_they_are_clear():
    rows = _rows(95, 5, outcome="nothing", named=0, z=None)
    rows += _rows(0, 7, outcome="nothing", named=0, z=None, multiple=2.0)
    figures = bars.case_figures({"singles": rows}, deciding=True)
    one = figures["singles_right"]
    assert (one["value"], one["n"], one["ok"]) == (0.95, 100, True)
    assert one["data"] == {"synthetic": [95, 100]}
    assert figures["named_right"]["ok"] is None  # fewer than 300 names
    assert figures["error_over_oracle"]["ok"] is True
    assert figures["coverage_2_sigma"]["ok"] is False  # too wide is wrong as well


def test_results_are_kept_line_by_line_and_a_torn_one_is_done_again(tmp_path, capsys):
    path, numbers = tmp_path / "kept.jsonl", []

    def work(number):
        numbers.append(number)
        if number == 3:
            raise ValueError("no")
        return {"number": number}

    jobs = {"one": 1, "two": 2, "three": 3}
    first = run_kept(path, str, work, jobs, InlineExecutor())
    assert first["three"] == {"error": "ValueError: no"}
    path.write_text(path.read_text()[:-9])  # killed within the last line
    numbers.clear()
    again = run_kept(path, str, work, jobs, InlineExecutor())
    assert numbers == [2, 3]
    assert again["one"] == {"number": 1}
    run_kept(path, str, work, {"one": 1, "two": 2}, InlineExecutor())
    assert numbers == [2, 3]
