"""The check benchmark: what is faulty, when a line is exact, what misses a bar."""

import pytest

from benchmarks.check_parts import bars, cases
from benchmarks.check_parts.arms import SIX, host
from flows.steps import check as steps
from residual.check.result import FORMER, INTERLEAVED, KINDS, LogCheck
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


def fake_check(monkeypatch, *faults):
    monkeypatch.setattr(steps, "check_logs", lambda *_: LogCheck(faults))


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
