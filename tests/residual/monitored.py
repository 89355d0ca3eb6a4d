"""Logs of a small arm that repeats a program, with sensors in order or not."""

from dataclasses import replace
from functools import cache

import numpy as np

from residual.identification.identify import identify
from residual.model.nominal import build_free_nominal, prepare_fit_logs
from residual.monitoring.monitor import Monitor, calibrate_monitor
from residual.recording import Recording
from residual.robot.dynamics import compute_inverse_dynamics
from residual.signals.track import FilterSettings
from tests.residual.arms import arm

RATE, PERIOD, STEP = 125.0, 3.0, 1e-4
ROBOT = arm()
RANGE = np.array([60.0, 15.0])  # N m, about, of the torque of the two joints


def healthy(seed: int, duration: float = 12.0) -> Recording:
    """A log in good order: encoder steps, white torque noise, dry friction."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration * RATE)) / RATE
    turn = 2 * np.pi / PERIOD
    size = np.array([0.6, 0.8]) + 0.05 * rng.normal(size=2)
    phase = np.array([0.0, 1.0]) + 0.2 * rng.normal(size=2)
    angle = turn * t[:, None] * [1, 2] + phase
    q, qd = size * np.sin(angle), size * turn * np.array([1, 2]) * np.cos(angle)
    qdd = -size * (turn * np.array([1, 2])) ** 2 * np.sin(angle)
    tau = compute_inverse_dynamics(ROBOT.model, q, qd, qdd)
    tau += np.array([4.0, 1.0]) * np.tanh(qd / 0.02) + np.array([2.0, 0.5]) * qd
    tau += 0.01 * RANGE * rng.normal(size=tau.shape)
    read = np.round((q + STEP / 2 * rng.normal(size=q.shape)) / STEP) * STEP
    return Recording(f"run {seed}", ROBOT.name, t, read, tau, q_ref=q)


def spoilt(log: Recording, fault: str, joint: int, onset: float) -> Recording:
    q, tau = log.q.copy(), log.tau.copy()
    first, j = int(np.searchsorted(log.t, onset)), joint - 1
    if fault == "frozen":
        q[first:, j] = q[first - 1, j]
    elif fault == "jump":
        q[first:, j] += np.deg2rad(0.5)
    elif fault == "spikes":
        tau[first :: round(RATE), j] += 0.5 * RANGE[j]
    elif fault == "bias":
        tau[first:, j] += 0.15 * RANGE[j]
    elif fault == "lost scale":
        tau[first:, j] *= 0.7
    elif fault == "drift":
        q[first:, j] += np.deg2rad(2.0) * (log.t[first:] - log.t[first])
    return replace(log, q=q, tau=tau)


def part(log: Recording, stop: float) -> Recording:
    rows = log.t < stop
    arrays = {n: getattr(log, n)[rows] for n in ("t", "q", "tau", "q_ref")}
    return replace(log, **arrays)


@cache
def good_runs() -> tuple[Recording, ...]:
    return tuple(healthy(seed) for seed in range(6))


def model_of(runs):
    logs = prepare_fit_logs(ROBOT, list(runs), None, FilterSettings())
    names = ("viscous", "coulomb", "rotor_inertia")
    return identify(ROBOT, list(runs), build_free_nominal(logs, names).model).model


@cache
def monitor() -> Monitor:
    return calibrate_monitor(model_of(good_runs()), good_runs())
