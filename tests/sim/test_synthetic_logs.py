from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.synthetic.examples import write_hidden
from benchmarks.synthetic.logs import LogPlan, make, make_case
from benchmarks.synthetic.quasi_static import Plant
from residual.robot.robot import load_robot
from sim.engine.plant_records import create_random_stream as make_rng
from sim.plant.typical_sizes import draw_effect

ROBOT = load_robot("irb140")
SHORT = tuple(
    LogPlan(f"{part}_{i}", part, family, duration=3.0)
    for i, (part, family) in enumerate(
        [("fit", "fourier"), ("fit", "cyclic"), ("held_out", "move_stop_move")]
    )
)


def logs(*effects, seed=5):
    hidden = tuple(draw_effect(ROBOT, e, make_rng(seed, e)) for e in effects)
    return make(Plant(ROBOT, hidden, seed), SHORT, seed)


def test_an_effect_does_not_change_noise_or_motion():
    null, one, two = logs(), logs("offset"), logs("offset", "x_random_walk")
    for a, b in zip(null, one, strict=True):
        np.testing.assert_array_equal(a.q, b.q)
        np.testing.assert_array_equal(a.t, b.t)
        change = b.tau - a.tau
        np.testing.assert_allclose(change, change[:1] + 0 * change, atol=1e-9)
    for a, b in zip(null, two, strict=True):
        np.testing.assert_array_equal(a.q, b.q)


def test_the_session_clock_runs_on_through_pauses():
    plan = (LogPlan("before", "baseline", "fourier", duration=3.0), *SHORT)
    case = make_case(Plant(ROBOT, (), 3), plan)
    recordings = [*case.baseline, *case.fit, *case.held_out]
    for before, after in pairwise(recordings):
        assert after.t[0] - before.t[-1] >= 5.0
    assert case.fit[0].t[0] - case.baseline[-1].t[-1] > 3000
    assert len({r.id for r in recordings}) == len(recordings) == 4


def test_the_shipped_example_is_the_demo(tmp_path):
    shipped = Path(__file__).parents[2] / "examples" / "hidden"
    for path in write_hidden(tmp_path, 7, "payload"):
        assert (shipped / path.name).read_text() == path.read_text()
