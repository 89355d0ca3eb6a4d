"""Noise of the angles: what it does to a fit, and what the reference can mend."""

from dataclasses import replace

import numpy as np
import pytest

from residual.diagnosis import errors_in_variables as instruments
from residual.diagnosis.diagnose import diagnose
from residual.recording import Recording
from residual.robot.dynamics import compute_inverse_dynamics
from tests.residual.arms import arm, names

RATE, SECONDS = 125.0, 12.0
ROTOR = 0.5  # kg m^2 on joint 2, of which the model knows nothing
COARSE = 6e-3  # rad: an encoder of ten bits


def log(name, seed, noise, rotor=ROTOR):
    """Harmonics on both joints; the reference is where the arm is."""
    rng, t = np.random.default_rng(seed), np.arange(0, SECONDS, 1 / RATE)
    q, qd, qdd = (np.zeros((len(t), 2)) for _ in range(3))
    for j in range(2):
        for order in range(1, 5):
            size, phase = rng.uniform(0.1, 0.3), rng.uniform(0, 6)
            w = 2 * np.pi * order * rng.uniform(0.15, 0.4)
            q[:, j] += size * np.sin(w * t + phase)
            qd[:, j] += size * w * np.cos(w * t + phase)
            qdd[:, j] -= size * w**2 * np.sin(w * t + phase)
    tau = compute_inverse_dynamics(arm().model, q, qd, qdd)
    tau[:, 1] += rotor * qdd[:, 1]
    tau += 0.05 * rng.normal(size=q.shape)
    read = q + noise * rng.normal(size=q.shape)
    t += 30.0 * seed
    return Recording(id=name, robot=arm().name, t=t, q=read, tau=tau, q_ref=q)


def diagnosed(noise, reference=True, rotor=ROTOR):
    logs = [log(f"log {i}", i, noise, rotor) for i in range(4)]
    if not reference:
        logs = [replace(r, q_ref=None) for r in logs]
    held_out = [log("held out", 9, noise, rotor)]
    return diagnose(arm(), logs, (), held_out, declared=())


def inertia(outcome):
    assert names(outcome.verdict) == [("rotor_inertia", (2,))]
    (finding,) = outcome.effects
    value = finding.parameters["inertia"]
    return value.value, value.std


def is_noted(outcome, words):
    return any(words in note for note in outcome.notes)


def test_instruments_free_a_parameter_of_the_noise_of_a_coarse_encoder():
    outcome = diagnosed(COARSE)
    value, std = inertia(outcome)
    assert is_noted(outcome, "contradicts least squares on rotor_inertia")
    assert abs(value - ROTOR) < 3 * std


def test_with_a_fine_encoder_both_agree_and_it_is_said():
    outcome = diagnosed(0.0)
    value, _ = inertia(outcome)
    assert is_noted(outcome, "agree with least squares")
    assert value == pytest.approx(ROTOR, rel=0.01)


def test_without_a_reference_redrawn_noise_frees_a_parameter_too(monkeypatch):
    fits = []
    look = instruments.check_angle_noise

    def keep(*args):
        fits.append(look(*args))
        return fits[-1]

    monkeypatch.setattr("residual.diagnosis.diagnose.check_angle_noise", keep)
    outcome = diagnosed(COARSE, reference=False)
    value, std = inertia(outcome)
    assert is_noted(outcome, "parameters of rotor_inertia are corrected for it")
    assert abs(value - ROTOR) < 2 * std
    # Least squares takes too little, by many of its own deviations.
    plain = fits[-1].fit
    slots = plain.slots(plain.members[0])
    own = np.sqrt(np.diag(plain.covariance())[slots])
    assert plain.theta[slots] < ROTOR - 4 * own
    assert abs(value - ROTOR) < abs(plain.theta[slots] - ROTOR) / 3


@pytest.mark.parametrize("reference", [True, pytest.param(False, marks=pytest.mark.long)])
def test_noise_of_the_angles_is_not_a_residual_to_explain(reference):
    verdict = diagnosed(COARSE, reference, rotor=0.0).verdict
    assert verdict.verdict == "none"
    assert verdict.unexplained.joints == ()
