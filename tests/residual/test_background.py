"""What every joint of a used arm has: tables in the covariance, not in the list."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from residual.close import close_the_loop
from residual.evidence.background import Background, usual_background
from residual.evidence.states import first_design
from residual.model.nominal import prepare_logs, start_nominal
from residual.model.record import from_record, to_record
from residual.signals.split import session_clock
from residual.signals.track import Filters
from sim.records import Hidden
from sim.synthetic.logs import LogPlan, make
from sim.synthetic.plant import Plant
from tests.residual.arms import FAMILIES, Y, Z, arm

FOUR = (Z, Y, Y, Z)
FRICTION = ("viscous", "coulomb", "rotor_inertia")


def tables(rows=60, count=5, strength=3.0, seed=0) -> tuple[Background, np.ndarray]:
    """Random tables, with what each direction of them is worth."""
    rng = np.random.default_rng(seed)
    basis, _ = np.linalg.qr(rng.normal(size=(rows, count)))
    worth = strength * rng.uniform(0.1, 10, count)
    own = Background(
        basis,
        1 - (1 + worth) ** -0.5,
        0.01,
        (),
        np.eye(count),
        np.zeros(0, dtype=int),
        np.zeros((0, count)),
    )
    return own, worth


@given(seed=st.integers(0, 10**6), strength=st.floats(1e-3, 1e3))
def test_whitened_rows_have_the_covariance_of_noise_and_tables(seed, strength):
    own, worth = tables(strength=strength, seed=seed)
    whole = np.eye(60) + (own.basis * worth) @ own.basis.T
    root = own.whiten(np.eye(60))
    assert root @ whole @ root.T == pytest.approx(np.eye(60), abs=1e-8)


@given(seed=st.integers(0, 10**6), strength=st.floats(1e-3, 1e3))
def test_what_was_whitened_can_be_had_back(seed, strength):
    own, _ = tables(strength=strength, seed=seed)
    rows = np.random.default_rng(seed).normal(size=(60, 3))
    assert own.restore(own.whiten(rows)) == pytest.approx(rows, abs=1e-9)


def test_what_a_fit_leaves_teaches_the_tables_as_a_ridge_would():
    own, worth = tables()
    left = np.random.default_rng(1).normal(size=60)
    _, gained = own.learnt(own.whiten(left))
    ridge = worth / (1 + worth) * (own.basis.T @ left)
    # With no tables to hand them out to, they all fall to the joint's own terms.
    free = replace(own, beside=-np.eye(5), own=np.arange(5))
    assert free.learnt(own.whiten(left))[1] == pytest.approx(ridge)
    assert gained.shape == (0,)


def logs_of(background, *hidden, seed=5):
    """Logs of a four-joint arm, ready, and its declared model."""
    robot = arm(FOUR)
    plan = [LogPlan(f"fit_{f}", "fit", f, 10.0, 125.0) for f in FAMILIES]
    made = make(Plant(robot, hidden, seed, background), tuple(plan), seed)
    logs = prepare_logs(robot, made, session_clock(made), Filters())
    return logs, start_nominal(logs, FRICTION)


def test_a_clean_arm_has_none_whatever_one_joint_lacks():
    ripple = Hidden("ripple", (2,), {"amplitude": 4.0, "order": 9.0, "phase": 1.0})
    for hidden in ((), (ripple,)):
        logs, nominal = logs_of("clean", *hidden)
        assert usual_background(first_design(logs, nominal)) == ()


@pytest.mark.parametrize("background", ["workshop", "worn"])
def test_a_used_arm_has_them_on_its_joints(background):
    logs, nominal = logs_of(background)
    made = usual_background(first_design(logs, nominal))
    assert sum(one is not None and one.size > 0 for one in made) >= 3


def test_tables_leave_the_joint_s_own_friction_alone():
    logs, nominal = logs_of("worn")
    design = first_design(logs, nominal)
    made = usual_background(design)
    for j, one in enumerate(made):
        place, have = design.present(j, design.nominal)
        own = ~np.isin(design.nominal[have], design.inertial)
        friction = design.columns(j, place[own])
        assert one.whiten(friction) == pytest.approx(friction, abs=1e-8)


def case_of(background, hidden=(), seed=5):
    """Baseline, new and held-out logs of one arm."""
    robot = arm(FOUR)
    logs = {}
    for part, effects in (("baseline", ()), ("fit", hidden), ("held_out", hidden)):
        kinds = FAMILIES if part != "held_out" else FAMILIES[:1]
        plan = [LogPlan(f"{part}_{f}", part, f, 10.0, 125.0) for f in kinds]
        made = make(Plant(robot, tuple(effects), seed, background), tuple(plan), seed)
        logs[part] = made
    return robot, logs


def test_a_used_arm_that_did_not_change_gets_no_name_and_keeps_its_tables():
    robot, logs = case_of("workshop")
    found = close_the_loop(
        robot, logs["fit"], logs["baseline"], logs["held_out"], FRICTION
    )
    assert found.verdict.effects == ()
    model = found.models["augmented"]
    assert model.tables
    again = from_record(to_record(model))
    log = logs["held_out"][0]
    assert again.predict(log) == pytest.approx(model.predict(log), abs=0)
    least = {d.name: d.value for d in found.verdict.minimum_detectable}
    assert 0 < least["drift"] < 0.5


def test_a_change_of_a_used_arm_is_the_only_name():
    payload = Hidden(
        "payload", (4,), {"mass": 2.0, "com_x": 0.05, "com_y": 0.02, "com_z": 0.1}
    )
    robot, logs = case_of("workshop", (payload,))
    found = close_the_loop(
        robot, logs["fit"], logs["baseline"], logs["held_out"], FRICTION
    )
    assert [f.name for f in found.verdict.effects] == ["payload"]
    mass = found.verdict.effects[0].parameters["mass"]
    assert abs(mass.value - 2.0) < 3 * mass.std
