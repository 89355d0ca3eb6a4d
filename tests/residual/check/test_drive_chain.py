"""What stands between goal and torque of a drive, found by the check."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from residual.check import drive_chain
from residual.check.check import check_logs
from residual.check.drive_chain import find_drive_faults
from residual.drive import Drive
from residual.recording import apply_drive
from residual.robot.robot import add_known_values
from tests.residual.driven import DRIVE, drive_log, pendulum


@cache
def logs():
    return tuple(drive_log(seed) for seed in (1, 2))


@cache
def find_fault():
    (fault,), _ = find_drive_faults(pendulum(), logs())
    return fault


def test_a_chain_that_the_map_leaves_out_is_found_with_its_line():
    (repair,) = find_fault().repairs
    assert find_fault().certain
    assert find_fault().joints == (1,)
    assert repair.drive.goal_speed[0] == pytest.approx(2.0, rel=0.08)
    assert repair.drive.delay[0] == pytest.approx(0.04, abs=0.015)
    assert repair.drive.gain[0] == pytest.approx(60.0, rel=0.1)
    assert "until a mass is weighed" in find_fault().evidence


def test_a_speed_that_a_limit_hides_is_a_bound_and_a_limit_a_range():
    hidden = replace(DRIVE, limit=(12.0,), goal_speed=(50.0,))
    faults, _ = find_drive_faults(pendulum(), [drive_log(seed, drive=hidden) for seed in (1, 2)])
    words = faults[0].evidence
    low, high = re.search(r"limit of torque is .* \[(.*) to (.*)\] N m", words).groups()
    assert float(low) < 12.0 < 1.1 * float(high)
    assert "the goal's speed is at least" in words or "goal's speed" not in words


@pytest.mark.parametrize(("speed", "certain"), [(2.2, True), (4.0, False)])
def test_a_chain_is_certain_where_it_halves_what_is_left(monkeypatch, speed, certain):
    """Less may be an effect of the library, however many nats it is worth."""
    chain = {"goal_speed": [speed], "delay": [0.0], "limit": [np.inf]}
    worth = {"goal_speed": [100.0], "delay": [0.0], "limit": [0.0]}
    found = (chain, worth, {k: [v, v] for k, v in chain.items()})
    answer = [{k: np.array(v) for k, v in each.items()} for each in found]
    monkeypatch.setattr(drive_chain, "search_drive_chain", lambda *_: answer)
    (fault,), _ = find_drive_faults(pendulum(), logs())
    assert fault.certain == certain


def test_with_its_chain_a_log_has_no_fault_of_its_drive():
    right = [apply_drive(log, DRIVE) for log in logs()]
    kinds = {fault.kind for fault in check_logs(pendulum(), right).faults}
    assert not kinds & {"drive", "torque_unit", "frozen", "saturated", "commanded"}


def test_a_known_mass_corrects_the_gain_of_the_map():
    half = replace(DRIVE, gain=(30.0,), limit=(15.0,))
    wrong = [apply_drive(log, half) for log in logs()]
    weighed = add_known_values(pendulum(), {"payload.mass": 1e-6})
    (fault,), _ = find_drive_faults(weighed, wrong)
    assert fault.repairs[0].drive.gain[0] == pytest.approx(60.0, rel=0.1)
    assert not fault.certain
    assert "By the known mass" in fault.evidence


def test_a_log_whose_torque_is_measured_is_asked_nothing_of_a_drive():
    log = replace(apply_drive(logs()[0], DRIVE), drive=None)
    assert find_drive_faults(pendulum(), [log]) == ([], [log])


def test_no_row_at_the_limit_of_a_drive_is_fitted():
    log = apply_drive(logs()[0], Drive(gain=(60.0,), limit=(5.0,)))
    assert 0.05 < np.mean(log.masked) < 0.95
    again = apply_drive(log, Drive(gain=(60.0,)))
    assert not again.masked.any()
