"""What a verdict is worth beside the truth, case by case."""

from collections import Counter
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

STRIBECK = Name("stribeck", (2,))


def said(words):
    """A verdict in words: names with joints, after | their rivals, after ? flags."""
    names, _, flags = words.partition("?")
    found = []
    for order, name in enumerate(filter(None, names.split(";")), 1):
        first, *alike = ((n.split()[0], [int(n.split()[1])]) for n in name.split("|"))
        found.append(entry(*first, order, alike=alike))
    return verdict(*found, unexplained=[int(j) for j in flags.split()])


# What is drawn, the truth, the verdict; outcome, how many found, how many besides, and
# whether the joint is right.
JUDGED = [
    ("single", "stribeck 2", "stribeck 2", "right", 1, 0, True),
    ("single", "stribeck 2", "coulomb 2|stribeck 2", "class", 1, 0, True),
    ("single", "stribeck 2", "stribeck 3", "wrong", 0, 1, False),
    ("single", "stribeck 2", "offset 2", "wrong", 0, 1, True),
    ("single", "stribeck 2", "", "nothing", 0, 0, None),
    ("single", "stribeck 2", "?2", "flagged", 0, 0, True),
    ("single", "stribeck 2", "?5", "flagged", 0, 0, False),
    # The truth is named, but only second.
    ("single", "stribeck 2", "offset 3;stribeck 2", "wrong", 1, 1, False),
    # Friction of one more contact is Coulomb friction too, that yields: this must be
    # said, and of another joint it is false.
    ("single", "presliding 2", "presliding 2;coulomb 2", "right", 1, 0, True),
    ("single", "presliding 2", "coulomb 2", "wrong", 0, 1, True),
    ("single", "presliding 2", "presliding 2;coulomb 3", "right", 1, 1, True),
    ("pair", "stribeck 2;offset 3", "offset 3;stribeck 2", "right", 2, 0, True),
    ("pair", "stribeck 2;offset 3", "offset 3;spring 4", "part", 1, 1, True),
    ("none", "", "", "right", 0, 0, None),
    ("none", "", "?1", "flagged", 0, 0, None),
    ("none", "", "offset 3", "wrong", 0, 1, None),
    ("unknown", "x_wall 2", "?2", "flagged", 0, 0, True),
    ("unknown", "x_wall 2", "spring 2?2", "wrong", 0, 1, True),
]


@pytest.mark.parametrize(
    ("drawn", "truth", "words", "outcome", "found", "extra", "joint"), JUDGED
)
def test_a_verdict_beside_the_truth(drawn, truth, words, outcome, found, extra, joint):
    pairs = map(str.split, filter(None, truth.split(";")))
    judged = score(drawn, [Name(n, (int(j),)) for n, j in pairs], said(words))
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
    told = [made[key] for key in ("outcome", "parameter", "multiple")]
    assert told == ["right", "level", 6.0]
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
    kinds = Counter(d.drawn for d in drafts(StudyRequest(20, 5)))
    assert kinds == {"single": 10, "pair": 3, "none": 4, "unknown": 3}
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
