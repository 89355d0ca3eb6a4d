"""Single bad samples are found, and named with their joint."""

from dataclasses import replace

import numpy as np
import pytest

from residual.check.check import check_logs
from tests.residual.arms import arm, plain_logs


@pytest.mark.parametrize("size", [300.0, 1e30, 1e308])
def test_a_spike_of_any_size_is_found_with_its_joint_and_log(size):
    logs = plain_logs(arm(), [0, 1], 0.0, count=2)
    tau = np.array(logs[1].tau)
    tau[400, 1] = size
    found = check_logs(arm(), [logs[0], replace(logs[1], tau=tau)])
    assert [(f.kind, f.joints, f.log) for f in found.faults] == [
        ("spike", (2,), "log1")
    ]


def test_noise_and_friction_that_turns_are_no_spikes():
    assert check_logs(arm(), plain_logs(arm(), [0, 1], 0.0)).verdict == "clean"
