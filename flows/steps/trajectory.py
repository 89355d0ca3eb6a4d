"""A motion as a file for a real controller."""

import io

import numpy as np

from sim.records import Reference


def as_csv(reference: Reference) -> str:
    """Return t [s], q1.. [rad], qd1.. [rad/s] and qdd1.. [rad/s^2] as CSV text."""
    joints = range(1, reference.q.shape[1] + 1)
    names = [f"{name}{joint}" for name in ("q", "qd", "qdd") for joint in joints]
    parts = [reference.t[:, None], reference.q, reference.qd, reference.qdd]
    text = io.StringIO()
    np.savetxt(
        text,
        np.hstack(parts).round(9) + 0.0,  # + 0 makes of -0 a 0
        fmt="%.9f",
        delimiter=",",
        header=",".join(["t", *names]),
        comments="",
    )
    return text.getvalue()
