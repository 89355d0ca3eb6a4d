"""A log is checked alone only where it misses more of the common arm."""

import numpy as np

from residual.check.check import list_odd_logs
from tests.residual.check.damaged import clean_logs, edited, swapped


def test_no_log_of_one_arm_is_odd_and_one_of_other_columns_is(recwarn):
    robot, logs = clean_logs("irb140")
    assert list_odd_logs(robot, logs) == []
    bad = edited(logs[:1], q=swapped(2, 3), tau=swapped(2, 3))
    assert bad[0] in list_odd_logs(robot, [*bad, *logs[1:]])
    held = edited(logs, q=lambda q: np.column_stack([q[:, :5], 0 * q[:, 5]]))
    list_odd_logs(robot, held)
    assert not recwarn.list
