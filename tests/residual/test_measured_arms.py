"""Measured logs of two arms; they are no part of the project, and skipped without."""

import os
from pathlib import Path

import numpy as np
import pytest

from residual.diagnosis.diagnose import diagnose
from residual.robot.robot import load_robot
from tests.residual.arms import names
from warehouse.logs import read_log

ROOT = Path(__file__).parents[2]
DATA = Path(os.environ.get("MODELGAP_DATA") or ROOT.parent / "shared" / "data")
CASES = DATA.parent / "cases"  # small inputs on which the program was wrong
pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(
        not (DATA / "kr300" / "kr300.urdf").exists(),
        reason="no measured logs: neither ../shared/data nor $MODELGAP_DATA",
    ),
]
BALANCER = ("balancer", (2,))
DAYS = ("feb19", "feb19_load")  # the second with a load, which its owners weighed
WEIGHED = 2.805  # kg
REACHED = np.array((7.7, 12.8, 6.4, 19.1, 11.2, 14.8))  # by an earlier version [%]


def classes(effect) -> set[tuple[str, tuple[int, ...]]]:
    return {(e.name, e.joints) for e in (effect, *effect.equivalent)}


def verdict_of(name, *files):
    robot = load_robot(DATA / name / f"{name}.urdf")
    *fit, last = (read_log(str(DATA / name / f"{f}.csv"), robot)[0] for f in files)
    return diagnose(robot, fit, held_out=[last]).verdict


def test_kr300_has_a_balancer_on_axis_2_and_its_error_there_falls():
    verdict = verdict_of("kr300", "run_A", "run_B", "run_C")
    assert BALANCER in classes(verdict.effects[0])
    assert all(2 in e.joints for e in verdict.effects if BALANCER in classes(e))
    moving = verdict.error.moving
    # The scale that predicts best is wide: bodies take up much of what it does.
    assert moving["nominal"][1] > 20
    assert moving["augmented"][1] < min(8, moving["identified"][1])
    for j in (0, 2, 3, 4, 5):
        assert moving["augmented"][j] < 1.02 * moving["identified"][j]
    assert (np.array(verdict.error.filtered["augmented"]) < 1.05 * REACHED).all()


def test_friction_by_load_is_named_on_a_ur10e_and_halves_what_is_left():
    """And friction of joint 1 not linear in speed, which other days bear out."""
    verdict = verdict_of("ur10e", "feb10", "feb12")
    assert ("load_friction", (2, 3)) in names(verdict)
    assert {n for n, _ in names(verdict)} <= {"load_friction", "quadratic_viscous"}
    assert any(n == "quadratic_viscous" and 1 in j for n, j in names(verdict))
    assert all(e.evidence.held_out == "confirmed" for e in verdict.effects)
    moving = verdict.error.moving
    for joint in (1, 2):
        assert moving["augmented"][joint] < 0.7 * moving["identified"][joint]
    assert verdict.error.worse == ()


@pytest.mark.long
@pytest.mark.parametrize(("days", "sign"), [(DAYS, 1), (DAYS[::-1], -1)])
def test_a_load_that_came_or_went_is_a_payload_of_its_weight(days, sign):
    robot = load_robot(DATA / "ur10e" / "ur10e.urdf")
    before, now = (read_log(f"{DATA}/ur10e/{d}.csv", robot)[0] for d in days)
    verdict = diagnose(robot, [now], [before]).verdict
    assert names(verdict) == [("payload", (6,))]
    assert verdict.effects[0].evidence.held_out == "confirmed"
    mass = verdict.effects[0].parameters["mass"].value
    assert mass == pytest.approx(sign * WEIGHED, rel=0.1)


@pytest.mark.skipif(not (CASES / "balancer_not_named").is_dir(), reason="no cases beside the logs")
def test_a_balancer_that_cancels_the_weight_of_its_joint_is_named():
    """Noise and coefficients have two fixed points; the search restarts in the first.

    From the noise of the arm without it the balancer is worth nothing.
    """
    robot, folder = load_robot("irb140"), CASES / "balancer_not_named"
    fit = [read_log(str(folder / f"{name}.csv"), robot)[0] for name in "AB"]
    last = read_log(str(folder / "C.csv"), robot)[0]
    verdict = diagnose(robot, fit, held_out=[last]).verdict
    assert names(verdict) == [("balancer", (3,))]
    overall = verdict.error.overall
    assert overall["augmented"] < 0.1 * overall["identified"]
