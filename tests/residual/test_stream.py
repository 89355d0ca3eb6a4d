"""A stream is watched batch by batch, and how it is cut changes nothing."""

import itertools
import json
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residual.errors import InputError
from residual.monitoring.learn import learn
from residual.monitoring.reference import Reference
from residual.monitoring.rows import Samples, Window, rows_of, start, take
from residual.monitoring.watch import begin, state_from_record, state_to_record, step
from residual.recording import Recording
from residual.robot.dynamics import regressor
from residual.signals.filters import low_pass
from tests.residual.monitored import RATE, ROBOT, good_runs, healthy, model_of, spoilt


@cache
def reference() -> Reference:
    return learn(model_of(good_runs()), good_runs())


def samples(log: Recording, shift: float = 0.0) -> Samples:
    return Samples(log.t + shift, log.q, log.tau)


def joined(*parts: Samples) -> Samples:
    return Samples(
        *(np.concatenate([getattr(p, n) for p in parts]) for n in ("t", "q", "tau"))
    )


@cache
def stream() -> Samples:
    """Healthy, NaN, a gap, a late row, a clock set anew, and a changed gain."""
    first, then = samples(healthy(300, 5.0)), samples(healthy(301, 5.0), 10.0)
    tau = first.tau.copy()
    tau[200:203, 1] = np.nan
    late = replace(then[290:291], t=then.t[290:291] - 0.5)
    last = samples(spoilt(healthy(302, 6.0), "gain drop", 1, 3.0))
    broken = replace(first, tau=tau)
    return joined(broken, then[:300], late, then[300:], last)


def fed(cuts: tuple[int, ...]):
    """State and alarms with the stream cut at some samples."""
    every, state, alarms = stream(), begin(reference()), []
    edges = [0, *sorted(cuts), len(every.t)]
    for first, stop in itertools.pairwise(edges):
        state, new = step(reference(), state, every[first:stop])
        alarms += new
    return state, alarms


@cache
def whole():
    return fed(())


def flat(state) -> np.ndarray:
    kept = state.tail.kept
    past, rows = state.past, state.rows
    arrays = (kept.t, kept.q, kept.tau, past.gram, past.mean, past.cov)
    arrays += (np.maximum(past.clock, -1.0), rows.t, rows.qdd, state.use, state.since)
    plain = (state.clock, state.last, state.left, state.waited, state.moved)
    plain += (state.alarms, state.tail.count)
    return np.concatenate([*(np.ravel(a) for a in arrays), plain])


@settings(max_examples=15, deadline=None)
@given(st.lists(st.integers(0, 1990), max_size=12).map(tuple))
def test_any_cut_into_batches_gives_the_same_state_and_alarms(cuts):
    state, alarms = fed(cuts)
    expected, told = whole()
    np.testing.assert_allclose(flat(state), flat(expected), rtol=1e-6, atol=1e-6)
    assert state.tail.heard == expected.tail.heard
    assert [(a.time, a.joint, a.quantity) for a in alarms] == [
        (a.time, a.joint, a.quantity) for a in told
    ]
    sizes = [a.size for a in alarms], [a.size for a in told]
    np.testing.assert_allclose(*sizes, rtol=1e-6)


def test_what_was_wrong_with_the_samples_is_counted():
    heard = whole()[0].tail.heard
    assert (heard.broken, heard.late, heard.restarts) == (3, 1, 1)
    assert heard.gaps == 2  # the rows without a number, and the pause
    assert heard.samples == len(stream().t) - 4


def test_a_state_that_was_written_and_read_goes_on_as_if_nothing_had_been():
    every, state, told = stream(), begin(reference()), []
    known = Reference.from_record(json.loads(json.dumps(reference().to_record())))
    for first, stop in ((0, 700), (700, 1500), (1500, len(every.t))):
        record = json.loads(json.dumps(state_to_record(state)))
        state, new = step(known, state_from_record(record), every[first:stop])
        told += new
    np.testing.assert_allclose(flat(state), flat(whole()[0]), rtol=1e-6, atol=1e-6)
    assert [a.time for a in told] == [a.time for a in whole()[1]]


@pytest.mark.parametrize("seed", range(310, 314))
def test_a_healthy_arm_raises_no_alarm(seed):
    _, alarms = step(reference(), begin(reference()), samples(healthy(seed)))
    assert alarms == ()


@pytest.mark.parametrize("joint", [1, 2])
def test_a_gain_that_drops_is_alarmed_once_named_and_sized(joint):
    log = spoilt(healthy(320), "gain drop", joint, 7.0)
    _, alarms = step(reference(), begin(reference()), samples(log))
    (alarm,) = alarms  # it lasts, and is one alarm
    assert 0 < alarm.time - 7.0 < 3.0
    assert (alarm.quantity, alarm.joint, alarm.unit) == ("gain", joint, "1")
    assert alarm.size == pytest.approx(-0.3, abs=0.05)
    assert (alarm.score > 1, alarm.per_hour < 1) == (True, True)
    assert ("gain", joint) not in alarm.or_else


def test_a_constant_torque_is_alarmed_and_named():
    log = spoilt(healthy(321), "torque bias", 2, 6.0)
    _, alarms = step(reference(), begin(reference()), samples(log))
    assert (alarms[0].quantity, alarms[0].joint) == ("bias", 2)
    assert alarms[0].size == pytest.approx(2.25, rel=0.1)


@pytest.mark.parametrize("joint", [1, 2])
def test_friction_that_grows_is_alarmed_and_named(joint):
    log = healthy(322)
    qd = np.gradient(low_pass(log.q, 8.0, RATE), log.t, axis=0)
    more = np.array([3.0, 1.0]) * np.tanh(qd / 0.02) * (log.t > 6.0)[:, None]
    more[:, 2 - joint] = 0.0
    changed = replace(log, tau=log.tau + more)
    _, alarms = step(reference(), begin(reference()), samples(changed))
    assert (alarms[0].quantity, alarms[0].joint) == ("friction", joint)
    assert 0 < alarms[0].time - 6.0 < 3.0


def test_a_load_on_the_flange_is_alarmed_and_weighed():
    log = healthy(330)
    motion = [low_pass(log.q, 8.0, RATE)]
    motion += [np.gradient(motion[-1], log.t, axis=0)]
    motion += [np.gradient(motion[-1], log.t, axis=0)]
    load = np.array([1.0, 0.0, 0.0, 0.05, *np.zeros(6)])
    added = regressor(ROBOT.model, *motion)[:, :, -10:] @ load
    tau = log.tau + added * (log.t > 6.0)[:, None]
    _, alarms = step(reference(), begin(reference()), samples(replace(log, tau=tau)))
    assert (alarms[0].quantity, alarms[0].joint) == ("load", ROBOT.dof)
    assert 0 < alarms[0].time - 6.0 < 3.0
    assert alarms[0].unit == "kg"
    assert alarms[0].size > 0.2


def test_friction_that_grows_slowly_is_warmth():
    end, parts = 0.0, []
    for log in (healthy(360 + i) for i in range(20)):
        t = end + log.t
        qd = np.gradient(low_pass(log.q, 8.0, RATE), log.t, axis=0)
        warm = 0.03 * np.sin(2 * np.pi * t / 240.0)[:, None]
        tau = log.tau - warm * (np.array([4.0, 1.0]) * np.tanh(qd / 0.02))
        parts.append(Samples(t, log.q, tau))
        end = t[-1] + 1.0
    _, alarms = step(reference(), begin(reference()), joined(*parts))
    assert alarms == ()


def test_an_arm_that_stands_says_nothing_however_long():
    log = healthy(340)
    still = Samples(
        np.arange(5000) / RATE,
        np.tile(log.q[50], (5000, 1)),
        log.tau[50] + np.zeros((5000, 2)),
    )
    state, alarms = step(reference(), begin(reference()), still)
    assert alarms == ()
    assert state.moved == 0
    assert not state.past.gram.any()


def test_what_cannot_be_watched_is_refused_with_what_to_do():
    with pytest.raises(InputError, match="Delete it"):
        state_from_record({"form": 1})
    with pytest.raises(InputError, match="Learn it again"):
        Reference.from_record({"form": 1})
    wrong = Samples(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)))
    with pytest.raises(InputError, match="expected 2 joints"):
        step(reference(), begin(reference()), wrong)
    with pytest.raises(InputError, match="at least 3"):
        learn(model_of(good_runs()), good_runs()[:2])


def test_rows_are_those_of_the_monitor():
    log = healthy(350, 3.0)
    _, rows = take(start(2), samples(log), Window(RATE))
    expected = rows_of(log)
    for name in ("t", "q", "qd", "qdd", "tau"):
        np.testing.assert_allclose(
            getattr(rows, name), getattr(expected, name), rtol=1e-9, atol=1e-9
        )


def test_limits_are_of_more_runs_than_one_and_fall_with_the_alarms_allowed():
    each = [rows_of(run).qd.max(axis=0) for run in good_runs()]
    np.testing.assert_allclose(reference().highest[1], np.sort(each, axis=0)[-2])
    # More false alarms allowed, no higher limits.
    often = learn(model_of(good_runs()), good_runs(), per_hour=10.0)
    assert (often.limits <= reference().limits + 1e-9).all()
    assert often.limits.min() < reference().limits.min()
