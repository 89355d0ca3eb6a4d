"""The figures of the proof, by hand; what is held out, and the clock of a session."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from residual.model.compare import compute_model_errors as model_errors
from residual.model.compare import compute_moving_error, prepare_held_out
from residual.model.model import Model
from residual.robot.dynamics import compute_inverse_dynamics, read_inertial_parameters
from residual.signals.splitting import find_session_start, split_off_last_quarter
from residual.signals.track import FilterSettings
from tests.residual.arms import arm, recording, smooth_motion


def log(start, end, label="log", rate=100):
    t = start + np.arange(round((end - start) * rate) + 1) / rate
    q = 0.3 * np.sin(np.outer(t - start, (1.0, 1.3)))
    return recording(t, q, 0 * q, label)


@pytest.fixture
def proof():
    """Two logs whose measured torque is the model's, 10 % larger on joint 2."""
    robot = arm()
    model = Model(robot, read_inertial_parameters(robot.model), (), np.full(2, 0.01))
    logs = []
    for k in range(2):
        t = 50.0 * k + np.arange(1000) / 250
        q, qd, qdd = smooth_motion(robot, t)
        tau = compute_inverse_dynamics(robot.model, q, qd, qdd) * [1.0, 1.1]
        logs.append(recording(t, q, tau, f"log{k}"))
    return model, logs


def errors_of(model, logs):
    return model_errors({"it": model}, prepare_held_out(logs, model), FilterSettings())[0]["it"]


def test_a_scaled_torque_has_the_error_of_its_scale(proof):
    model, logs = proof
    for kind in ("raw", "filtered", "moving"):
        errors = errors_of(model, logs).per_joint(kind)
        assert_allclose(errors, [0, 100 * 0.1 / 1.1], atol=0.3)
    silent = replace(model, inertial=0 * model.inertial)
    assert_allclose(errors_of(silent, logs).per_joint("raw"), 100.0)


def test_noise_above_the_filter_counts_in_the_raw_error_only(proof):
    model, logs = proof
    hum = [replace(r, tau=r.tau + 8 * np.sin(377 * r.t)[:, None]) for r in logs]
    errors = errors_of(model, hum)
    assert errors.per_joint("raw")[0] > 10
    for kind in ("filtered", "moving"):
        assert_allclose(errors.per_joint(kind), [0, 100 * 0.1 / 1.1], atol=0.5)


def test_proof_curves_are_those_that_the_errors_are_taken_of(proof):
    model, logs = proof
    seen = prepare_held_out(logs, model)
    errors, curves = model_errors({"it": model}, seen, FilterSettings())
    miss = sum(((c.tau - c.tau_hat["it"]) ** 2).sum(axis=0) for c in curves)
    assert_allclose(miss, errors["it"].miss["filtered"])
    moving = sum((((c.tau - c.tau_hat["it"]) * c.moving) ** 2).sum(axis=0) for c in curves)
    assert_allclose(moving, errors["it"].miss["moving"])
    assert_allclose(compute_moving_error(model, seen).sum(axis=0), moving)


def test_the_last_quarter_of_the_longest_log_is_held_out():
    short, long = log(0, 6, "A"), log(10, 30, "B")
    fit, held_out = split_off_last_quarter([short, long])
    (tail,) = held_out
    assert fit[0] is short
    assert fit[1].id == "B"
    assert tail.id == "B (last quarter)"
    assert len(fit[1].t) + len(tail.t) == len(long.t)
    assert fit[1].t[-1] < tail.t[0] == pytest.approx(25.0)
    np.testing.assert_array_equal(np.concatenate([fit[1].q, tail.q]), long.q)


@pytest.mark.parametrize(
    ("spans", "clock"),
    [
        ([(0, 5)], 0.0),
        ([(100, 105), (110, 115)], 100.0),
        ([(110, 115), (100, 105)], 100.0),
        ([(0, 5), (0, 5)], None),
        ([(0, 5), (4, 9)], None),
        ([(3, 8), (0, 2), (2.5, 2.9)], 0.0),
    ],
)
def test_a_session_has_a_clock_where_the_times_show_the_order_of_its_logs(spans, clock):
    logs = [log(a, b, str(i)) for i, (a, b) in enumerate(spans)]
    assert find_session_start(logs) == clock
