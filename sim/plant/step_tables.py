"""The tables that the compiled step reads: one row per term, one arm per phase."""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numba

from residual.recording import Array

# Numba recompiles a function only when its own file changes, and would keep outdated
# versions of functions that it calls in other files. So the name of the folder of
# compiled code is a hash of all these files.
_PLANT = Path(__file__).parent
_SOURCES = (*sorted(_PLANT.glob("*.py")), _PLANT.parent / "engine" / "friction_laws.py")
_CODE = hashlib.sha256(b"".join(path.read_bytes() for path in _SOURCES)).hexdigest()
_FOLDER = _PLANT / "__pycache__" / f"compiled-{_CODE[:12]}"

# Columns of a row of friction: kind (`sim.engine.friction_laws`), on which contact,
# its memory, four numbers. Contacts are the joints, then the shared gears of pairs.
# Columns of a row of torque: kind, on which joint, into which channel, four numbers.
WIDTH = 7
# Rows of the trace, before one row for each explicit channel.
(
    Q,
    QD,
    MOTOR_Q,
    MOTOR_QD,
    READING,
    READING_RATE,
    DRIVE,
    MOTOR,
    ROTOR,
    FRICTION,
    LINK,
    GEAR,
    TEMPERATURE,
) = range(13)
CHANNELS = 13
ANGLE, SPEED, LOADED = range(3)
# Rows of the quantities with one number per joint (`StepConstants`).
INERTIA, ELASTIC, STIFFNESS, DAMPING, GAP, RATIO, LIMIT, POWER, SHIFT, COS, SIN = range(11)


def compile_lazily(function: Callable) -> Callable:
    """Compile a function on its first call; later processes load it."""
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(_FOLDER)
    try:
        return numba.njit(cache=True)(function)
    finally:
        numba.config.CACHE_DIR = before


class StepConstants(NamedTuple):
    """One arm during one phase, as the compiled step reads it.

    Passing an array from Python to compiled code costs time at every step, so one array
    has all quantities with one number per joint.
    """

    dt: float  # time step [s]
    # Rows, from `INERTIA` on: rotor inertia at the joint [kg m^2]; whether a spring is
    # between motor and link, 1 or 0; stiffness, damping and half gap of the
    # transmission [N m/rad, N m s/rad, rad]; real over reported torque; largest torque
    # of the drive [N m]; usual power of friction, which heats by one unit [W]; error of
    # the encoder, true minus reading: constant, cosine, sine [rad]. Shape (11, dof).
    joints: Array
    # Where friction acts, joints first, then shared gears: index of an unknown, of a
    # second one or -1, sign of that; both joints; inertia of a shared gear [kg m^2],
    # (c, 6).
    contacts: Array
    friction: Array  # rows of friction, (f, WIDTH)
    torque: Array  # rows of explicit torque, (e, WIDTH)
    series: Array  # torques given over time [N m], (n, s)
    # Of each joint of an arm with a background, which part its dry friction is more
    # forwards; how much larger cold friction is; time constants of oil and housing [s];
    # place of their warmth in the memory, (dof or 0, 5).
    used: Array


class PlantState(NamedTuple):
    """The state of an arm between steps, changed in place."""

    # Angle and speed of the motor side of each joint, at the link [rad, rad/s], and
    # torque that its gear transmits [N m], (3, dof).
    motors: Array
    impulse: Array  # friction impulse of each contact [N m s], (c,)
    memory: Array  # bristles and temperatures of the terms, (m,)
