"""Is what remains noise, and was the torque channel touched before it was logged?"""

from dataclasses import replace

import numpy as np
import pytest

from residual.diagnosis.adequacy import assess_adequacy
from residual.diagnosis.diagnose import diagnose
from residual.evidence.fit import fit_jointly
from tests.residual.arms import TWO, arm, plain_logs, recording
from tests.residual.linear import DOF, Problem, build

NOISE = 1.0


def problem(rng, shape=None, size=0.0, rows=400, noise=NOISE):
    """Noise of 1 N m, known as such, and a torque of some shape on joint 2."""
    drawn = Problem.draw(rng, rows=rows, noise=noise, logs=3)
    logs = []
    for own, state in drawn.logs:
        tau = own.tau.copy()
        if shape is not None:
            tau[:, 1] += size * shape(state)
        logs.append((replace(own, tau=tau, torque_noise=np.full(DOF, noise)), state))
    return Problem(logs, build(logs), drawn.prior)


def judge(found, members=()):
    d = found.design
    before, after = (fit_jointly(d, found.prior, m, d.rows, None, 5) for m in ((), tuple(members)))
    return assess_adequacy(d, tuple(own for own, _ in found.logs), before, after)


def slow(state):
    return np.sqrt(2) * np.sin(state.t / 25)


@pytest.mark.parametrize(
    ("share", "doubted", "flagged"), [(0.01, (), ()), (0.03, (1,), ()), (0.08, (1,), (1,))]
)
def test_a_little_more_than_noise_is_said_and_voids_no_name(share, doubted, flagged):
    """A part of torque on joint 2, where noise is half a per cent of it."""
    rms = problem(np.random.default_rng(1), noise=0.01).design.rms[1]
    case = problem(np.random.default_rng(1), slow, share * rms, noise=0.01)
    judgment = judge(case)
    assert (judgment.doubted, judgment.flagged) == (doubted, flagged)


def periodic(period=4.0, duration=13.0, noise=0.0, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * 125)) / 125
    w = 2 * np.pi / period
    q = np.column_stack([np.sin(w * t) + 0.3 * np.sin(3 * w * t), np.cos(2 * w * t)])
    q += 1e-5 * rng.normal(size=q.shape)
    return recording(t, q, noise * rng.normal(size=q.shape))


@pytest.mark.parametrize(
    ("kind", "left"),
    [
        ("repeatable", lambda rows, period, rng: np.sin(2 * np.pi * 3 * rows / period)),
        ("time-driven", lambda rows, period, rng: np.sin(2 * np.pi * rows / 11.3)),
    ],
)
def test_what_comes_back_with_motion_is_told_from_what_follows_time(rng, kind, left):
    """The rows of a log that repeats every 40 of them, with noise of 0.1 N m."""
    found, period = problem(rng, rows=400), 40
    logs = []
    for own, state in found.logs:
        rows = np.arange(len(own.tau))
        angle = 2 * np.pi * np.outer(rows, [1, 2]) / period
        tau = 0.1 * rng.normal(size=own.tau.shape)
        tau[:, 1] += left(rows, period, rng)
        noise = np.full(DOF, 0.1)
        repeated = replace(own, tau=tau, q=np.sin(angle), torque_noise=noise)
        logs.append((repeated, state))
    found = Problem(logs, build(logs), found.prior)
    assert judge(found).kind[1] == kind


@pytest.mark.parametrize("compared", [False, True])
def test_of_logs_that_show_no_motion_nothing_is_said(compared):
    robot, still = arm(TWO), plain_logs(arm(TWO), [], 0.0, count=3)
    baseline = plain_logs(robot, [0, 1], 0.0) if compared else ()
    verdict = diagnose(robot, still[:2], baseline, still[2:]).verdict
    assert (verdict.verdict, verdict.effects) == ("unknown", ())
    assert "no motion" in " ".join(verdict.contradictions)
