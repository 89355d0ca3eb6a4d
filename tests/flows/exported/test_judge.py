"""The judge of an exported study: known answers have known scores."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from flows.blind.export import score

JUDGE = Path(score.__file__)
CLASSES = {"coulomb": "joint", "viscous": "joint", "payload": "body", "spring": "other"}


def _effect(name, *joints):
    return {"effect": name, "joints": list(joints)}


TRUTH = {
    "classes": CLASSES,
    "cases": {
        "case_001": {
            "kind": "single",
            "effects": [_effect("coulomb", 3)],
            "held_out": ["held_out_1"],
            "after": {"after_1": 0, "after_2": 0},
        },
        "case_002": {
            "kind": "pair",
            "effects": [_effect("payload", 6), _effect("spring", 2)],
            "held_out": [],
            "after": {},
        },
        "case_003": {"kind": "none", "effects": [], "held_out": [], "after": {}},
        "case_004": {
            "kind": "unknown",
            "effects": [_effect("x_wall", 4)],
            "held_out": [],
            "after": {},
        },
    },
}
RIGHT = {
    "case_001": [_effect("coulomb", 3)],
    "case_002": [_effect("spring", 2), _effect("payload", 6)],
    "case_003": "nothing",
    "case_004": {"unknown": [4]},
}


def _scores(answers, tmp_path=Path("nowhere")):
    said = {"program": "a", "cases": answers}
    return score.summed(score.score_all(TRUTH, said, (tmp_path, tmp_path)))


def _all(answers, level, key):
    return _scores(answers)["kinds"]["all"]["levels"][level][key]


@pytest.mark.parametrize("level", score.LEVELS)
def test_who_says_what_is_hidden_has_everything(level):
    figures = {k: _all(RIGHT, level, k) for k in ("exact", "precision", "recall")}
    counts = {k: (f["hits"], f["n"]) for k, f in figures.items()}
    assert counts == {"exact": (4, 4), "precision": (3, 3), "recall": (3, 3)}


def test_who_always_says_nothing_is_right_about_nothing_alone():
    scores = _scores(dict.fromkeys(TRUTH["cases"], "nothing"))["kinds"]
    exact = {
        kind: own["levels"]["name"]["exact"]["hits"] for kind, own in scores.items()
    }
    assert exact == {"single": 0, "pair": 0, "none": 1, "unknown": 0, "all": 1}
    assert scores["all"]["levels"]["name"]["precision"]["value"] is None


@pytest.mark.parametrize(
    ("finding", "right"),
    [
        (_effect("coulomb", 3), ["name", "equivalent", "class"]),
        (
            _effect("viscous", 3) | {"or": [_effect("coulomb", 3)]},
            ["equivalent", "class"],
        ),
        (_effect("viscous", 3), ["class"]),
        (_effect("joint", 3), ["class"]),
        (_effect("coulomb", 2), []),
        (_effect("body", 3), []),
    ],
)
def test_a_finding_is_judged_at_its_own_level(finding, right):
    levels = _scores({"case_001": [finding]})["kinds"]["single"]["levels"]
    assert [k for k, own in levels.items() if own["exact"]["hits"]] == right


@pytest.mark.parametrize(
    ("flag", "exact"), [(True, 1), ([2], 1), ([2, 5], 1), ([5], 0), (False, 0)]
)
def test_who_has_no_name_for_a_spring_may_say_unknown(flag, exact):
    said = {"findings": [_effect("payload", 6)], "unknown": flag}
    levels = _scores({"case_002": said})["kinds"]["pair"]["levels"]
    assert levels["class"]["exact"]["hits"] == exact
    assert levels["class"]["precision"] == levels["name"]["precision"]
    assert not levels["name"]["exact"]["hits"]


def test_nothing_hidden_and_something_said_is_counted():
    none = _scores({"case_003": [_effect("spring", 1)]})["kinds"]["none"]
    assert none["named"]["hits"] == 1
    none = _scores({"case_003": "unknown"})["kinds"]["none"]
    assert (none["named"]["hits"], none["flagged"]["hits"]) == (0, 1)
    assert none["levels"]["name"]["exact"]["hits"] == 0


def test_what_has_no_name_must_not_be_named():
    own = _scores({"case_004": {"findings": [_effect("spring", 4)], "unknown": True}})
    assert own["kinds"]["unknown"]["levels"]["class"]["exact"]["hits"] == 0
    assert own["kinds"]["unknown"]["joint"]["hits"] == 1


@pytest.mark.parametrize(
    ("answers", "words"),
    [
        ({"case_009": "nothing"}, "case_009 is no case"),
        ({"case_001": "none"}, '"none", expected "nothing"'),
        ({"case_001": [_effect("stickiness", 1)]}, "no effect is called 'stickiness'"),
        ({"case_001": [_effect("coulomb", 0)]}, "joints are numbers from 1"),
    ],
)
def test_an_answer_that_says_something_else_is_refused(answers, words):
    with pytest.raises(score.AnswerError, match=words):
        _scores(answers)


def _csv(path, rows, head):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, rows, delimiter=",", header=head, comments="")


@pytest.fixture
def folder(tmp_path):
    """A study with torques: the oracle is off by 1, where joint 2 moves only."""
    sealed, n = tmp_path / "sealed", 500
    sealed.mkdir()
    shutil.copyfile(JUDGE, sealed / "score.py")
    (sealed / "truth.json").write_text(json.dumps(TRUTH))
    rows = np.zeros((n, 7))
    rows[:, 0] = 0.004 * np.arange(n)
    rows[:, 3:5], rows[:, 6] = 1.0, 1.0
    for log in ("held_out_1", "after_1", "after_2"):
        _csv(sealed / "case_001" / f"{log}.csv", rows, "t,tau1,tau2,o1,o2,m1,m2")
    own = tmp_path / "predictions" / "case_001"
    for log, off in (("held_out_1", 2.0), ("finding_2_after_1", 3.0)):
        told = np.column_stack([np.full(n, 99.0), np.full(n, off)])
        _csv(own / f"{log}.csv", told, "tau1,tau2")
    said = {"cases": RIGHT | {"case_001": [_effect("payload", 6), *RIGHT["case_001"]]}}
    (tmp_path / "answers.json").write_text(json.dumps({"program": "mine", **said}))
    return tmp_path


def _judge(folder):
    words = ["-I", "sealed/score.py", "answers.json", "--json", "s.json"]
    return subprocess.run(
        [sys.executable, *words],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_judge_runs_alone_with_numpy(folder):
    done = _judge(folder)
    assert done.returncode == 0, done.stderr
    assert "mine: 4 of 4 answered" in done.stdout
    figures = json.loads((folder / "s.json").read_text())["kinds"]["single"]
    assert figures["held_out_over_oracle"] == {"median": 2.0, "n": 1}
    # Of the finding that stands for the effect; the other log has no prediction.
    assert figures["edit_over_oracle"] == {"median": 3.0, "n": 1}
    wrong = folder / "predictions" / "case_001" / "held_out_1.csv"
    _csv(wrong, np.zeros((3, 2)), "tau1,tau2")
    done = _judge(folder)
    assert done.returncode == 2
    assert "(3, 2), expected (500, 2)" in done.stderr


def test_the_judge_imports_numpy_and_the_standard_library_only():
    lines = JUDGE.read_text(encoding="utf-8").splitlines()
    imported = {s.split()[1] for s in lines if s.startswith(("import ", "from "))}
    assert imported - set(sys.stdlib_module_names) == {"numpy"}


def test_the_adapter_of_the_page_writes_answers_that_are_judged(tmp_path, monkeypatch):
    page = Path(__file__).parents[3] / "docs" / "blind.md"
    (code,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.S)
    opened = {"cases": {name: {"fit": ["fit_1"]} for name in TRUTH["cases"]}}
    (tmp_path / "cases" / "open").mkdir(parents=True)
    (tmp_path / "cases" / "open" / "cases.json").write_text(json.dumps(opened))
    monkeypatch.chdir(tmp_path)
    exec(code, {})
    answers = json.loads((tmp_path / "answers.json").read_text())
    rows = score.score_all(TRUTH, answers, (tmp_path, tmp_path))
    right = [row["case"] for row in rows if row["levels"]["name"]["exact"]]
    assert right == ["case_003"]
