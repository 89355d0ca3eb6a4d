"""What a leftover depends on, and the tables that correct it."""

import numpy as np
import pytest

from residual.diagnosis.outcome import search_effects
from residual.diagnosis.unexplained import (
    DIRECTION,
    PLAIN,
    SUM,
    JointResidual,
    ResidualTimeSeries,
    StateVariable,
    analyze_joint_remainders,
    find_spectral_line,
    fit_correction,
    fit_residual_curves,
)
from residual.model.compare import compute_model_errors, prepare_held_out
from residual.model.nominal import DEFAULT_DECLARED, prepare_fit_logs
from residual.model.nominal import build_free_nominal as free_nominal
from residual.signals.splitting import find_session_start
from residual.signals.track import FilterSettings
from tests.residual.arms import arm, plain_logs, quiet


def line(left):
    t = np.concatenate([30 * k + np.arange(N) * STEP for k in range(LOGS)])
    log = np.repeat(np.arange(LOGS), N)
    return ResidualTimeSeries(t, left, log, float((left**2).sum()), 8.0)


LOGS, LENGTH, STEP = 5, 20.0, 0.05
N = int(LENGTH / STEP)


def motion(rng, memory=1.5):
    """A smooth random motion of five logs, and its speed. Shapes (n,)."""
    t = np.arange(N) * STEP
    q, qd = [], []
    for _ in range(LOGS):
        w = 2 * np.pi * rng.uniform(0.3, 1.2, 4) / memory
        phase = rng.uniform(0, 2 * np.pi, 4)
        q.append(np.sin(np.outer(t, w) + phase).sum(axis=1) / 2)
        qd.append((w * np.cos(np.outer(t, w) + phase)).sum(axis=1) / 2)
    return np.concatenate(q), np.concatenate(qd)


def red(rng, memory):
    """Noise of unit size that remembers itself for some rows, log by log."""
    a, out = np.exp(-1 / memory), []
    for _ in range(LOGS):
        x = rng.normal(size=N)
        for i in range(1, N):
            x[i] = a * x[i - 1] + np.sqrt(1 - a**2) * x[i]
        out.append(x)
    return np.concatenate(out)


def rows_of(left, memory=10.0, noise=0.0):
    log = np.repeat(np.arange(LOGS), N)
    return JointResidual(left, log, log, memory, float((left**2).sum() - noise**2 * len(left)))


def variables(rng):
    q, qd = motion(rng)
    other, speed = motion(rng)
    side = (qd > 0).astype(int)
    return [
        StateVariable("q", (0,), PLAIN, q),
        StateVariable("q", (0,), DIRECTION, q, side),
        StateVariable("qd", (0,), PLAIN, qd),
        StateVariable("q", (1,), PLAIN, other),
        StateVariable("qd", (1,), PLAIN, speed),
        StateVariable("q", (0, 1), SUM, q + other),
    ]


@pytest.mark.parametrize(
    ("number", "shape"),
    [
        (0, lambda v: np.maximum(v.values, 0)),
        (1, lambda v: np.where(v.side, 1, -1) * v.values),
        (4, lambda v: np.cos(v.values)),
        (5, lambda v: np.cos(9 * v.values)),
    ],
    ids=["a stop", "friction over position", "another joint's speed", "the sum"],
)
def test_the_variable_that_a_leftover_is_made_of_comes_first(rng, number, shape):
    choice = variables(rng)
    truth = shape(choice[number])
    truth = (truth - truth.mean()) / truth.std()
    left = truth + 0.5 * red(rng, 3)
    curves_found, rest = fit_residual_curves(rows_of(left, noise=0.5), choice)
    assert curves_found[0].variable is choice[number]
    assert curves_found[0].share == pytest.approx(1, abs=0.25)
    assert rest.std() < 0.75


@pytest.mark.parametrize("seed", range(2))
def test_a_leftover_that_only_remembers_itself_depends_on_nothing(seed):
    """As slow as the motion: a curve fits it well, and predicts other logs badly."""
    rng = np.random.default_rng(seed)
    left = red(rng, 40)
    curves_found, rest = fit_residual_curves(rows_of(left, memory=80.0), variables(rng))
    assert curves_found == []
    np.testing.assert_array_equal(rest, left)


@pytest.mark.parametrize("frequency", [0.31, 2.7, 6.4])
def test_a_wave_in_time_is_found_with_its_frequency(rng, frequency):
    t = line(np.zeros(LOGS * N)).t
    left = np.sqrt(2) * np.sin(2 * np.pi * frequency * t) + 0.7 * red(rng, 3)
    wave = find_spectral_line(line(left))
    assert wave.frequency == pytest.approx(frequency, abs=0.5 / LENGTH)
    # The red noise of one draw shares some of the band.
    assert wave.share == pytest.approx(1 / 1.49, abs=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_red_noise_is_no_wave(seed):
    assert find_spectral_line(line(red(np.random.default_rng(seed), 15))) is None


# Tables on top of a model: they help where the state tells, and are none elsewhere.


def stopped(count=6):
    """Logs of two joints with a stop on joint 2, which no effect describes."""
    out = []
    for log in plain_logs(arm(), [0, 1], [0.0, 0.0], count=count):
        tau = log.tau.copy()
        q = log.q[:, 1]
        tau[:, 1] += 12 * np.maximum(q - 0.3, 0) + 8 * np.maximum(-0.2 - q, 0) ** 2
        out.append(type(log)(log.id, log.robot, log.t, log.q, tau))
    return out


def test_what_the_position_makes_is_corrected_on_logs_that_nobody_saw():
    every = stopped()
    fit, held = every[:4], every[4:]
    logs = prepare_fit_logs(arm(), fit, find_session_start(every), FilterSettings())
    nominal = free_nominal(logs, DEFAULT_DECLARED)
    outcome = search_effects(logs, nominal, quiet)
    design = outcome.design
    left = analyze_joint_remainders(design, logs.tracks, outcome.fit, outcome.adequacy)
    model = outcome.model(outcome.fit).model
    tables = fit_correction(model, logs.tracks, left)
    models = {"augmented": model, "plsr": tables}
    errors, _ = compute_model_errors(models, prepare_held_out(held, nominal.model), logs.filters)
    errors = {k: e.per_joint("filtered") for k, e in errors.items()}
    assert outcome.named == ()
    assert [one.joint for one in left] == [1]
    assert (left[0].curves[0].variable.on, left[0].kind) == ("q", "repeatable")
    assert tables.uncorrected_joints == ()
    assert errors["plsr"][1] < 0.6 * errors["augmented"][1]
    assert errors["plsr"][0] == pytest.approx(errors["augmented"][0])
