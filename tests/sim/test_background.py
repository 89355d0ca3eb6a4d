"""The background of an arm in use: each part measured from the torque that it makes."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.synthetic.background import (
    FrictionMotion,
    compute_background_torque,
    compute_cogging,
)
from benchmarks.synthetic.logs import LogPlan, make
from benchmarks.synthetic.quasi_static import (
    Plant,
    background_of,
    true_friction,
    true_torque,
)
from residual.errors import InputError
from sim.engine.plant_records import SyntheticEffect
from sim.plant.joint_background import draw_background, simulate_torque_logging
from sim.plant.typical_sizes import estimate_typical_sizes
from tests.sim.plant_cases import ROBOT, motion

MOTION = motion(duration=6.0, rate=250.0)
SEEDS = range(1, 5)
SCALE = {"workshop": 1.0, "worn": 2.0}
every_arm = pytest.mark.parametrize(
    ("seed", "word"), [(seed, word) for seed in SEEDS for word in SCALE]
)
PLAN = (LogPlan("fit_1", "fit", "cyclic", 6.0),)


def arm(seed, word):
    plant = Plant(ROBOT, (), seed, word)
    return background_of(plant), true_friction(plant)


def torque(background, friction, qd, load=0.0, worked=0.0):
    """Return cold-or-warm friction beside the plain one, cogging taken out. (n, dof).

    Sliding steadily, at one speed per sample and all joints, too briefly to warm.
    """
    qd = np.asarray(qd, dtype=float)[:, None] * np.ones(ROBOT.dof)
    still = np.zeros_like(qd)
    t = 1e-6 * np.arange(len(qd))
    levels = (friction.coulomb, friction.viscous, np.ones(ROBOT.dof), worked)
    rubbing = FrictionMotion(t, still, qd, np.sign(qd), still + load, *levels)
    return compute_background_torque(background, rubbing).torque - compute_cogging(
        background, still
    )


def between(value, low, high, scale):
    assert np.all(value >= scale * low * (1 - 1e-6)), value
    assert np.all(value <= scale * high * (1 + 1e-6)), value
    assert np.ptp(value) > 0  # drawn joint by joint


@every_arm
def test_extra_friction_at_low_speed_is_a_part_of_coulomb(seed, word):
    background, friction = arm(seed, word)
    even = replace(background, lean=np.zeros(ROBOT.dof))
    slow, fast = (torque(even, friction, [s, s])[0] for s in (1e-6, 1e4))
    between((slow - fast) / friction.coulomb, 0.15, 0.5, SCALE[word])


@every_arm
def test_friction_grows_with_load_by_a_part_of_it_and_not_in_proportion(seed, word):
    background, friction = arm(seed, word)
    even, span = replace(background, lean=np.zeros(ROBOT.dof)), background.span
    none, half, full = (
        torque(even, friction, [1.0, 1.0], load * span)[0] for load in (0, 0.5, 1)
    )
    slope = (full - none) / span
    # What presses without load is a part of the law; the rest lies a little below it.
    assert np.all(slope > SCALE[word] * 0.01 * 0.8)
    assert np.all(slope < SCALE[word] * 0.05)
    assert np.all((half - none) / (full - none) > 0.52)  # a line would give one half


@every_arm
def test_dry_friction_leans_to_one_side(seed, word):
    background, friction = arm(seed, word)
    fast = 1e4
    plain = friction.coulomb + friction.viscous * fast
    forward, backward = (
        np.abs(s * plain + torque(background, friction, [s * fast] * 2)[0])
        - friction.viscous * fast
        for s in (1, -1)
    )
    lean = (forward - backward) / (forward + backward)
    assert np.all(np.abs(lean) <= SCALE[word] * 0.08 + 1e-6)
    assert np.abs(lean).max() > 0.005 * SCALE[word]


@every_arm
def test_friction_is_less_when_warm_and_takes_its_time(seed, word):
    background, friction = arm(seed, word)

    def friction_at(worked):
        rubbed = torque(background, friction, [1.0, 1.0], worked=worked)[0]
        return rubbed + friction.coulomb + friction.viscous

    cold, warm = friction_at(0.0), friction_at(1e5)
    loss = 1 - warm / cold
    between(loss, 0.05, 0.2, SCALE[word])
    # Two thirds of it come within the time constants of oil and housing.
    assert np.all(1 - friction_at(400.0) / cold > 0.6 * loss)
    assert np.all(1 - friction_at(25.0) / cold < 0.6 * loss)


@every_arm
def test_ripple_is_a_part_of_the_torque_range_and_no_single_wave(seed, word):
    background, _ = arm(seed, word)
    turn = np.linspace(-np.pi, np.pi, 20001)[:, None] * np.ones(ROBOT.dof)
    wave = compute_cogging(background, turn)
    ratio = np.abs(wave).max(axis=0) / estimate_typical_sizes(ROBOT).torque
    between(ratio, 0.003, 0.012, SCALE[word])
    power = np.abs(np.fft.rfft(wave - wave.mean(axis=0), axis=0)) ** 2
    for j in range(ROBOT.dof):
        largest = power[:, j].argmax()
        near = slice(max(largest - 3, 0), largest + 4)
        assert power[near, j].sum() < 0.9 * power[:, j].sum()


@pytest.mark.parametrize("word", SCALE)
def test_drives_report_more_or_less_than_they_give(word):
    for seed in SEEDS:
        torques = true_torque(Plant(ROBOT, (), seed, word), MOTION, "log")
        given = torques.rigid + torques.base + torques.background.torque
        gain = (torques.tau / given).mean(axis=0) - 1
        assert np.all(np.abs(gain) <= SCALE[word] * 0.04 + 1e-9)
        assert np.abs(gain).max() > 0.01


def test_gears_twist_with_their_load_and_harden():
    for seed in SEEDS:
        torques = true_torque(Plant(ROBOT, (), seed, "workshop"), MOTION, "log")
        load = torques.rigid / estimate_typical_sizes(ROBOT).torque
        lead = torques.reading - MOTION.q
        for j in range(5):  # the last one carries next to nothing
            felt = np.abs(load[:, j]) > 1e-4
            twist = lead[felt, j] / load[felt, j]
            # A gear that hardens gives less than that under the most.
            assert 0.5 * 3e-4 <= twist.min() <= twist.max() <= 1.5e-3 * (1 + 1e-6)
        heavy = np.abs(load[:, 1]).argmax()
        soft = np.abs(np.abs(load[:, 1]) - 0.05).argmin()
        give = lead[:, 1] / load[:, 1]
        assert give[heavy] < 0.95 * give[soft]  # a linear spring: equal


@pytest.mark.parametrize(("word", "corner"), [("workshop", 40.0), ("worn", 20.0)])
def test_torque_is_logged_late_and_in_steps(word, corner):
    background, _ = arm(1, word)
    t = np.arange(20000) / 5000.0
    wave = np.sin(2 * np.pi * corner * t)[:, None] * background.span
    log = simulate_torque_logging(background, wave, 5000.0)
    ratio = log[10000:].std(axis=0) / wave[10000:].std(axis=0)
    np.testing.assert_allclose(ratio, 2**-0.5, rtol=0.03)  # 3 dB at the corner
    steps = log / (SCALE[word] * 1e-3 * background.span)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


def test_an_arm_keeps_its_background_and_another_has_another():
    one, again = (arm(3, "workshop")[0].drawn for _ in range(2))
    other = arm(4, "workshop")[0].drawn
    assert all(np.array_equal(one[key], again[key]) for key in one)
    assert not np.array_equal(one["level"], other["level"])
    hidden = SyntheticEffect("offset", (2,), {"level": 3.0})
    changed = background_of(Plant(ROBOT, (hidden,), 3, "workshop")).drawn
    assert all(np.array_equal(one[key], changed[key]) for key in one)


def test_a_clean_arm_is_what_it_was():
    """Figures of the version before there was a background."""
    log = make(Plant(ROBOT, (), 2, "clean"), PLAN, 2)[0]
    assert np.array_equal(log.tau, make(Plant(ROBOT, (), 2), PLAN, 2)[0].tau)
    before = (44.976943418502714, 59.734060523380585, 58.5828019034465, 97.565831253829)
    np.testing.assert_allclose(log.tau[100::400, 1], before, rtol=1e-12)


def test_an_unknown_word_is_refused_with_what_was_expected():
    with pytest.raises(InputError, match=r"'dusty'.*clean, workshop, worn"):
        draw_background(ROBOT, "dusty", 1, np.ones(6))
