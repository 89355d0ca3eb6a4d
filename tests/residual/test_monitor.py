"""Sensors that fail are found and named; those in order are left in peace."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from residual.errors import InputError
from residual.monitoring.monitor import calibrate, from_record, to_record
from residual.monitoring.rows import period_of, repeats, rows_of
from residual.monitoring.rules import MONITOR
from residual.monitoring.scores import Scores, channels
from residual.monitoring.usual import BLOCK, limits_of
from tests.residual.monitored import (
    PERIOD,
    good_runs,
    healthy,
    model_of,
    monitor,
    part,
    spoilt,
)

ENCODER = ("frozen", "jump")


@pytest.mark.parametrize("seed", range(100, 106))
def test_sensors_in_order_raise_no_alarm(seed):
    assert monitor().watch(healthy(seed)) == ()


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize(
    ("fault", "within"),
    [
        ("frozen", 0.1),
        ("jump", 0.1),
        ("spikes", 0.1),
        ("torque bias", 1.0),
        ("gain drop", 1.0),
    ],
)
def test_a_fault_is_found_soon_and_named(fault, within, joint):
    onset = 7.3
    (first, *_) = monitor().watch(spoilt(healthy(200), fault, joint, onset))
    assert (first.joint, first.fault) == (joint, fault)
    assert first.sensor == ("encoder" if fault in ENCODER else "torque")
    assert 0 <= first.time - onset <= within
    assert first.score > 1
    assert first.until >= first.time


@pytest.mark.parametrize("fault", ["frozen", "spikes", "torque bias"])
def test_no_alarm_knows_what_comes_after_it(fault):
    log = spoilt(healthy(201), fault, 2, 7.3)
    every = monitor().watch(log)
    stop = every[0].time + MONITOR.together + 0.7  # when its name is settled
    seen = monitor().watch(part(log, stop))
    assert (seen[0].time, seen[0].joint, seen[0].fault) == (
        every[0].time,
        every[0].joint,
        every[0].fault,
    )
    assert monitor().watch(part(log, 7.2)) == ()


def test_limits_know_no_order_of_runs_and_fewer_false_alarms_cost_higher_ones():
    turned = calibrate(monitor().model, good_runs()[::-1])
    for kind, limits in monitor().limits.items():
        np.testing.assert_allclose(turned.limits[kind], limits, rtol=1e-6, err_msg=kind)
    strict = calibrate(monitor().model, good_runs(), per_hour=0.01)
    for kind, limits in monitor().limits.items():
        assert (strict.limits[kind] >= limits * (1 - 1e-9)).all(), kind
    assert strict.limits["model"].sum() > monitor().limits["model"].sum()


def test_a_monitor_comes_back_from_json():
    text = json.dumps(to_record(monitor()), allow_nan=False)
    again = from_record(json.loads(text))
    log = spoilt(healthy(202), "gain drop", 1, 7.0)
    assert again.watch(log) == monitor().watch(log)
    assert again.watch(log) != ()
    np.testing.assert_array_equal(again.novelty(log), monitor().novelty(log))


def test_a_state_that_no_good_run_had_is_told_and_is_no_fault():
    log = healthy(203)
    assert monitor().novelty(log).max() < 0.05
    shift = np.array([1.0, 0.0])
    far = replace(log, q=log.q + shift, q_ref=log.q_ref + shift)
    assert monitor().novelty(far)[0] > 0.2
    assert monitor().novelty(far)[1] < 0.05


def test_without_the_wanted_position_torque_is_still_watched():
    blind = [replace(run, q_ref=None) for run in good_runs()]
    watcher = calibrate(model_of(blind), blind)
    log = replace(healthy(204), q_ref=None)
    assert watcher.watch(log) == ()
    (first, *_) = watcher.watch(spoilt(log, "torque bias", 1, 7.3))
    assert (first.joint, first.sensor) == (1, "torque")
    # One that has it is watched without it.
    assert watcher.watch(healthy(204)) == ()


def test_a_reading_without_noise_may_rest():
    def resting(run):
        rows = (run.t > 3) & (run.t < 6)
        q = run.q_ref.copy()
        q[rows] = q[rows][0]
        return replace(run, q=q, q_ref=q)

    runs = [resting(run) for run in good_runs()]
    assert np.isinf(calibrate(monitor().model, runs).limits["still"]).all()
    assert np.isfinite(monitor().limits["still"]).all()


def test_the_cycle_of_a_program_is_found_and_none_where_a_motion_does_not_repeat():
    rows = rows_of(healthy(207))
    period = period_of(rows)
    assert period == pytest.approx(PERIOD, abs=1e-3)
    assert repeats(rows, period)[rows.t > 6.2].all()
    assert not repeats(rows, period)[rows.t < 5.9].any()
    log = healthy(208)
    drifting = log.q_ref + 0.2 * log.t[:, None]
    assert period_of(rows_of(replace(log, q=drifting, q_ref=drifting))) is None


def test_a_gap_in_a_log_is_no_fault():
    log = healthy(209)
    keep = (log.t < 5.0) | (log.t > 5.4)
    arrays = {n: getattr(log, n)[keep] for n in ("t", "q", "tau", "q_ref")}
    assert monitor().watch(replace(log, **arrays)) == ()


def other_rate(log):
    return replace(log, t=log.t * 2)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (other_rate, "62.5 Hz, the monitor is calibrated at 125 Hz"),
        (lambda log: replace(log, q_ref=None), "has no q_ref"),
        (lambda log: part(log, 0.5), "expected at least 1 s"),
        (
            lambda log: replace(log, q=log.q[:, :1], tau=log.tau[:, :1], q_ref=None),
            "1 joints, the monitor is for 2",
        ),
    ],
)
def test_a_log_that_does_not_fit_is_refused(change, said):
    with pytest.raises(InputError, match=said) as caught:
        monitor().watch(change(healthy(210)))
    assert str(caught.value).count("\n") < 2


@pytest.mark.parametrize(
    ("runs", "per_hour", "said"),
    [
        (good_runs()[:2], 1.0, "2 runs to calibrate on, expected at least 3"),
        (good_runs(), 0.0, "0 false alarms per hour, expected more than 0"),
        (
            tuple(replace(r, t=r.t * 5) for r in good_runs()),
            1.0,
            "logged at 25 Hz, expected at least 60 Hz",
        ),
        ((*good_runs()[:3], other_rate(good_runs()[3])), 1.0, "logged at 62.5 Hz"),
    ],
)
def test_runs_that_no_limit_can_come_from_are_refused(runs, per_hour, said):
    with pytest.raises(InputError, match=said):
        calibrate(monitor().model, runs, per_hour)


def test_a_record_of_another_form_or_a_damaged_one_is_refused():
    record = to_record(monitor())
    with pytest.raises(InputError, match="damaged"):
        from_record(record | {"model": record["model"] | {"terms": None}})
    with pytest.raises(InputError, match="of form 0, expected 1 with its model"):
        from_record(record | {"form": 0})


ROWS = 25.0


def noise(seed, seconds, memory=0.9, joints=2):
    """Magnitudes of Gaussian noise with a memory."""
    drive = np.random.default_rng(seed).normal(size=(round(seconds * ROWS), joints))
    values = np.abs(lfilter([np.sqrt(1 - memory**2)], [1, -memory], drive, axis=0))
    t = np.arange(len(values)) / ROWS
    return Scores("model", t, values, channels(joints, "torque", "torque bias"))


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
def test_false_alarms_are_no_more_than_wanted(memory):
    limits = limits_of([noise(i, 20.0, memory) for i in range(15)], per_hour=1.0)
    hours = 10
    over = noise(99, 3600.0 * hours, memory).values > limits
    blocks = over.any(axis=1).reshape(-1, round(BLOCK * ROWS)).any(axis=1)
    assert blocks.sum() <= hours
    assert (limits < 8.0).all()  # and not at the price of seeing nothing


def test_limits_scale_with_the_scores():
    runs = [noise(i, 20.0) for i in range(5)]
    by = np.array([3.0, 100.0])
    larger = [Scores("model", r.t, r.values * by, r.channels) for r in runs]
    np.testing.assert_allclose(limits_of(larger, 1.0), by * limits_of(runs, 1.0))
