"""What chance brings about: the record, and recordings without an effect."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.stats import binom

from residual.errors import InputError
from residual.method.null_record import Key, Null, choose_null, from_record, to_record
from residual.method.nulls import (
    LONGEST,
    autocovariance,
    block,
    coloured,
    loudest,
    null_recordings,
    redrawn,
    source,
)
from sim.engine.records import Hidden
from tests.residual.arms import arm, diagnose_case, names, short_case
from tests.residual.linear import DOF, Problem, every_group

KEY = Key(
    robot="a" * 64,
    declared=("coulomb", "viscous"),
    candidates=("offset", "spring"),
    clock=True,
    cutoff=8.0,
    duration=60.0,
    noise=(0.2, 0.1),
    speed=(1.0, 2.0),
    moving=(0.7, 0.6),
)


def null_of(nats, **changes) -> Null:
    """A null with that evidence, at a price of 5 nats."""
    nats = tuple(float(v) for v in nats)
    count = len(nats)
    parts = {
        "net": tuple(v - 5 for v in nats),
        "named": (False,) * count,
        "block": tuple(range(count)),
        "seed": 1,
        "scale": 0.03,
        **changes,
    }
    return Null("n", parts.pop("key", KEY), nats, **parts)


# -- the record --------------------------------------------------------------------


def test_p_values_count_draws_and_thresholds_are_the_rules_unless_chance_is_louder():
    null = null_of([1, 2, 3, 4])
    assert null.p_value(3.0) == pytest.approx(3 / 5)
    assert null.p_value(9.0) == pytest.approx(1 / 5)
    assert null.p_value(-9.0) == 1.0
    assert null_of(np.arange(5)).threshold(10.0) == 10.0
    loud = null_of(np.linspace(0, 100, 101))
    assert loud.threshold(10.0) == pytest.approx(90.0)  # 95 less the price


def test_false_alarms_are_those_above_the_threshold():
    null = null_of([20, 20, 8, 1], named=(True, False, True, False))
    assert null.alarms(10.0) == 1
    p, low, high = null.rate(10.0)
    assert p == 0.25
    assert 0 < low < p < high < 1
    assert "1 of 4" in null.sentence(10.0)


def test_draws_that_share_their_encoder_noise_count_for_less():
    rng = np.random.default_rng(0)
    shared = np.repeat(rng.normal(size=10), 4) + 1e-3 * rng.normal(size=40)
    blocks = tuple(np.repeat(range(10), 4).tolist())
    assert null_of(shared, block=blocks).independent < 13
    assert null_of(rng.normal(size=40), block=blocks).independent > 25


def test_beyond_the_largest_an_exponential_tail_goes_on():
    drawn = np.random.default_rng(1).exponential(2.0, 4000) + 5
    null = null_of(drawn)
    for x in (3.0, 6.0, 12.0):
        assert null.beyond(x) == pytest.approx(np.exp(-x / 2), rel=0.5)
    assert null.beyond(40.0) > 0


def test_a_record_comes_back_as_it_was():
    null = null_of([1.5, 2.5], named=(True, False))
    again = from_record(to_record(null), "n")
    assert to_record(again) == to_record(null)
    assert again.key == null.key
    assert again.p_value(2.0) == null.p_value(2.0)


@pytest.mark.parametrize(
    "bad", [{}, {"key": {}}, {**to_record(null_of([1])), "net": []}]
)
def test_what_is_no_null_is_refused(bad):
    with pytest.raises(InputError, match="is no null"):
        from_record(bad, "some.json")


# -- when it holds -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"robot": "b" * 64}, "another robot"),
        ({"declared": ("viscous",)}, "other declared effects"),
        ({"candidates": ("offset",)}, "vocabulary"),
        ({"clock": False}, "order in time"),
        ({"cutoff": 5.0}, "cut-off"),
        ({"duration": 95.0}, "duration"),
        ({"noise": (0.2, 0.16)}, "torque noise"),
        ({"speed": (0.6, 2.0)}, "speeds"),
        ({"moving": (0.7, 0.4)}, "joint 2 moves"),
    ],
)
def test_a_null_of_something_else_is_refused_and_passed_over(change, word):
    other = replace(KEY, **change)
    assert word in KEY.mismatch(other)
    with pytest.raises(InputError, match="calibrate-null"):
        choose_null(null_of([1]), other)
    assert choose_null([null_of([1])], other) is None


def test_a_null_of_much_the_same_logs_holds():
    near = replace(KEY, duration=75.0, noise=(0.25, 0.08), moving=(0.6, 0.65))
    wanted = null_of([1])
    assert choose_null(wanted, near) is wanted
    first = null_of([1], key=replace(KEY, robot="b" * 64))
    assert choose_null([first, wanted], near) is wanted
    assert choose_null(None, near) is None


# -- noise -------------------------------------------------------------------------


def test_redrawn_noise_has_the_measured_level_and_memory():
    """AR(1) noise, a third of the rows masked, forty columns fitted."""
    rng, a = np.random.default_rng(5), 0.7
    problem = Problem.draw(rng, rows=1500, colour=a, noise=2.0, masked=0.3)
    task = problem.task(every_group(problem.design))
    acov = autocovariance(problem.design, task.start())
    np.testing.assert_allclose(acov[0], 4.0, rtol=0.15)
    np.testing.assert_allclose(
        acov[1:4] / acov[0], a ** np.arange(1, 4)[:, None] + [[0, 0]], atol=0.08
    )
    made = coloured(acov, 40000, rng)
    again = [np.mean(made[k:] * made[: len(made) - k], axis=0) for k in range(5)]
    np.testing.assert_allclose(again, acov[:5], atol=0.1 * acov[0].max())
    assert acov.shape == (LONGEST, DOF)


def test_p_values_of_fresh_draws_are_uniform_enough():
    """40 draws of the calibration, 40 fresh ones: a fifth of them below p = 0.2."""
    largest = []
    for seed in range(80):
        rng = np.random.default_rng(seed)
        problem = Problem.draw(rng, rows=40, logs=2)
        task = problem.task(every_group(problem.design))
        largest.append(loudest(task, task.start())[0])
    null = null_of(largest[:40])
    for level in (0.2, 0.5):
        below = sum(null.p_value(v) <= level for v in largest[40:])
        assert 0.001 < binom.cdf(below, 40, level) < 0.999


# -- recordings --------------------------------------------------------------------


@cache
def made_after():
    spring = Hidden("spring", (1,), {"stiffness": 20.0, "rest": 0.2})
    case = short_case(arm(), spring, seed=44)
    return source(case.robot, case.fit), case


def test_null_recordings_move_as_the_logs_and_lack_what_was_found():
    after, case = made_after()
    clean, read = null_recordings(after, np.random.default_rng(2))
    for log, own, noisy in zip(case.fit, clean, read, strict=True):
        assert np.abs(own.q - log.q).max() < 2e-3
        level = np.std((noisy.q - own.q)[200:-200], axis=0)
        np.testing.assert_allclose(level, after.encoder[0], rtol=0.3)
    assert [t.effect.name for t in after.truth.terms] == [
        t.effect.name for t in after.nominal.model.terms
    ]
    # Noise, not the spring: 20 N m/rad over half a radian.
    assert np.sqrt(after.noise[0, 0]) < 1.5


def test_the_nominal_model_is_redrawn_around_the_truth():
    after, _ = made_after()
    rng = np.random.default_rng(3)
    drawn = [redrawn(after, rng).model.inertial for _ in range(40)]
    spread = np.std(drawn, axis=0)
    moved = spread > 0
    assert moved.any()
    masses = slice(0, None, 10)
    expected = after.scale * after.truth.inertial[masses]
    np.testing.assert_allclose(spread[masses], expected, rtol=0.6)


def test_a_block_is_the_same_for_the_same_seed_and_names_nothing():
    after, _ = made_after()
    first, again = (block(after, 4, 0, 2) for _ in range(2))
    assert first == again
    assert not any(d.named for d in first)
    assert all(d.net < d.nats for d in first)
    assert max(d.net for d in first) < 10


def test_a_diagnosis_with_a_null_has_a_p_value_and_says_which():
    after, case = made_after()
    null = null_of(np.linspace(-3, 6, 19), key=after.key)
    verdict = diagnose_case(case, null=[null]).verdict
    assert names(verdict) == [("spring", (1,))]
    assert verdict.effects[0].evidence.p_value == pytest.approx(1 / 20)
    assert any(w.startswith("null n: 0 of 19") for w in verdict.warnings)
    other = replace(null, key=replace(after.key, robot="b" * 64))
    with pytest.raises(InputError, match="another robot"):
        diagnose_case(case, null=other)
