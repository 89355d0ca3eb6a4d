"""Single bad samples are found, and named with their joint."""

from dataclasses import replace

import numpy as np
import pytest

from residual.check.check import check_logs
from residual.check.samples import standing
from residual.errors import InputError
from tests.residual.arms import arm, plain_logs
from tests.residual.check.damaged import clean_logs, edited


@pytest.mark.parametrize("size", [300.0, 1e30, 1e308])
def test_a_spike_of_any_size_is_found_with_its_joint_and_log(size):
    logs = plain_logs(arm(), [0, 1], 0.0, count=2)
    tau = np.array(logs[1].tau)
    tau[400, 1] = size
    found = check_logs(arm(), [logs[0], replace(logs[1], tau=tau)])
    assert [(f.kind, f.joints, f.log) for f in found.faults] == [
        ("spike", (2,), "log1")
    ]


def test_no_log_is_an_error_that_says_so():
    with pytest.raises(InputError, match="at least one recording"):
        check_logs(arm(), [])


def test_noise_and_friction_that_turns_are_no_spikes():
    assert check_logs(arm(), plain_logs(arm(), [0, 1], 0.0)).faults == ()


def changed(signal, change):
    """What stands in one log of which a signal was changed."""
    (log,) = plain_logs(arm(), [0, 1], 0.0, count=1)
    values = np.array(getattr(log, signal))
    change(values)
    faults = standing(replace(log, **{signal: values}))
    return [(fault.kind, fault.joints, fault.certain) for fault in faults]


def test_a_torque_that_stands_while_its_joint_moves_is_frozen():
    def freeze(tau):
        tau[300:450, 0] = tau[300, 0]

    assert changed("tau", freeze) == [("frozen", (1,), False)]


def test_an_angle_that_stands_and_then_jumps_is_frozen():
    def freeze(q):
        q[300:450, 1] = q[300, 1]

    assert changed("q", freeze) == [("frozen", (2,), False)]


def test_a_torque_that_is_cut_is_saturated():
    def cut(tau):
        limit = np.quantile(np.abs(tau[:, 1]), 0.8)
        tau[:, 1] = np.clip(tau[:, 1], -limit, limit)

    assert changed("tau", cut) == [("saturated", (2,), False)]


def test_coarse_steps_of_a_torque_are_said_and_fine_ones_are_not():
    def rounded(share):
        def change(tau):
            step = share * tau[:, 0].std()
            tau[:, 0] = np.round(tau[:, 0] / step) * step

        return change

    assert changed("tau", rounded(0.3)) == [("quantised", (1,), False)]
    assert changed("tau", rounded(0.01)) == []


def test_an_encoder_that_wraps_is_not_taken_for_degrees():
    robot, logs = clean_logs("small")
    damaged = edited(
        logs, q=lambda q: np.column_stack([q[:, 0], q[:, 1:] % (2 * np.pi)])
    )
    faults = check_logs(robot, damaged).faults
    assert {(f.kind, f.certain, f.repairs) for f in faults} == {
        ("out_of_range", True, ())
    }
    assert set(faults[0].joints) <= {2, 3}
    degrees = edited(logs, q=np.rad2deg)
    assert "out_of_range" not in [f.kind for f in check_logs(robot, degrees).faults]


def test_a_unit_of_two_torques_is_not_said_of_all():
    robot, logs = clean_logs("irb140")
    damaged = edited(logs, tau=lambda tau: tau * [1, 1e3, 1, 1e3, 1, 1])
    assert not [f for f in check_logs(robot, damaged).faults if f.certain]
