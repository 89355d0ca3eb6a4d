"""What is hidden so that it can be seen: by the plant's own torque, in any draw."""

import numpy as np
import pytest

from benchmarks.synthetic.visible import (
    OF_A_NAME,
    SEEDS,
    VISIBLE,
    Stage,
    draw_visible,
    larger,
    share,
    stages_of,
)
from flows.steps import demo
from sim.draw import draw_hidden, usual_effects
from sim.engine.records import HIDDEN, PlantEffect, TrajectorySpec, stream
from sim.plant import tables as at
from sim.plant.catalogue import check_effect, kinds
from sim.trajectories import make_reference
from sim.trajectories.fourier import draw_slow
from tests.sim.plant_cases import NOMINAL_ARM, ROBOT, drive, effect

SPEED = 0.2  # rad/s
DRAWN = range(1)


def slow(seed: int = 1, duration: float = 10.0, rate: float = 100.0):
    rows = draw_slow(ROBOT, duration, SPEED, stream(seed, "slow"))
    spec = TrajectorySpec("fourier", duration, 1, seed, rows)
    return make_reference(ROBOT, spec, rate)


def stops(seed: int = 1):
    spec = TrajectorySpec("move_stop_move", 10.0, seed=seed)
    return make_reference(ROBOT, spec, 100.0)


@pytest.fixture(scope="module")
def stages():
    """Two motions of each seed: one that creeps and one that hurries."""
    return {
        seed: [Stage.of(ROBOT, slow(seed)), Stage.of(ROBOT, stops(seed), 30.0)]
        for seed in DRAWN
    }


@pytest.mark.parametrize("name", usual_effects())
def test_whatever_is_drawn_is_five_per_cent_of_a_joint_that_moves(name, stages):
    for seed in DRAWN:
        hidden = draw_visible(ROBOT, stream(seed, "hidden"), stages[seed], name)
        check_effect(hidden, ROBOT)
        assert hidden.name == name
        assert share(ROBOT, hidden, stages[seed]) >= VISIBLE


@pytest.mark.parametrize(
    ("hidden", "close"),
    [
        (effect("stribeck", 2, level=8.0, velocity=0.08), 0.15),
        (effect("load_friction", 2, coefficient=0.1), 0.15),
    ],
)
def test_the_share_is_that_of_the_arm_in_the_engine(hidden, close, compiled_plant):
    """Of its own torque with and without, along the same slow motion."""
    reference = slow(duration=6.0, rate=1000.0)
    stage = Stage.of(ROBOT, slow(duration=6.0))
    own, plain = (
        drive(*effects, reference=reference, **NOMINAL_ARM).rows[::10, at.DRIVE]
        for effects in ((hidden,), ())
    )
    joint = hidden.joints[0] - 1
    rows = stage.moves[:, joint]
    there = np.sqrt(np.mean((own - plain)[rows, joint] ** 2))
    there /= np.sqrt(np.mean(plain[rows, joint] ** 2))
    assert share(ROBOT, hidden, [stage]) == pytest.approx(there, rel=close)


TABLE = demo.visible()


def test_the_demonstration_knows_what_shows_of_every_effect():
    assert set(TABLE) == {"", *kinds()}
    for name, own in TABLE.items():
        assert own["seeds"] == (OF_A_NAME if name else SEEDS)
        for seed, (hidden, joints, values) in own["larger"].items():
            usual = draw_hidden(ROBOT, stream(int(seed), HIDDEN), name or None)
            assert hidden == usual.name
            assert values.keys() == dict(usual.parameters).keys()
            found = PlantEffect(hidden, tuple(joints), tuple(values.items()))
            check_effect(found, ROBOT)


def test_the_table_is_what_is_drawn_on_the_motions_of_the_demonstration():
    stages = stages_of(1)
    for name in ("", "delay", "payload", "viscous_asymmetry"):
        known = TABLE[name]["larger"].get("1")
        made = larger(name, 1, stages)
        assert (made is None) == (known is None)
        if made is not None:
            assert made[:2] == known[:2]
            assert made[2] == pytest.approx(known[2], rel=1e-6)


def test_what_is_hidden_is_that_of_the_table_or_a_usual_draw_and_begins_again():
    def hidden(seed, name=None):
        (drawn,) = demo.specs(demo.Demo(seed, name))[0][1].plant_spec().effects
        return [drawn.name, list(drawn.joints), dict(drawn.parameters)]

    assert hidden(1) == TABLE[""]["larger"]["1"]
    assert hidden(1, "delay") == hidden(1 + OF_A_NAME, "delay")
    usual = draw_hidden(ROBOT, stream(7, HIDDEN))
    assert hidden(7) == [usual.name, list(usual.joints), dict(usual.parameters)]
    assert hidden(7) == hidden(7 + SEEDS)
