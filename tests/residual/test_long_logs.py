"""Long logs: pieces, evenly spread, are diagnosed; an identification takes them all."""

from dataclasses import replace

import numpy as np
import pytest

from residual.diagnosis.diagnose import diagnose
from residual.errors import RecordingError
from residual.identification.identify import identify
from residual.model.nominal import prepare_fit_logs
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


def test_a_long_log_is_diagnosed_by_pieces_evenly_spread(log, short):
    result = diagnose(arm(), [log], held_out=[smooth_log(10.0, 7)], declared=["viscous"])
    (used,) = [note for note in result.notes if note.startswith("long logs: ")]
    assert "of 36 s, evenly spread, are used" in used
    assert "coulomb" in {f.name for f in result.verdict.effects + result.verdict.background}
    some = pieces.pick_spread_pieces([log])
    starts = [piece.t[0] for piece in some]
    assert sum(piece.duration for piece in some) < 24
    assert starts == sorted(starts)
    assert starts[0] < 9
    assert starts[-1] > 20


def test_logs_of_just_ten_minutes_all_have_their_angle_noise(monkeypatch):
    logs = [smooth_log(6.0, seed) for seed in range(3)]
    # A log lasts a sample less than its track.
    monkeypatch.setattr(pieces, "LONG", sum(log.duration for log in logs) + 0.005)
    monkeypatch.setattr(pieces, "SKETCH", 12.0)
    ready = prepare_fit_logs(arm(), logs, None, FilterSettings())
    assert len(ready.shaken) == len(ready.tracks) == 3


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
