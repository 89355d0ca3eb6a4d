"""modelgap next: from a verdict and its logs to a program."""

import json
from pathlib import Path

import numpy as np
import pytest

from flows.cli import main
from tests.flows.adopted_arm import unchecked
from tests.residual.planning.questions import logs
from tests.synthetic.logs import write_csv


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    folder = tmp_path_factory.mktemp("next")
    _, (fit, proof) = logs("spring", 2)
    for name, log in (("fit", fit), ("proof", proof)):
        write_csv(folder / f"{name}.csv", log)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        words = ["diagnose", "fit.csv", "--robot", "irb140", "--holdout", "proof.csv"]
        with unchecked():
            assert main([*words, "--json", "v.json", "--report", "v.html"]) == 0
    return folder


@pytest.fixture
def here(place, monkeypatch):
    monkeypatch.chdir(place)
    monkeypatch.setattr("flows.steps.next.WAVES", 2)
    with unchecked():
        yield place


GIVEN = ("v.json", "fit.csv", "--robot", "irb140", "--holdout", "proof.csv")


def test_a_verdict_says_by_itself_what_a_motion_could_settle(place):
    plan = json.loads((place / "v.json").read_text())["next_experiment"]
    assert {r["name"] for r in plan["rivals"]} == {"spring", "balancer"}
    assert [plan[k] for k in ("family", "parameters", "program")] == [None] * 3
    assert plan["seconds"] == 20.0
    assert (plan["expected_nats"] >= 6) == (plan["chance"] >= 0.5)
    assert plan["sure_after"] is None  # that is asked of a designed motion
    page = (place / "v.html").read_text()
    assert "Next experiment" in page
    assert "modelgap next designs it for this arm" in page


def test_a_program_is_found_written_and_explained(here, capsys):
    files = ("--out", "p.csv", "--json", "n.json")
    assert main(["next", *GIVEN, "--seconds", "8", *files]) == 0
    shown = capsys.readouterr().out
    assert "Next experiment: " in shown
    assert "The question is settled " in shown
    assert "settled after" in shown
    assert "wrote p.csv" in shown
    table = np.genfromtxt("p.csv", delimiter=",", names=True)
    assert len(table) == pytest.approx(250 * table["t"][-1] + 1)
    assert table["t"][-1] <= 8.0
    assert [n for n in table.dtype.names if n[0] == "t"] == ["t"]
    document = json.loads(Path("n.json").read_text())
    plan = document["next_experiment"]
    assert plan["program"] == "p.csv"
    assert document["effects"] == json.loads(Path("v.json").read_text())["effects"]
    assert plan["sure_after"] is not None
    assert f"{plan['sure_after']:.1f} s" in shown
    assert plan["seconds"] == table["t"][-1]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["no.json"], "no such verdict"),
        (["fit.csv"], "is no JSON"),
        (["v.json"], "has the verdict but not the logs"),
        (["v.json", "fit.csv"], "has the verdict but not the logs"),
        ([*GIVEN, "--seconds", "1"], "--seconds 1: expected 4 to 600"),
        ([*GIVEN, "--rate", "0"], "--rate 0: expected 1"),
        ([*GIVEN, "--out", "v.json"], "would overwrite an input"),
        (["abc", "--store", "nowhere"], "nowhere"),
        (["abc", "fit.csv", "--robot", "irb140"], "knows its own"),
    ],
)
def test_what_cannot_be_done_is_told_in_two_lines(here, capsys, words, message):
    assert main(["next", *words]) == 2
    complaint = capsys.readouterr().err
    assert message in complaint
    assert len(complaint.strip().splitlines()) <= 3
