"""Cases and bars of the diagnosis benchmark, and results that outlive a kill."""

from benchmarks.diagnosis_parts import bars, cases
from benchmarks.harness.cases import run_kept
from benchmarks.hidden import sized
from flows.workers import InlineExecutor

ROW = {
    "outcome": "right",
    "data": "synthetic",
    "hides": "offset",
    "effect": "offset",
    "joints": [2],
    "second": None,
    "share": 0.05,
    "named": 1,
    "found": 1,
    "extra": 0,
    "joint_right": True,
    "unexplained": [],
    "error_after": 4.4,
    "error_oracle": 4.0,
    "deviations": [["offset", 0.5]],
    "names": [],
    "seconds": 1.0,
}


def _task(group, hides, share=None):
    return cases.Task(group, hides, "quick", motion=1, arm=2, share=share)


def test_more_than_an_arm_has_is_left_out_without_a_diagnosis(monkeypatch):
    monkeypatch.setattr(sized, "_TRIES", 2)
    row = cases.run(_task("singles", "elasticity", 100.0))
    assert row["left_out"]
    figures = bars.case_figures({"singles": [row, ROW]}, deciding=True)
    assert figures["singles_more_than_an_arm_has"]["value"] == 1
    assert figures["singles_of_5_right"]["n"] == 1


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
