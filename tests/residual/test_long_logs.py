"""Long logs: cut into pieces, they say what they say whole."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from residual.effects import load_effects
from residual.errors import RecordingError
from residual.evidence.design import Design
from residual.identification.identify import identify
from residual.model.nominal import build_free_nominal, prepare_fit_logs
from residual.recording import Recording
from residual.robot.dynamics import compute_inertial_regressor, read_inertial_parameters
from residual.signals import splitting as pieces
from residual.signals.track import FilterSettings
from tests.residual.arms import arm, plain_logs

NAMES = ("viscous", "coulomb", "rotor_inertia")


@pytest.fixture
def short(monkeypatch):
    """Let a log be long from 12 s on, and its pieces last 3 s."""
    monkeypatch.setattr(pieces, "LONG", 12.0)
    monkeypatch.setattr(pieces, "PIECE", 3.0)
    monkeypatch.setattr(pieces, "SKETCH", 12.0)


@pytest.fixture(scope="module")
def log():
    return smooth_log(36.0, 5)


def smooth_log(seconds, seed):
    """A log of a two-joint arm on a smooth motion that never repeats."""
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * 100)) / 100
    waves = rng.uniform(0.15, 1.1, (6, 2)), rng.uniform(0, 6, (6, 2))
    pairs = zip(*waves, strict=True)
    q = sum(0.3 * np.sin(2 * np.pi * f * t[:, None] + p) for f, p in pairs)
    like = plain_logs(arm(), [0, 1], [0.0, 0.0])[0]
    qd = np.gradient(q, t, axis=0)
    motion = q, qd, np.gradient(qd, t, axis=0)
    tau = compute_inertial_regressor(arm().model, *motion) @ read_inertial_parameters(arm().model)
    tau += 0.5 * np.tanh(qd / 0.02) + 0.3 * qd + 0.02 * rng.normal(size=q.shape)
    return Recording(f"long {seed}", like.robot, t, q, tau)


@pytest.mark.parametrize("lengths", [(36.0,), (5.0, 5.5, 6.0), (5.0, 20.0)])
def test_sums_over_pieces_are_those_of_all_rows(short, lengths, monkeypatch):
    recordings = [smooth_log(s, seed) for seed, s in enumerate(lengths)]
    logs = prepare_fit_logs(arm(), recordings, None, FilterSettings())
    model = build_free_nominal(logs, NAMES).model
    long = Design(logs.tracks, model)
    with monkeypatch.context() as room:
        room.setattr(pieces, "LONG", np.inf)
        uncut = Design(logs.tracks, model)
    assert len(long.tracks) < len(uncut.tracks)
    wanted = [(load_effects()[n], (1,), ()) for n in ("spring", "offset")]
    wanted += [(load_effects()[n], (j,), ()) for n, j in (("payload", 1), ("spring", 0))]
    groups = [design.add(wanted) for design in (long, uncut)]
    assert [g.ids.tolist() for g in groups[0]] == [g.ids.tolist() for g in groups[1]]
    for j in range(2):
        for mine, theirs in zip(long.total(j), uncut.total(j), strict=True):
            size = np.abs(theirs).max()
            assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9 * size)
    for name in ("rows", "rms", "peak", "power", "tau_power", "fold_rows"):
        assert_allclose(getattr(long, name), getattr(uncut, name), rtol=1e-9)
    assert_allclose(groups[0][2].precision, groups[1][2].precision, rtol=1e-9)


def test_identification_of_pieces_is_that_of_the_log(log, short, monkeypatch):
    cut = identify(arm(), [log], NAMES)
    monkeypatch.setattr(pieces, "LONG", np.inf)
    identification = identify(arm(), [log], NAMES)
    gap = np.abs(cut.estimate.theta - identification.estimate.theta)
    assert len(cut.logs.tracks) > len(identification.logs.tracks)
    assert (gap / identification.estimate.sd).max() < 0.3


def test_a_recording_copies_what_somebody_can_still_write_to():
    t, x = np.arange(5.0), np.ones((5, 2))
    shown = x.view()
    shown.setflags(write=False)
    copied = Recording("a", "two_link", t, shown, x)
    x[:] = np.nan
    assert np.isfinite(copied.q).all()
    assert np.isfinite(copied.tau).all()
    with pytest.raises(RecordingError):
        replace(copied, q=x)
