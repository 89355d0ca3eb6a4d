"""The same samples never count twice."""

import numpy as np
import pytest

from residual.errors import InputError
from residual.recording import Recording
from warehouse.logs import check_distinct, read_log


def recording(label, table):
    t, q, tau = table[:, 0], table[:, 1:3], table[:, 3:]
    return Recording(id=label, robot="two_link", t=t, q=q, tau=tau)


def test_windows_that_touch_are_distinct_and_those_that_overlap_are_not(
    robot, samples, write
):
    path = write(samples)
    first, second = (read_log(f"{path}@{w}", robot)[0] for w in (":2", "2:"))
    check_distinct([first, second])
    early = read_log(f"{path}@1.9:", robot)[0]
    with pytest.raises(InputError, match=r"'run@:2' and 'run@1.9:' hold the same"):
        check_distinct([second, first, early][1:])


def test_a_copy_on_another_clock_is_found(samples):
    copy = samples.copy()
    copy[:, 0] += 100
    with pytest.raises(InputError, match=r"same samples \(about 400\)"):
        check_distinct([recording("a", samples), recording("b", copy)])


def test_the_same_rest_position_is_no_copy(samples):
    """Coarse sensors give the same samples in any two logs while the arm rests."""
    other = samples.copy()
    other[:, 1:] += 0.5
    rest = np.tile([0, 0.1, 0.2, 1.0, 2.0], (300, 1))
    rest[150:, 3] = 1.5
    rest[:, 0] = np.arange(300) / 100
    logs = [
        recording(label, np.vstack([rest, table + np.array([3, 0, 0, 0, 0])]))
        for label, table in (("a", samples), ("b", other))
    ]
    check_distinct(logs)
