"""Cases, sizes, peer and bars of the benchmark of what changed."""

from argparse import Namespace

import pytest

from benchmarks.changes_parts import answers, arms, bars, draw
from benchmarks.changes_parts.answers import Answer, Claim, compare
from benchmarks.hidden.score import Name
from benchmarks.synthetic.visible import Stage, share


def test_a_change_has_its_size_in_the_recorded_logs_and_is_drawn_again_alike():
    slot = draw.Slot(draw.CHANGE, 1, 2, 0.10)  # two logs on each side
    case, logs = answers.record(slot)
    assert draw.draw(slot) == case
    robot = arms.robot_of(case.arm)
    stages = [Stage.of(robot, *one) for one in arms.list_motions(robot, case.second)]
    assert share(robot, case.effect, stages) == pytest.approx(0.10, rel=0.02)
    assert logs.truth[0].effect == case.effect.name
    assert logs.second[0].t[0] > logs.first[-1].t[-1]
    assert len(logs.held_out) == 1


TRUTH = Name("offset", (2,)), {"torque": 4.0}
ROW = {
    "method": answers.PROGRAM,
    "group": draw.CHANGE,
    "arm": "seven",
    "dof": 7,
    "target": 0.1,
    "effect": "offset",
    "refused": "",
}
RIGHT = Answer((Claim(TRUTH[0], (), {"torque": (4.1, 0.1)}),), (), 3.0)
SILENT = Answer((), (), 3.0)


DECIDING = Namespace(deciding=True)


def _row(answer, **other):
    return {**ROW, **compare(TRUTH, answer), **other}


def test_silence_is_a_miss_and_a_crash_is_counted():
    rows = [_row(RIGHT), _row(SILENT), {"error": "ValueError: no"}]
    figures = bars.all_figures(rows, DECIDING)
    entry = figures["change_10_right_first"]
    assert (entry["value"], entry["n"], entry["ok"]) == (0.5, 2, False)
    assert figures["change_10_nothing_else"]["n"] == 1
    assert figures["crashes"]["ok"] is False
    assert figures["change_within_two_deviations"]["value"] == 1.0
    few = bars.all_figures(rows, Namespace(deciding=False))
    assert few["change_10_right_first"]["ok"] is None


OTHER = Name("coulomb_asymmetry", (2,))


@pytest.mark.parametrize(
    ("claims", "right", "extra"),
    [
        ((Claim(OTHER),), False, ["coulomb_asymmetry"]),
        ((Claim(OTHER, (TRUTH[0],)),), True, []),
        ((Claim(Name("offset", (3,))),), False, ["offset"]),
        ((Claim(OTHER), Claim(TRUTH[0])), False, ["coulomb_asymmetry"]),
    ],
)
def test_another_name_is_right_only_where_the_answer_states_it(claims, right, extra):
    row = compare(TRUTH, Answer(claims, (), 1.0))
    assert (row["right_first"], row["extra"]) == (right, extra)


def test_the_peer_is_compared_on_the_same_cases():
    mine = [_row(RIGHT if i < 6 else SILENT) for i in range(8)]
    its = [_row(RIGHT if i in (0, 7) else SILENT, method="peer") for i in range(8)]
    figures = bars.all_figures([*mine, *its], DECIDING)["change_10_over_peer"]
    assert (figures["value"], figures["ok"]) == (0.5, True)
    assert figures["p"] == pytest.approx(2 * 7 / 64, abs=1e-4)
