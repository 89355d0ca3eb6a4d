"""The demonstration, from the words to the truth."""

import json
import re
from pathlib import Path

import pytest

from flows.cli import main
from flows.report.phrases import HiddenEffect, compare_with_truth
from flows.steps import demo as steps
from flows.steps import experiment
from flows.workers import InlineExecutor
from tests.verdict_documents import typed

# Short, and with families of motion that need no search: of eight experiments each
# would take longer than all the rest. How those go is the matter of benchmarks/demo.py.
FIT, HELD_OUT, DURATION = ("cyclic", "move_stop_move"), ("cyclic",), 6.0


@pytest.mark.slow
def test_demo_finds_what_its_arm_hides_and_then_tells_what_that_was(
    tmp_path, compiled_plant, monkeypatch, capsys
):
    """The whole of it with its physics, on fewer motions, in this one process."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setattr(experiment, "ProcessExecutor", lambda _: InlineExecutor())
    for name in ("FIT", "HELD_OUT", "DURATION"):
        monkeypatch.setattr(steps, name, globals()[name])
    assert main(["demo", "--effect", "payload", "--store", "store"]) == 0
    done = capsys.readouterr()
    # Nobody looks at a terminal: of slow work a line now and then, nothing else.
    assert all(re.match(r" *\d+% ", line) for line in done.err.splitlines())
    assert "The model lacks a payload at the flange" in done.out
    assert "The first name is the hidden effect." in done.out
    assert "prefect" not in done.out.lower()
    page = Path(done.out.splitlines()[-1].removeprefix("report: "))
    (truth,) = json.loads((page.parent / "truth.json").read_text())
    assert truth["name"] == "payload"
    verdict = json.loads((page.parent / "verdict.json").read_text())
    assert verdict["effects"][0]["name"] == "payload"
    assert not (tmp_path / "store" / "_prefect").exists()
    assert not (tmp_path / "home" / ".prefect").exists()


SPRING = HiddenEffect("spring", (2,), {"stiffness": 4.0, "rest": 0.1})


def finding(name: str, joints: list, **same) -> dict:
    parameters = {"stiffness": {"value": 4.12, "std": 0.21, "unit": "N m/rad"}}
    return {
        "name": name,
        "joints": joints,
        "order": 1,
        "equivalent": [],
        "parameters": parameters,
        **same,
    }


@pytest.mark.parametrize(
    ("hidden", "effects", "judged"),
    [
        ([SPRING], [finding("spring", [2])], "right"),
        ([SPRING], [finding("spring", [3])], "wrong"),
        ([SPRING], [], "missed"),
        ([], [], "clean"),
        ([], [finding("spring", [2])], "false alarm"),
        (
            [SPRING],
            [finding("balancer", [2], equivalent=[{"name": "spring", "joints": [2]}])],
            "class",
        ),
    ],
)
def test_truth_and_verdict_are_compared(hidden, effects, judged):
    assert compare_with_truth(hidden, typed({"effects": effects})) == judged
