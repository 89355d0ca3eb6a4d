"""The signal path: nothing moves in time, and torque and regressor pass alike."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from residual.drive import Drive
from residual.recording import Recording
from residual.signals.track import FilterSettings, build_tracks, filter_low_pass
from residual.signals.track import estimate_sample_rate as sample_rate

FILTERS = FilterSettings()
RATES = (100.0, 250.0, 1000.0)


def sines(t, frequencies, seed=0):
    rng = np.random.default_rng(seed)
    angle = 2 * np.pi * np.outer(t, frequencies) + rng.uniform(0, 6, len(frequencies))
    return np.sin(angle).sum(axis=1)


def log(t, q, tau=None, label="log"):
    q = np.reshape(q, (len(t), -1))
    tau = np.zeros_like(q) if tau is None else np.reshape(tau, q.shape)
    return Recording(label, "any", t, q, tau)


def one(recording, **options):
    (track,), floor = build_tracks([recording], FILTERS, **options)
    return track, floor


def clock(duration, rate):
    return np.arange(round(duration * rate)) / rate


def test_the_filter_leaves_a_constant_and_a_log_too_slow_for_it_alone():
    assert_allclose(filter_low_pass(np.full((500, 2), 3.7), 8, 250), 3.7)
    x = np.random.default_rng(1).normal(size=50)
    np.testing.assert_array_equal(filter_low_pass(x, 8, 16), x)


@pytest.mark.parametrize("rate", RATES)
def test_features_pass_the_filter_that_torque_passes(rate):
    """A torque that is exactly one feature comes out equal on both ways."""
    t = clock(10, rate)
    x = sines(t, (0.4, 2.9, 6.0, 7.5))
    track, _ = one(log(t, np.sin(t), x))
    same = track.filter(x[:: round(rate / track.rate)])[track.valid]
    assert_allclose(same, track.tau[track.valid, 0], atol=1e-3 * x.std())


@pytest.mark.parametrize("rate", RATES)
def test_velocity_and_acceleration_are_those_of_the_motion(rate):
    t = clock(8, rate)
    w = 2 * np.pi * 0.5
    track, _ = one(log(t, np.sin(w * t)), full_rate=True)
    inner = (track.t > 1) & (track.t < 7)
    assert_allclose(track.qd[inner, 0], w * np.cos(w * track.t[inner]), atol=2e-3 * w)
    assert_allclose(track.qdd[inner, 0], -(w**2) * np.sin(w * track.t[inner]), atol=4e-3 * w**2)


@pytest.mark.parametrize(
    ("dt", "rate"), [(0.004, 250.0), (0.008, 125.0), (1 / 249.96, 250.0), (0.03, 1 / 0.03)]
)
def test_the_rate_is_the_median_and_whole_where_nearly_so(dt, rate):
    t = np.cumsum(np.full(200, dt))
    t[100:] += 3.0
    assert sample_rate(t) == pytest.approx(rate, rel=1e-12)


def stop_and_go(t):
    """Moves for 2 s, stands for 1 s, and so on; reverses at 4.5 s within a move."""
    speed = np.where(t % 3 < 2, 1.0, 0.0) * np.where(t < 4.5, 1.0, -1.0)
    return np.cumsum(speed) * (t[1] - t[0])


@pytest.mark.parametrize("rate", RATES)
def test_dwells_and_reversals_are_masked_with_a_margin(rate):
    t = clock(12, rate)
    track, _ = one(log(t, stop_and_go(t)))
    rows, moving = track.t[:: track.step], track.moving[:, 0]
    margin = FILTERS.margin / track.cutoff
    for start in (2, 5, 8):
        stands = (rows > start - 0.8 * margin) & (rows < start + 1 + 0.8 * margin)
        assert not moving[stands].any()
    assert not moving[np.abs(rows - 4.5) < 0.8 * margin].any()
    for middle in (1.0, 3.7, 7.0, 10.0):
        assert moving[np.abs(rows - middle) < 0.1].all()


def test_near_standstill_a_torque_of_a_drive_counts_sooner_than_a_measured_one():
    t = clock(12, 100)
    measured = log(t, stop_and_go(t))
    driven = replace(measured, drive=Drive())
    (own, _), (other, _) = one(measured), one(driven)
    near = np.abs(own.t[:: own.step, None] - [5.0, 8.0]).min(axis=1) < 0.5
    assert (own.moving <= other.moving).all()
    assert other.moving[near].sum() >= own.moving[near].sum() + 4
    stands = (own.t[:: own.step] > 5.1) & (own.t[:: own.step] < 5.9)
    assert not other.moving[stands].any()


def test_a_gap_in_the_log_is_masked_and_a_missed_sample_or_two_is_none():
    t = clock(10, 250)
    t = t[(t < 4.0) | (t > 5.0)]
    track, _ = one(log(t, 0.3 * t))
    rows = track.t[:: track.step]
    assert not track.valid[(rows > 3.95) & (rows < 5.05)].any()
    assert track.valid[(rows > 0.6) & (rows < 3.8)].all()
    assert track.valid[(rows > 5.2) & (rows < 9.4)].all()
    assert not track.moving[(rows > 3.95) & (rows < 5.05)].any()
    t = np.delete(clock(10, 250), [700, 701, 702])
    track, _ = one(log(t, 0.3 * t))
    rows = track.t[:: track.step]
    assert track.valid[(rows > 0.6) & (rows < 9.4)].all()


def test_thresholds_are_common_to_all_logs_and_may_come_from_others():
    t = clock(6, 250)
    fast, slow = log(t, np.sin(3 * t)), log(t, 0.001 * np.sin(3 * t))
    tracks, floor = build_tracks([fast, slow], FILTERS)
    assert tracks[0].moving.mean() > 0.3
    assert tracks[1].moving.mean() == 0
    _, again = one(slow, speed_floor=floor)
    np.testing.assert_array_equal(again, floor)
    assert one(slow)[1] < floor


def test_the_threshold_rises_with_the_noise_of_the_encoder():
    t = clock(8, 250)
    noise = np.random.default_rng(4).normal(size=len(t))
    quiet, noisy = (one(log(t, 0.1 * np.sin(t) + s * noise))[1] for s in (0, 1e-3))
    assert noisy > 3 * quiet


@pytest.mark.parametrize("rate", [125.0, 250.0, 500.0])
def test_white_noise_is_measured_as_what_passes_the_filter(rate):
    rng = np.random.default_rng(5)
    t = clock(40, rate)
    signal = 20 * sines(t, (0.3, 1.1, 2.0))
    noise = 3.0 * rng.normal(size=len(t))
    track, _ = one(log(t, np.sin(t), signal + noise))
    passed = filter_low_pass(noise, track.cutoff, rate)[int(rate) : -int(rate)].std()
    assert track.torque_noise[0] == pytest.approx(passed, rel=0.15)
