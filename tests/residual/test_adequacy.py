"""Is what remains noise, and was the torque channel touched before it was logged?"""

from dataclasses import replace

import numpy as np
import pytest

from residual.diagnosis.adequacy import assess_adequacy
from residual.diagnosis.diagnose import diagnose
from residual.evidence.fit import fit_jointly
from tests.residual.arms import TWO, arm, plain_logs
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


@pytest.mark.parametrize("compared", [False, True])
def test_of_logs_that_show_no_motion_nothing_is_said(compared):
    robot, still = arm(TWO), plain_logs(arm(TWO), [], 0.0, count=3)
    baseline = plain_logs(robot, [0, 1], 0.0) if compared else ()
    verdict = diagnose(robot, still[:2], baseline, still[2:]).verdict
    assert (verdict.verdict, verdict.effects) == ("unknown", ())
    assert "no motion" in " ".join(verdict.contradictions)
