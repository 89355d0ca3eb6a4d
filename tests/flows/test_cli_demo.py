"""The demonstration, from the words to the truth, with nothing faked."""

import json

import pytest

from flows.cli import main
from flows.cli.progress import progress_bar


@pytest.mark.slow
def test_demo_diagnoses_its_own_logs_and_then_tells_what_was_hidden(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert main(["demo", "--seed", "7"]) == 0
    shown = capsys.readouterr().out
    assert "fit: fit_1 fit_2 fit_3 | baseline: – | held out: held_out" in shown
    assert "truth: payload on joint" in shown.splitlines()[-2]
    assert "again: modelgap diagnose modelgap-demo/fit_1.csv" in shown.splitlines()[-1]
    verdict = json.loads((tmp_path / "modelgap-demo" / "verdict.json").read_text())
    assert verdict["effects"][0]["name"] == "payload"
    assert "<html" in (tmp_path / "modelgap-demo" / "report.html").read_text()


def test_there_is_no_bar_where_nobody_looks():
    with progress_bar() as tell:
        assert tell is None


def test_the_bar_leaves_standard_output_alone(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with progress_bar() as tell:
        tell("search [1 of 3]", 0.5)
        print("verdict")
    shown = capsys.readouterr()
    assert shown.out == "verdict\n"
    assert "search [1 of 3]" in shown.err
