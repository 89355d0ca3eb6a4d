"""What a verdict is worth beside the truth, case by case."""

from dataclasses import replace

import pytest

from flows.blind.draw import StudyRequest, drafts
from flows.blind.row import Hidden, case_row, draw_sized, estimate, measured
from flows.blind.score import Name, members, score, summary, wilson
from residual.diagnosis.result import Detectable
from residual.effects import registry
from residual.errors import InputError
from residual.robot.robot import load_robot
from sim.engine.records import PlantEffect, stream
from tests.flows.blind_rows import entry, row, verdict

STRIBECK, OFFSET = Name("stribeck", (2,)), Name("offset", (3,))
YIELDING = Name("presliding", (2,))


@pytest.mark.parametrize(
    ("drawn", "truths", "said", "outcome", "found", "extra", "joint"),
    [
        ("single", [STRIBECK], verdict(entry("stribeck", [2])), "right", 1, 0, True),
        (
            "single",
            [STRIBECK],
            verdict(entry("coulomb", [2], alike=[("stribeck", [2])])),
            "class",
            1,
            0,
            True,
        ),
        ("single", [STRIBECK], verdict(entry("stribeck", [3])), "wrong", 0, 1, False),
        ("single", [STRIBECK], verdict(entry("offset", [2])), "wrong", 0, 1, True),
        ("single", [STRIBECK], verdict(), "nothing", 0, 0, None),
        ("single", [STRIBECK], verdict(unexplained=[2]), "flagged", 0, 0, True),
        ("single", [STRIBECK], verdict(unexplained=[5]), "flagged", 0, 0, False),
        (
            # The truth is named, but only second.
            "single",
            [STRIBECK],
            verdict(entry("offset", [3]), entry("stribeck", [2], 2)),
            "wrong",
            1,
            1,
            False,
        ),
        (
            # Friction of one more contact is Coulomb friction too, that yields.
            "single",
            [YIELDING],
            verdict(entry("presliding", [2]), entry("coulomb", [2], 2)),
            "right",
            1,
            0,
            True,
        ),
        (
            # It must be said that it yields, and of another joint it is false.
            "single",
            [YIELDING],
            verdict(entry("coulomb", [2])),
            "wrong",
            0,
            1,
            True,
        ),
        (
            "single",
            [YIELDING],
            verdict(entry("presliding", [2]), entry("coulomb", [3], 2)),
            "right",
            1,
            1,
            True,
        ),
        (
            "pair",
            [STRIBECK, OFFSET],
            verdict(entry("offset", [3]), entry("stribeck", [2], 2)),
            "right",
            2,
            0,
            True,
        ),
        (
            "pair",
            [STRIBECK, OFFSET],
            verdict(entry("offset", [3]), entry("spring", [4], 2)),
            "part",
            1,
            1,
            True,
        ),
        ("none", [], verdict(), "right", 0, 0, None),
        ("none", [], verdict(unexplained=[1]), "flagged", 0, 0, None),
        ("none", [], verdict(entry("offset", [3])), "wrong", 0, 1, None),
        (
            "unknown",
            [Name("x_wall", (2,))],
            verdict(unexplained=[2]),
            "flagged",
            0,
            0,
            True,
        ),
        (
            "unknown",
            [Name("x_wall", (2,))],
            verdict(entry("spring", [2]), unexplained=[2]),
            "wrong",
            0,
            1,
            True,
        ),
    ],
)
def test_a_verdict_beside_the_truth(drawn, truths, said, outcome, found, extra, joint):
    judged = score(drawn, truths, said)
    assert (judged.outcome, judged.found, judged.extra) == (outcome, found, extra)
    assert judged.joint_right is joint


def test_a_finding_on_two_joints_is_two_names_and_a_pair_of_gears_is_one():
    levels = {"level": {"value": [1.0, 2.0], "std": [0.1, 0.2], "unit": "N m"}}
    merged = entry("stribeck", [5, 2], parameters=levels)
    gears = entry("coupled_friction", [6, 5], 2)
    names = [str(s.name) for s in members(verdict(merged, gears))]
    assert names == ["stribeck 5", "stribeck 2", "coupled_friction 5,6"]
    judged = score("single", [STRIBECK], verdict(merged))
    assert (judged.outcome, judged.extra) == ("right", 1)
    found = estimate(judged, [{"level": 2.1}])
    assert (found["value"], found["std"]) == (2.0, 0.2)


def test_a_row_has_size_parameter_and_the_share_of_the_gap():
    effect = PlantEffect("stribeck", (2,), (("level", 1.2), ("velocity", 0.05)))
    hidden = [Hidden(effect, (2,), 1.2, "N m", 6.0)]
    truth = [dict(effect.parameters)]
    made = case_row("single", hidden, truth, verdict(entry("stribeck", [2])), 4.0)
    assert (made["outcome"], made["parameter"], made["multiple"]) == (
        "right",
        "level",
        6.0,
    )
    assert made["z"] == pytest.approx(-2.0)
    assert made["gap_closed"] == pytest.approx(0.9)
    flat = case_row("single", hidden, truth, verdict(), 7.99)
    assert flat["gap_closed"] is None  # there is no gap worth the name
    assert flat["z"] is None


def test_figures_of_a_study():
    rows = [
        row("single", "right", multiple=5.0, z=0.5, value=1.1, truth=1.0),
        row("single", "nothing", multiple=1.0),
        row("single", "wrong", multiple=3.0, named_first="offset"),
        row("none", "right"),
        row("none", "wrong", named_first="offset"),
        row("unknown", "flagged", effect="x_wall"),
        row("unknown", "flagged", effect="x_wall", unexplained=[4]),
        row("pair", "right", found=2, multiple=3.0, second_multiple=None),
        row("pair", "part", found=1, multiple=3.0, second_multiple=0.5),
    ]
    told = summary(rows)
    assert told["singles_clear_right"]["hits"] == 1
    assert told["singles_clear_right"]["n"] == 2
    assert told["named_right"] | {"interval": 0} == {
        "value": pytest.approx(0.6),
        "hits": 3,
        "n": 5,
        "interval": 0,
    }
    assert (told["false_alarms"]["hits"], told["false_alarms"]["n"]) == (1, 2)
    assert told["unknown_flagged"]["value"] == 1.0
    assert told["unknown_joint"]["value"] == 0.5
    assert told["pairs_clear_both"]["n"] == 1
    assert told["confusion"]["stribeck"] == {"stribeck": 1, "none": 1, "offset": 1}
    assert [(p["hits"], p["n"]) for p in told["detection"]] == [(0, 1), (0, 1), (1, 1)]
    assert told["errors"]["over_oracle"] == pytest.approx(1.1)
    assert told["parameter_error"]["median"] == pytest.approx(0.1)


def test_wilson_is_wide_for_few_and_never_beyond_one():
    assert wilson(0, 0) == [0.0, 1.0]
    assert wilson(200, 200) == [0.9812, 1.0]
    low, high = wilson(95, 100)
    assert 0.88 < low < 0.95 < high < 0.98


def test_the_same_seed_draws_the_same_and_a_longer_study_begins_with_a_shorter():
    assert drafts(StudyRequest(40, 5)) == drafts(StudyRequest(40, 5))
    assert drafts(StudyRequest(60, 5))[:40] == drafts(StudyRequest(40, 5))
    assert drafts(StudyRequest(40, 5)) != drafts(StudyRequest(40, 6))
    kinds = [d.drawn for d in drafts(StudyRequest(20, 5))]
    assert [kinds.count(k) for k in ("single", "pair", "none", "unknown")] == [
        10,
        3,
        4,
        3,
    ]
    for asked in ((0, 1), (3, -1)):
        with pytest.raises(InputError):
            StudyRequest(*asked)


def test_every_effect_that_is_looked_for_is_drawn_and_no_fault_of_a_sensor():
    wishes = [w.effect for d in drafts(StudyRequest(120, 5)) for w in d.wishes]
    assert set(registry()) <= set(wishes)
    assert not [w for w in wishes if w.startswith("x_fault")]


def test_a_size_is_so_many_times_detectable_but_never_more_than_an_arm_has():
    robot = load_robot("irb140")
    minimum = [Detectable("position_friction", (j,), 0.1, "N m") for j in range(1, 7)]
    wish = ("position_friction", 3.0)
    one = draw_sized(robot, stream(4, "t"), *wish, minimum)
    assert measured(one, minimum, robot, None).multiple == pytest.approx(3.0)
    huge = [replace(m, value=1e3) for m in minimum]
    capped = measured(draw_sized(robot, stream(4, "t"), *wish, huge), huge, robot, None)
    assert capped.multiple < 0.1
    unknown = draw_sized(robot, stream(4, "t"), "saturation", 3.0, minimum)
    assert measured(unknown, minimum, robot, None).multiple is None
