"""`mg.diagnose`, `mg.identify` and `mg.calibrate` say what the commands say, by key."""

import json
import pickle

import pytest

import modelgap as mg
from flows.cli import main
from flows.steps import identify as identification
from residual.diagnosis import diagnose as diagnosis
from tests.frozen.make import HIDDEN, lasting

FIT = [f"{HIDDEN / name}.csv@0:4" for name in ("fit_2", "fit_3", "held_out")]


# What both doors ask in the end.
METHODS = [(diagnosis, "diagnose"), (identification, "identify_and_validate")]


def once(function):
    """Return the function, which computes the answer to the same question once."""
    answers = {}

    def answer(*words, progress=None, **more):
        question = pickle.dumps((words, more))
        if question not in answers:
            answers[question] = function(*words, **more)
        return answers[question]

    return answer


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "fit", "proof"),
    [
        ("diagnose", FIT[:2], FIT[2:]),
        ("identify", FIT[:2], FIT[2:]),
        pytest.param("calibrate", FIT, [], marks=pytest.mark.long),
    ],
)
def test_the_door_says_what_the_command_says(verb, fit, proof, own_folder, monkeypatch):
    for module, name in METHODS:
        monkeypatch.setattr(module, name, once(getattr(module, name)))
    path = own_folder / "said.json"
    held_out = ["--holdout", *proof] if proof else []
    words = [verb, *fit, "--robot", "irb140", *held_out, "--json", str(path)]
    # A fault of so short logs is no matter here: both are to say the same of it.
    assert main([*words, "--trust-log"]) == 0
    robot = mg.load_robot("irb140")
    logs = mg.read_logs([*fit, *proof], robot)
    more = {"held_out": logs[len(fit) :]} if proof else {}
    result = getattr(mg, verb)(robot, logs[: len(fit)], trust_log=True, **more)
    document = lasting(json.loads(path.read_text(encoding="utf-8")))
    ours = lasting(json.loads(json.dumps(result.to_json())))
    assert ours.keys() == document.keys()
    assert [key for key in document if ours[key] != document[key]] == []
