"""Sensors that fail are found and named; those in order are left in peace."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from residual.errors import InputError
from residual.identification.identify import identify
from residual.model.nominal import build_free_nominal, prepare_fit_logs
from residual.monitoring.monitor import Monitor, calibrate_monitor, maxima_per_block
from residual.monitoring.monitor import fit_score_limits as score_limits
from residual.monitoring.thresholds import MONITOR
from residual.recording import Recording
from residual.robot.dynamics import compute_inverse_dynamics
from residual.signals.track import FilterSettings
from tests.residual.arms import arm

# Logs of a small arm that repeats a program, with sensors in order or not.


RATE, PERIOD, STEP = 125.0, 3.0, 1e-4
ROBOT = arm()
RANGE = np.array([60.0, 15.0])  # N m, about, of the torque of the two joints


def healthy(seed: int, duration: float = 12.0) -> Recording:
    """A log in good order: encoder steps, white torque noise, dry friction."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * RATE)) / RATE
    turn = 2 * np.pi / PERIOD
    size = np.array([0.6, 0.8]) + 0.05 * rng.normal(size=2)
    phase = np.array([0.0, 1.0]) + 0.2 * rng.normal(size=2)
    angle = turn * t[:, None] * [1, 2] + phase
    q, qd = size * np.sin(angle), size * turn * np.array([1, 2]) * np.cos(angle)
    qdd = -size * (turn * np.array([1, 2])) ** 2 * np.sin(angle)
    tau = compute_inverse_dynamics(ROBOT.model, q, qd, qdd)
    tau += np.array([4.0, 1.0]) * np.tanh(qd / 0.02) + np.array([2.0, 0.5]) * qd
    tau += 0.01 * RANGE * rng.normal(size=tau.shape)
    read = np.round((q + STEP / 2 * rng.normal(size=q.shape)) / STEP) * STEP
    return Recording(f"run {seed}", ROBOT.name, t, read, tau, q_ref=q)


def spoilt(log: Recording, fault: str, joint: int, onset: float) -> Recording:
    q, tau = log.q.copy(), log.tau.copy()
    first, j = int(np.searchsorted(log.t, onset)), joint - 1
    if fault == "frozen":
        q[first:, j] = q[first - 1, j]
    elif fault == "jump":
        q[first:, j] += np.deg2rad(0.5)
    elif fault == "spikes":
        tau[first :: round(RATE), j] += 0.5 * RANGE[j]
    elif fault == "bias":
        tau[first:, j] += 0.15 * RANGE[j]
    elif fault == "lost scale":
        tau[first:, j] *= 0.7
    elif fault == "drift":
        q[first:, j] += np.deg2rad(2.0) * (log.t[first:] - log.t[first])
    return replace(log, q=q, tau=tau)


def part(log: Recording, stop: float) -> Recording:
    rows = log.t < stop
    arrays = {n: getattr(log, n)[rows] for n in ("t", "q", "tau", "q_ref")}
    return replace(log, **arrays)


@cache
def good_runs() -> tuple[Recording, ...]:
    return tuple(healthy(seed) for seed in range(6))


def model_of(runs):
    logs = prepare_fit_logs(ROBOT, list(runs), None, FilterSettings())
    names = ("viscous", "coulomb", "rotor_inertia")
    return identify(ROBOT, list(runs), build_free_nominal(logs, names).model).model


@cache
def monitor() -> Monitor:
    return calibrate_monitor(model_of(good_runs()), good_runs())


# Sensors that fail are found and named; those in order are left in peace.


ENCODER = ("frozen", "jump", "drift")


@pytest.mark.parametrize("seed", range(100, 103))
def test_sensors_in_order_raise_no_alarm(seed):
    assert monitor().watch(healthy(seed)) == ()


@pytest.mark.parametrize("joint", [1, 2])
@pytest.mark.parametrize(
    ("fault", "within"),
    [
        ("frozen", 0.1),
        ("jump", 0.1),
        ("spikes", 0.1),
        ("bias", 1.0),
        ("lost scale", 1.0),
        ("drift", 1.0),
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


@pytest.mark.parametrize("fault", ["frozen", "spikes", "bias"])
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


def test_without_the_wanted_position_torque_is_still_watched():
    blind = [replace(run, q_ref=None) for run in good_runs()]
    watcher = calibrate_monitor(model_of(blind), blind)
    log = replace(healthy(204), q_ref=None)
    assert watcher.watch(log) == ()
    (first, *_) = watcher.watch(spoilt(log, "bias", 1, 7.3))
    assert (first.joint, first.sensor) == (1, "torque")
    # One that has it is watched without it.
    assert watcher.watch(healthy(204)) == ()


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
        calibrate_monitor(monitor().model, runs, per_hour)


ROWS = 25.0


def noise(seed, seconds, memory=0.9, joints=2):
    """Magnitudes of Gaussian noise with a memory, of one kind. Shape (1, m, joints)."""
    drive = np.random.default_rng(seed).normal(size=(round(seconds * ROWS), joints))
    values = np.abs(lfilter([np.sqrt(1 - memory**2)], [1, -memory], drive, axis=0))
    return values[None]


def peaks(values):
    return maxima_per_block(np.arange(values.shape[1]) / ROWS, values)[0]


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
def test_false_alarms_are_no_more_than_wanted(memory):
    healthy = [peaks(noise(i, 20.0, memory)) for i in range(15)]
    limits = score_limits(healthy, MONITOR.block / 3600)
    hours = 10
    over = peaks(noise(99, 3600.0 * hours, memory)) > limits
    assert over.any(axis=1).sum() <= hours
    assert (limits < 8.0).all()  # and not at the price of seeing nothing
