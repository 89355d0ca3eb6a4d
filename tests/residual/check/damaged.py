"""Clean logs, and the ways in which logs are damaged."""

from dataclasses import replace
from functools import cache

import numpy as np

from residual.check.check import check_logs
from residual.recording import Recording
from tests.residual.arms import arm, bare_irb140
from tests.synthetic.logs import LogPlan, make
from tests.synthetic.quasi_static import Plant


def kinds(robot, logs):
    return [(f.kind, f.joints, f.certain) for f in check_logs(robot, logs).faults]


AXES = ("0 0 1", "0 1 0", "0 1 0")


MIXED = ("fourier", "slow_cyclic", "move_stop_move")


@cache
def clean_logs(name: str, seed: int = 3, hidden=(), families=MIXED) -> tuple:
    """A robot and logs of 20 s each: a small arm of three joints, or the IRB 140."""
    robot = arm(AXES) if name == "small" else bare_irb140()
    plan = tuple(LogPlan(f"fit_{f}", "fit", f, 20.0, 125.0) for f in families)
    return robot, make(Plant(robot, hidden, seed), plan, seed)


def edited(logs, **changes) -> list[Recording]:
    out = []
    for log in logs:
        arrays = {k: change(np.array(getattr(log, k))) for k, change in changes.items()}
        out.append(replace(log, **arrays))
    return out


def turned(*joints):
    def change(x):
        x[:, [j - 1 for j in joints]] *= -1
        return x

    return change


def swapped(a, b):
    def change(x):
        x[:, [a - 1, b - 1]] = x[:, [b - 1, a - 1]]
        return x

    return change


def times(factor):
    return lambda x: x * factor
