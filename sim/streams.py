"""Named random streams of a simulated experiment.

Each thing that is drawn has a stream of its own, so that adding an effect changes
neither the arm nor anybody else's noise. Noise also depends on the motion: two
experiments on one arm share its scatter and nothing else.
"""

import hashlib

import numpy as np

from sim.records import Reference
from sim.synthetic.seeds import stream

__all__ = ["HIDDEN", "NAMES", "motion_label", "stream"]

HIDDEN = "hidden"
# What a manifest lists: the streams that one experiment draws from.
NAMES = ("scatter", "friction", "encoder", "torque", "effect")


def motion_label(reference: Reference, start: float) -> str:
    """Return a label of one motion at one time of the session, for stream names."""
    digest = hashlib.sha256(reference.kind.encode())
    for array in (reference.t, reference.q):
        digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return f"{digest.hexdigest()[:16]}/{start!r}"
