"""Small runs, for stores."""

from collections.abc import Mapping

import numpy as np

from residual.recording import Recording

Array = np.ndarray

DOF = 6
FAMILIES = ("fourier", "cyclic", "move_stop_move", "welding")


def small(seed: int, rows: int = 50) -> tuple[Recording, Mapping, dict[str, Array]]:
    """Return a small run: its log, its manifest, the errors of its twin."""
    rng = np.random.default_rng(seed)
    q, tau = rng.normal(size=(2, rows, DOF))
    log = Recording("", "irb140", np.arange(rows) / 250, q, tau)
    kind = FAMILIES[seed % len(FAMILIES)]
    manifest = {"spec": {"seed": seed, "trajectory": {"kind": kind}}}
    return log, manifest, {"e_q": q / 10, "e_tau": tau / 10}
