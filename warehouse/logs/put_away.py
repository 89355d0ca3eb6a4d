"""Samples of long logs, in files without a name, which need no memory."""

from tempfile import TemporaryFile

import numpy as np

Array = np.ndarray

LARGE = 1 << 26  # bytes of one signal: some twenty minutes at 1 kHz


def put_away(values: Array) -> Array:
    """Return the same values where they need no memory, if they are many.

    They lie where the system keeps files that nobody has named (TMPDIR), and are gone
    with the last use of them.

    Args:
        values: Samples. Shape (n, ...).

    Returns:
        The same, not to be written to.
    """
    values = np.ascontiguousarray(values, dtype=float)
    if values.nbytes >= LARGE:
        with TemporaryFile(prefix="modelgap-") as file:
            file.write(values)
            file.flush()
            values = np.memmap(file, float, "r", shape=values.shape)
    values.setflags(write=False)
    return values
