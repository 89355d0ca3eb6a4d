"""The check benchmark: what is faulty, when a line is exact, what misses a bar."""

import numpy as np
import pytest

from benchmarks.check_parts import bars, cases, judge
from benchmarks.check_parts.arms import SIX, FaultyLogs, host, table_of
from flows.steps import check as steps
from residual.check.result import FORMER, INTERLEAVED, KINDS, Fault, LogCheck, Repair
from sim.engine.plant_records import create_random_stream


@pytest.fixture(scope="module")
def six():
    return host(SIX, 1)


def spoil(own, kind, size=0, seed=1):
    return cases.FAULTS[kind](own, size, create_random_stream(seed, f"{kind}/{size}"))


def test_every_kind_of_fault_can_be_made():
    # Interleaved arms are separated by the reader: tests/warehouse/test_read_log.
    # A wrong drive needs a log with goals: benchmarks/servo_parts.
    made = {*cases.FAULTS, "angle_zero", "torque_scale"}  # the last two are explained
    assert made == set(KINDS) - {INTERLEAVED, "drive", *FORMER}


@pytest.mark.parametrize("kind", cases.FAULTS)
@pytest.mark.parametrize("size", [0, *(pytest.param(n, marks=pytest.mark.long) for n in (1, 2))])
def test_a_fault_changes_logs_or_robot_and_leaves_the_host_as_it_was(six, kind, size):
    before = [table_of(log) for log in six.logs]
    faulty = spoil(six, kind, size)
    if faulty is None:
        return  # a kind with two sizes
    assert faulty.kind == kind
    assert set(faulty.joints) <= set(range(1, 7))
    robot = judge.given_robot(six, faulty)
    same = len(faulty.tables) == len(before) and all(
        np.array_equal(one[name], other[name])
        for one, other in zip(faulty.tables, before, strict=False)
        for name in other
    )
    assert not same or robot.content_hash != six.robot.content_hash
    for table, log in zip(before, six.logs, strict=True):
        for name, values in table.items():
            np.testing.assert_array_equal(values, getattr(log, name))


def fake_check(monkeypatch, *faults):
    monkeypatch.setattr(steps, "check_logs", lambda *_: LogCheck(faults))


REPAIRS = {
    "torque_sign": lambda j: Repair("tau", j, sign=(-1,) * len(j)),
    "torque_unit": lambda j: Repair("tau", scale=1e-3),
    "time_unit": lambda j: Repair("t", scale=1e-3),
}


@pytest.mark.parametrize("kind", REPAIRS)
def test_a_right_line_is_exact_and_half_of_one_is_not(six, monkeypatch, kind):
    faulty = spoil(six, kind)
    repair = REPAIRS[kind](faulty.joints)
    fake_check(monkeypatch, Fault(kind, faulty.joints, True, "", (repair,)))
    row = judge.compare(six, faulty)
    assert (row["hit"], row["exact"]) == (True, [True])
    other = Repair("tau", (6,), sign=(-1,)) if faulty.joints != (6,) else Repair("tau")
    fake_check(monkeypatch, Fault(kind, faulty.joints, True, "", (other,)))
    assert judge.compare(six, faulty)["exact"] == [False]


@pytest.mark.parametrize(
    ("kind", "joints", "hit"),
    [
        ("torque_sign", (2,), True),
        ("angle_sign", (2,), True),
        ("torque_sign", (3,), False),
        ("torque_sign", (), False),
        ("joint_order", (2,), False),
    ],
)
def test_another_kind_or_another_joint_is_no_hit(kind, joints, hit):
    faulty = FaultyLogs("torque_sign", (2,), (), also=("angle_sign",))
    assert judge.is_it(Fault(kind, joints, True, ""), faulty, 6) is hit


def sound(host=SIX, effect="", *faults):
    return {
        "group": "clean",
        "host": host,
        "seed": 1,
        "effect": effect,
        "verdict": "",
        "said": [list(fault) for fault in faults],
    }


def test_one_certain_fault_of_sound_logs_is_a_miss():
    rows = [sound()] * 99 + [sound(SIX, "", ("torque_sign", [1], True))]
    figures = bars.figures(rows, deciding=True)
    assert figures["false_certain"]["ok"] is False
    assert figures["false_faults"]["ok"] is True  # one in a hundred
    assert figures["faults_found_measured"]["value"] is None
    assert bars.figures(rows, deciding=False)["false_certain"]["ok"] is None
