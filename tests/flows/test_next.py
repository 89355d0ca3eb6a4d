"""The motion that is chosen: the soonest of all that were ranked, within all limits."""

import numpy as np
import pytest

from flows.steps.next import rank_motions
from residual.planning.next_experiment import SURE
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import load_robot
from sim.engine.geometry import MARGIN, compute_clearances
from sim.engine.geometry import build_arm_capsules as arm_capsules
from sim.engine.plant_records import TrajectorySpec
from sim.trajectories import plan_reference_motion as plan_motion
from sim.trajectories.excitation import draw_feasible_series, export_series_coefficients
from sim.trajectories.planning_limits import build_workspace
from tests.residual.planning.questions import robot_and_question


@pytest.fixture(scope="module")
def robot_and_ranking():
    robot, question = robot_and_question("spring", 2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("flows.steps.next.WAVES", 2)
        patch.setattr("flows.steps.next.PLACES", 2)
        return robot, rank_motions(question, robot, 12.0, seed=3)


def test_the_best_settles_the_question_and_none_of_the_others_sooner(robot_and_ranking):
    _, ranking = robot_and_ranking
    best, *others = ranking.ranked
    assert 1.0 < best.after <= 12.0
    assert SURE <= best.prospect.chance <= 1
    assert all(best.after <= (one.after or np.inf) for one in others)
    rivals = ranking.document(None)["rivals"]
    assert {r["name"] for r in rivals} == {"spring", "balancer"}


def test_it_keeps_all_limits_over_the_whole_motion(robot_and_ranking):
    """At 2 kHz, which is finer than the checks that it was planned with."""
    robot, ranking = robot_and_ranking
    motion = plan_motion(robot, ranking.best.spec, 2000.0)
    assert motion.t[-1] == 12.0
    assert (motion.q >= robot.lower).all()
    assert (motion.q <= robot.upper).all()
    assert (np.abs(motion.qd) <= robot.velocity_limit).all()
    torque = compute_inverse_dynamics(robot.model, motion.q, motion.qd, motion.qdd)
    assert (np.abs(torque) <= robot.torque_limit).all()
    assert compute_clearances(arm_capsules(robot.model), motion.q[::10]).min() >= MARGIN


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[:-1], "expected 9 rows of 6 numbers, got 8 rows of 6"),
        (lambda rows: [row[:5] for row in rows], "got 9 rows of 5"),
        (lambda rows: [[np.inf] * 6, *rows[1:]], "expected finite numbers"),
        (lambda rows: [[9.0] * 6, *rows[1:]], "breaks its range limit"),
    ],
)
def test_coefficients_that_are_no_motion_are_refused(change, message):
    robot = load_robot("irb140")
    series = draw_feasible_series(build_workspace(robot, 6.0), np.random.default_rng(3))
    rows = tuple(tuple(r) for r in change([list(r) for r in export_series_coefficients(series)]))
    with pytest.raises(Exception, match=message):
        plan_motion(robot, TrajectorySpec("fourier", 12.0, 2, 0, rows), 100.0)
