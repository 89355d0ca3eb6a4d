"""Bodies that can exist: the nearest ones to a fit, and that every model has them."""

from dataclasses import replace

import numpy as np
import pytest

from residual.diagnosis.diagnose import diagnose
from residual.effects import load_effects
from residual.evidence.fit import PossibleModel
from residual.model.bodies import LEAST, build_body_sums
from residual.model.bodies import find_nearest_possible as nearest_possible
from residual.model.model import Model, Term
from residual.model.records import BodyCorrection
from residual.robot.dynamics import compute_base_parameters, read_inertial_parameters
from residual.robot.dynamics import replace_inertial_parameters as with_inertial
from residual.verdict.diagnosis import replace_by_model_values
from residual.verdict.result import Finding, Parameter
from tests.exports.bodies import cases, diagnosed, refusals
from tests.residual.arms import SEVEN, arm, bare_irb140, plain_logs

FEW = list(cases(6))[3:]  # a load, a link and both on arms that are 1 and 3 % off


def bare(robot, *terms):
    return Model(robot, read_inertial_parameters(robot.model), terms)


def load(robot, mass, inertia=(0.0,) * 6):
    effect = load_effects()["payload"]
    values = np.array([mass, 0.02, -0.01, 0.08, *inertia])
    theta, _ = effect.from_values(values, robot)
    return Term(effect, (robot.dof - 1,), (), np.asarray(theta))


def rooted(rng, size):
    """A well-conditioned information of unequal knowledge, as an upper triangle."""
    return np.linalg.qr(rng.normal(size=(2 * size, size)) * rng.uniform(1, 30, size))[1]


def test_bodies_that_can_exist_stay_bit_for_bit(rng):
    model = bare(bare_irb140(), load(bare_irb140(), 2.0, (0.01, 0, 0, 0.01, 0, 0.01)))
    bodies, best = build_body_sums(model), model.coefficients()
    assert bodies.names[-1] == "the load"
    assert bodies.list_impossible(best) == ()
    assert nearest_possible(bodies, best, rooted(rng, len(best))) is best


def test_it_is_what_a_solver_of_cones_finds(rng):
    cp = pytest.importorskip("cvxpy")
    model = bare(arm(SEVEN))
    bodies, start = build_body_sums(model), model.coefficients()
    root, best = rooted(rng, len(start)), start + 0.2 * rng.normal(size=len(start))
    x = cp.Variable(len(start))
    held = []
    for sums, scale in zip(bodies.sums, bodies.scale, strict=True):
        m, hx, hy, hz, xx, xy, yy, xz, yz, zz = (row @ x for row in sums)
        half = (xx + yy + zz) / 2
        pseudo = cp.bmat(
            [
                [half - xx, -xy, -xz, hx],
                [-xy, half - yy, -yz, hy],
                [-xz, -yz, half - zz, hz],
                [hx, hy, hz, m],
            ]
        )
        unit = np.diag(1 / scale)
        held.append(unit @ pseudo @ unit >> LEAST * np.eye(4))
    problem = cp.Problem(cp.Minimize(cp.sum_squares(root @ (x - best))), held)
    problem.solve(solver=cp.CLARABEL)
    solution = nearest_possible(bodies, best, root)
    own = float(np.sum((root @ (solution - best)) ** 2))
    assert own == pytest.approx(problem.value, rel=1e-5)


def test_what_moves_no_torque_moves_first(rng):
    """Impossible only in the null space of the base parameters: at no torque at all."""
    model = bare(arm(SEVEN))
    base, true = compute_base_parameters(model.robot.model), model.coefficients()
    _, _, ways = np.linalg.svd(base.mapping)
    silent = ways[len(base) :]
    best = true + 0.5 * silent.T @ rng.normal(size=len(silent))
    assert build_body_sums(model).list_impossible(best)
    seen = 1e4 * base.mapping
    root = np.linalg.cholesky(seen.T @ seen + np.eye(len(true))).T
    solution = nearest_possible(build_body_sums(model), best, root)
    size = np.abs(base.mapping @ true).max()
    assert np.abs(base.mapping @ (solution - true)).max() < 1e-5 * size


@pytest.mark.long  # of arms of two joints, in test_verdict
@pytest.mark.parametrize("case", FEW)
def test_every_model_of_a_drawn_arm_loads_elsewhere(case):
    """MuJoCo and Pinocchio take it, and it moves there with the same torque."""
    pytest.importorskip("mujoco")
    diagnosis = diagnosed(case)
    for name in ("identified", "augmented"):
        assert refusals(diagnosis.models[name]) == []


def test_a_finding_of_a_body_says_what_the_model_has():
    """Only where bodies were moved; deviations and other names stay as they were."""
    robot = bare_irb140()
    model = bare(robot, load(robot, 2.0, (0.01, 0, 0, 0.01, 0, 0.01)))
    fitted = {"mass": Parameter(2.2, 0.1, "kg"), "com_z": Parameter(0.1, 0.02, "m")}
    one = Finding("payload", (6,), 1.0, 1, (), fitted, evidence=None)
    possible = PossibleModel(model, BodyCorrection(("the load",), (0.0,), 0.5))
    parameters = replace_by_model_values(one, possible).parameters
    assert parameters["mass"].value == pytest.approx(2.0)
    assert parameters["com_z"].value == pytest.approx(0.08)
    assert parameters["mass"].std == 0.1
    assert replace_by_model_values(one, replace(possible, correction=None)) is one
    other = replace(one, name="spring", joints=(1,))
    assert replace_by_model_values(other, possible) is other


@pytest.mark.long
def test_a_load_that_no_body_is_gets_no_name():
    robot = arm(SEVEN)
    wrong = bare(robot, load(robot, 2.0, (-0.1, 0, 0, -0.1, 0, -0.1))).loaded()
    other = replace(robot, model=with_inertial(robot.model, wrong))
    logs = plain_logs(other, range(7), np.zeros(7))
    logs = [replace(log, q=log.q - 0.1) for log in logs]
    diagnosis = diagnose(robot, logs[:3], (), logs[3:])
    # An offset may be suspected beside it (0.92); no body is.
    assert [e for e in diagnosis.effects if e.probability > 0.95] == []
    assert not {"payload", "link_body"} & {e.name for e in diagnosis.effects}
    assert any("impossible" in line for line in diagnosis.verdict.contradictions)
    assert diagnosis.verdict.bodies.chance < 1e-6
    assert refusals(diagnosis.models["augmented"]) == []
