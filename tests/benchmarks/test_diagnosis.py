"""Cases and bars of the diagnosis benchmark, and results that outlive a kill."""

from benchmarks.harness.cases import run_kept
from flows.workers import InlineExecutor


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
