"""How an effect is said outside this program, in one place for every program.

A formula is an expression that C and Python read alike. It may use of the joint it acts
on ``q``, ``qd``, ``qdd``, ``sign``, ``rigid`` and ``tau`` (see ``State``), the session
time ``t``, the coefficients ``a[i]``, the numbers of the shape ``s[i]``, and ``sin``,
``cos``, ``tanh``, ``exp``, ``pow``, ``fabs``, ``fmin``, ``fmax``, ``sgn``. With ``m``,
the effect's own memory, there are ``bristle(m, q, way)`` and
``earlier(m, t, tau, by)``. Of an effect on a pair of joints the six names are arrays
of two.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

Array = np.ndarray
Property = Literal[
    "damping", "quadratic_damping", "friction", "armature", "stiffness", "constant"
]
BRISTLE, EARLIER = 3, 258  # numbers that each of the two has to keep in its memory


@dataclass(frozen=True, eq=False, slots=True)
class Portable:
    """What of an effect other programs can be told; nothing where all is empty.

    Attributes:
        formula: Torque [N m], one expression per joint that the effect acts on; a
            single one stands for all.
        shift: By how much the angle of the joint is another than the encoder says
            [rad], and the first and second derivative of that.
        memory: How many numbers the formula keeps from sample to sample.
        joint: What each coefficient is as a property of a simulated joint: torque per
            "damping" qd, "quadratic_damping" qd |qd|, "friction" sign(qd), "armature"
            qdd, "stiffness" q, or "constant".
        bodies: (theta, joints, robot) -> inertial parameters that it adds (10 dof,).
        gravity: (theta, robot) -> acceleration that it adds to gravity [m/s^2] (3,).
        force: (theta,) -> force on the flange, in the base frame [N] (3,).
        possible: (theta, shape) -> whether the formula holds for these numbers.
        why_not: Why no formula can say it; empty where there is one.
    """

    formula: tuple[str, ...] = ()
    shift: tuple[str, str, str] | None = None
    memory: int = 0
    joint: tuple[Property, ...] = ()
    bodies: Callable[[Array, tuple[int, ...], Any], Array] | None = None
    gravity: Callable[[Array, Any], Array] | None = None
    force: Callable[[Array], Array] | None = None
    possible: Callable[[Array, tuple[float, ...]], bool] = lambda theta, shape: True
    why_not: str = ""


def formula(*rows: str, joint: tuple[Property, ...] = (), memory: int = 0) -> Portable:
    """An effect that its torque says, and what its coefficients are to a joint."""
    return Portable(formula=rows, joint=joint, memory=memory)


NOWHERE = Portable(why_not="its file does not say it")
