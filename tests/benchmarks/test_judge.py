import pytest

from benchmarks.demo_parts.pipeline import judge
from benchmarks.harness.figures import figure, finish, missing, partial
from tests.verdict_documents import typed


def document(*effects, flagged=()):
    found = [
        {
            "name": name,
            "joints": joints,
            "order": i,
            "equivalent": [{"name": n, "joints": j} for n, j in equivalent],
            "evidence": {"by": "fit", "nats": 50.0, "held_out": "confirmed"},
        }
        for i, (name, joints, *equivalent) in enumerate(effects, start=1)
    ]
    return {
        "effects": found,
        "verdict": "effects" if found else "none",
        "unexplained": {"joints": list(flagged)},
        "warnings": [],
    }


def verdict(*effects, flagged=()):
    return typed(document(*effects, flagged=flagged))


TRUTH = ["offset", [2]]


@pytest.mark.parametrize(
    ("found", "score"),
    [
        ([("offset", [2])], "right"),
        ([("coulomb_asymmetry", [2], ("offset", [2]))], "right"),
        ([("coulomb_asymmetry", [2])], "wrong"),
        ([("offset", [3])], "wrong"),
        ([("spring", [1]), ("offset", [2])], "wrong"),
        ([], "nothing"),
    ],
)
def test_only_the_first_finding_and_its_class_count(found, score):
    assert judge(TRUTH, verdict(*found))["score"] == score


def test_further_names_are_counted_apart():
    got = judge(TRUTH, verdict(("offset", [2]), ("ripple", [4])))
    assert (got["score"], got["extra"]) == ("right", [["ripple", [4]]])


def test_order_decides_which_is_first():
    both = document(("offset", [2]), ("ripple", [4]))
    both["effects"].reverse()
    assert judge(TRUTH, typed(both))["first"] == TRUTH


def test_a_null_with_a_name_is_a_false_alarm():
    assert judge(None, verdict())["score"] == "right"
    assert judge(None, verdict(("ripple", [1])))["score"] == "wrong"


@pytest.mark.parametrize(
    ("found", "flagged", "score"),
    [([], [5], "right"), ([], [], "nothing"), ([("ripple", [5])], [5], "wrong")],
)
def test_an_effect_without_a_name_asks_for_a_flag_on_its_joint(found, flagged, score):
    answer = verdict(*found, flagged=flagged)
    assert judge(["x_vibration", [5]], answer)["score"] == score


def test_the_exit_code_is_one_for_a_missed_bar_only(capsys):
    assert finish({"a": figure(1.0, 2.0, 3), "b": missing(1.0, "no data")}) == 0
    small = partial(figure(0.0, 1.0, 2), "too few")
    assert small["ok"] is None
    assert finish({"a": small}) == 0
    assert finish({"a": partial(figure(3.0, 1.0, 2), "too few")}) == 1
    assert capsys.readouterr().out.strip().splitlines()[-1].startswith("{")
