"""Random streams that have names, so that one never shifts another."""

import hashlib

import numpy as np


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the random stream of that name.

    Streams of different names are independent; drawing more from one, or adding
    another, changes nothing in the rest.

    Args:
        seed: Seed of the whole experiment, 0 or more.
        name: What the stream is for, such as "encoder/fit_1".

    Returns:
        A fresh generator at the start of the stream.
    """
    digest = hashlib.sha256(name.encode()).digest()
    entropy = [seed, int.from_bytes(digest[:8], "little")]
    return np.random.default_rng(np.random.SeedSequence(entropy))
