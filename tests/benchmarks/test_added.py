"""Effects added to measured logs: what the oracle hears, and figures of the answers."""

import numpy as np
import pytest

from benchmarks.measured_parts import added, bars, greedy
from benchmarks.measured_parts.heard import fall_of_error, is_heard
from benchmarks.synthetic.logs import LogPlan, make
from benchmarks.synthetic.quasi_static import Plant
from tests.residual.arms import arm

PLAN = tuple(LogPlan(f"log {k}", "fit", "fourier", 10.0, 125.0) for k in range(2))


@pytest.mark.parametrize(
    ("torque", "heard"),
    [
        (lambda log: 3.0 * np.sin(12.0 * log.q), True),
        # Plain least squares has constants and friction of its own.
        (lambda log: 3.0 * np.ones_like(log.q), False),
        (lambda log: 1e-3 * np.sin(12.0 * log.q), False),
    ],
)
def test_the_logs_show_what_least_squares_lacks_and_is_large_enough(torque, heard):
    robot = arm()
    logs = make(Plant(robot, (), 3), PLAN, 3)
    plus = [torque(log) * [0.0, 1.0] for log in logs]
    assert is_heard(*fall_of_error(robot, logs, plus, 2)) is heard


def test_a_seed_has_every_effect_at_both_sizes_and_each_split_once_as_it_is():
    cases = added.cases(820)
    plain = [case for case in cases if not case.effect]
    assert [case.split for case in plain] == list(added.SPLITS)
    assert len(cases) - len(plain) == len(added.SPLITS) * len(added.EFFECTS) * 2
    names = {case.name for case in cases}
    assert len(names) == len(cases)
    assert len(names & {case.name for case in added.cases(821)}) == len(plain)


def _row(truth, named, suspected=(), heard=True, peer=(), target=0.1):
    row = {"split": "a", "truth": truth, "heard": heard, "target": target}
    return row | {"named": list(named), "suspected": list(suspected), "peer": peer}


RIPPLE, OTHER = ["ripple", 1, [], 0.95], ["stribeck", 2, [], 0.99]
OLD = ["balancer", 2, ["spring"], 1.0]
ROWS = [
    _row(None, [OLD], heard=False),
    _row(["ripple", 1], [OLD, RIPPLE]),
    _row(["ripple", 1], [OLD, RIPPLE, OTHER], target=0.2),
    _row(["ripple", 1], [], [["spring", 1, ["ripple"], 0.7]]),
    # The logs without it name it already, by its class; a constant.
    _row(["spring", 2], [OLD], peer=[["spring", 2, [], None]]),
    _row(["offset", 1], [["offset", 1, [], 0.9]]),
    _row(["ripple", 3], [["offset", 3, [], 0.9]], heard=False),
]


def test_names_of_what_the_logs_show_are_counted_and_the_rest_apart():
    figures = bars.added_figures(ROWS)

    def hits(name):
        return round(figures[name]["value"] * figures[name]["n"]), figures[name]["n"]

    assert hits("added_first") == (2, 3)
    assert hits("added_named") == (2, 3)
    assert hits("added_suspected") == (1, 3)
    assert hits("added_another") == (1, 3)
    assert hits("added_another_of_all") == (2, 6)
    assert hits("added_constant_first") == (1, 1)
    assert hits("added_known_named") == (1, 1)
    assert figures["added_first_less_another"]["value"] == (2 - 5 * 1) / 3
    # Of the peer the logs without it say nothing: the spring is new.
    assert hits("added_first_of_peer") == (1, 4)
    assert "added_suspected_of_peer" not in figures


def test_fewer_names_count_where_more_probability_is_asked():
    lines = bars.curve(ROWS)[1:]
    cells = {line.split(":")[0]: line.split(": ")[1] for line in lines}
    assert cells["0.5000"] == "2 of 3, 3 of 3, 1 of 3, 2 of 6"
    assert cells["0.9900"] == "0 of 3, 0 of 3, 1 of 3, 1 of 6"


def test_the_peer_tries_one_more_name_as_if_it_fitted_all_columns_anew():
    logs = make(Plant(arm(), (), 3), PLAN, 3)
    selection = greedy._Selection.of(arm(), logs)
    for chosen in ([], [2, 9]):
        for k, errors in selection.left_out_with_one_more(chosen):
            anew = selection.left_out([*chosen, k])
            np.testing.assert_allclose(errors, anew, rtol=1e-5)
