"""Runs that the groups share, and a place for their stores."""

import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from residual.recording import Recording

Array = np.ndarray

DOF = 6
KINDS = ("fourier", "cyclic", "move_stop_move", "welding")
# Of an encoder with 19 bits a turn.
_STEP = 2 * np.pi / 2**19


@contextmanager
def folder() -> Iterator[Path]:
    """Give a folder of one's own; nothing of it stays."""
    place = Path(tempfile.mkdtemp(prefix="modelgap-store-"))
    try:
        yield place
    finally:
        shutil.rmtree(place, ignore_errors=True)


def small(seed: int, rows: int = 50) -> tuple[Recording, Mapping, dict[str, Array]]:
    """Return a small run: its log, its manifest, the errors of its twin."""
    rng = np.random.default_rng(seed)
    q, tau = rng.normal(size=(2, rows, DOF))
    log = Recording("", "irb140", np.arange(rows) / 250, q, tau)
    kind = KINDS[seed % len(KINDS)]
    manifest = {"spec": {"seed": seed, "trajectory": {"kind": kind}}}
    return log, manifest, {"e_q": q / 10, "e_tau": tau / 10}


def synthetic(seed: int, rows: int) -> tuple[Recording, dict[str, Array]]:
    """Return signals as the plant logs them: 43 columns, of which 19 have no noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) / 250
    q_ref = np.sin(t[:, None] * np.arange(1, 7) / 3 + rng.uniform(0, 6, DOF))

    def noisy(values: Array, spread: float) -> Array:
        return values + spread * rng.normal(size=values.shape)

    q = np.round(noisy(q_ref, 1e-4) / _STEP) * _STEP
    log = Recording("", "irb140", t, q, noisy(30 * q_ref, 0.02), q_ref=q_ref)
    twin = {
        "e_q": q - q_ref,
        "e_qd": 1e-2 * q_ref,
        "e_qdd": 1e-1 * q_ref,
        "e_tau": noisy(q_ref, 0.02),
    }
    return log, twin
