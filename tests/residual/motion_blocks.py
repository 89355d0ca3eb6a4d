"""Blocks X and Y of a small arm that moves, for tests of the regressions."""

import numpy as np

NAMES = tuple(f"{kind}{j}" for kind in ("q", "qd", "qdd") for j in (1, 2, 3))


def motion(rng, runs=4, rows=800, friction=12.0, noise=1.0):
    """Return X (q, qd, qdd of 3 joints), Y (friction and noise), torque, run."""
    t = np.arange(rows) * 0.01
    parts = []
    for _ in range(runs):
        q = np.zeros((rows, 3))
        for k in range(1, 6):
            size, phase = rng.normal(size=3) / k, rng.uniform(0, 2 * np.pi, 3)
            q += size * np.sin(2 * np.pi * 0.125 * k * t[:, None] + phase)
        qd = np.gradient(q, t, axis=0)
        qdd = np.gradient(qd, t, axis=0)
        parts.append((q, qd, qdd))
    q, qd, qdd = (np.concatenate(side) for side in zip(*parts, strict=True))
    Y = friction * np.tanh(qd / 0.02) + noise * rng.normal(size=q.shape)
    torque = Y + 20 * qdd + 30 * np.cos(q)
    return np.hstack([q, qd, qdd]), Y, torque, np.repeat(np.arange(runs), rows)


def one_hot(codes, sizes, pairs):
    """All products of two variables' indicators, as columns (paper, eq. 30)."""
    blocks = []
    for i, j in pairs:
        place = codes[:, i].astype(int) * sizes[j] + codes[:, j]
        blocks.append(np.eye(sizes[i] * sizes[j])[place])
    return np.hstack(blocks)
