"""Effects added to measured logs: what the oracle hears, and figures of the answers."""

import numpy as np
import pytest

from benchmarks.measured_parts import bars
from benchmarks.measured_parts.heard import fall_of_error, is_heard
from tests.residual.arms import arm
from tests.synthetic.logs import LogPlan, make
from tests.synthetic.quasi_static import Plant

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
