"""What friction does at standstill, where Coulomb friction is set-valued.

A log's torque shows which value the drive and the gear left behind: the sign of creep,
the sign of the last motion (a bristle that holds), or nothing on average. No fit uses
such rows; predictions need an answer all the same.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from residual.recording import Array


@dataclass(frozen=True, slots=True)
class Standstill:
    """How the direction of motion passes through zero."""

    # "smooth": tanh(qd / (size · floor)). "bristle": Dahl's state of that displacement
    # [rad] (Dahl 1968), where 0 is the plain sign of velocity.
    kind: Literal["smooth", "bristle"] = "smooth"
    size: float = 0.25  # number of its kind
    hold: float = 1.0  # share of it that remains while the joint stands, 0 to 1
    reach: float = 1.0  # speed up to which it counts as standing here, in floors


SMOOTH = Standstill()
CHOICES = (
    SMOOTH,
    Standstill("smooth", 1.0),
    Standstill("smooth", 4.0),
    *(
        Standstill("bristle", d, reach=r)
        for d in (0.0, 3e-5, 1e-4, 3e-4, 1e-3, 1e-2)
        for r in (1.0, 4.0)
    ),
)


def direction(q: Array, qd: Array, floor: float, shape: Standstill) -> Array:
    """Direction of motion of one joint, -1 to 1, with its behaviour at standstill.

    Args:
        floor: Speed under which the joint counts as standing [rad/s].
    """
    if shape.kind == "smooth":
        out = np.tanh(qd / (shape.size * floor))
    elif shape.size == 0.0:
        out = np.sign(qd)
    else:
        out = bristle(q, shape.size)
    if shape.hold == 1.0:
        return out
    return np.where(np.abs(qd) < shape.reach * floor, shape.hold, 1.0) * out


def bristle(q: Array, displacement: float) -> Array:
    """Dahl's state by its exact solution over each step of position, start at rest.

    Each step is z -> fade z + (1 - fade) goal. Two such steps in a row make one of the
    same kind, so after log2(n) rounds of joining each with those before it every
    sample has its whole past. From -1 to 1; it yields over the displacement [rad].
    """
    step = np.diff(q)
    fade = np.exp(-np.abs(step) / displacement)
    state = np.where(step > 0, 1.0, -1.0) * (1 - fade)
    reach = 1
    while reach < len(step) and fade.any():
        state[reach:] += fade[reach:] * state[:-reach]
        fade[reach:] *= fade[:-reach]
        fade[:reach] = 0.0  # at rest before
        reach *= 2
    return np.concatenate([np.zeros(min(len(q), 1)), np.clip(state, -1, 1)])


def directions(
    q: Array, qd: Array, floor: Array, shapes: tuple[Standstill, ...]
) -> Array:
    """Direction of motion of every joint. Shapes (n, dof), (dof,), one per joint."""
    pairs = zip(q.T, qd.T, floor, shapes, strict=True)
    return np.column_stack([direction(*p) for p in pairs])
