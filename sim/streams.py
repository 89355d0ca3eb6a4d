"""Named random streams of a simulated experiment.

Each thing that is drawn has a stream of its own, so that adding an effect changes
neither the arm nor anybody else's noise. Noise also depends on the motion: two
experiments on one arm share its scatter and nothing else.
"""

import hashlib

import numpy as np

from sim.records import Reference

HIDDEN = "hidden"
# What a manifest lists: the streams that one experiment draws from.
NAMES = ("scatter", "friction", "encoder", "torque", "effect")


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the random stream of that name.

    Streams of different names are independent; drawing more from one, or adding
    another, changes nothing in the rest.

    Args:
        seed: Seed of the whole experiment, 0 or more.
        name: What the stream is for, such as "encoder/fit_1".
    """
    digest = hashlib.sha256(name.encode()).digest()
    entropy = [seed, int.from_bytes(digest[:8], "little")]
    return np.random.default_rng(np.random.SeedSequence(entropy))


def motion_label(reference: Reference, start: float) -> str:
    """Return a label of one motion at one time of the session, for stream names."""
    digest = hashlib.sha256(reference.kind.encode())
    for array in (reference.t, reference.q):
        digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return f"{digest.hexdigest()[:16]}/{start!r}"
