"""A model for MuJoCo with all forces that a motion feels: MJCF and a callback beside.

What MJCF has a place for is in it; the rest (Stribeck's friction, load friction, waves,
tables) is added as passive force by a Python module that compiles the model's headers.
"""

import re
from dataclasses import replace

import numpy as np

from residual.effects.base import Trait
from residual.errors import InputError
from residual.export.c99 import filled, header, prefix_of, refuse, template
from residual.export.exported import (
    RATE,
    SECONDS,
    Exported,
    Whole,
    body_of,
    exciting,
    file_stem,
    split,
)
from residual.export.simulators import MJCF_CAN, STEP, to_mjcf
from residual.model.forward import mass_matrices
from residual.model.model import LEAST_SPEED, Model

SOURCE = "passive.py.txt"
# Dry friction is the callback's: a joint of MuJoCo jumps and sticks, the model's does
# not, and over seconds the two arms would part by some tenths of a milliradian.
NATIVE = tuple(name for name in MJCF_CAN if name != "friction")
REPORT = "it is of the report of torque: no motion feels it"
# Of the step that would outrun friction where a joint turns: an explicit force is
# stable below 2.
SHARE, SHORTEST = 1.0, 2e-5  # 1, s
POSES = 8  # that the time step is found at


def to_mujoco(whole: Whole) -> Exported:
    """Return an MJCF, the headers of what is and is not in it, and the module.

    Raises:
        InputError: If a link is none that MuJoCo takes.
    """
    made = split(
        whole, lambda t: REPORT if Trait.REPORT in t.effect.traits else refuse(t)
    )
    mjcf, stem = to_mjcf(made.carried, NATIVE), file_stem(whole)
    robot = replace(body_of(whole).robot, name=f"{stem}_native")
    native = replace(body_of(mjcf.carried), robot=robot)
    name, (text,) = prefix_of(stem), mjcf.files.values()
    full, memory = header(made.carried, made.left)
    in_mjcf, native_memory = header(native)
    added = (x.name + "".join(f" J{j}" for j in x.joints) for x in mjcf.left)
    words = {
        "NAME": stem,
        "STEM": stem,
        "P": name,
        "DOF": str(robot.dof),
        "MEMORY": str(max(memory, native_memory, 1)),
        "ADDED": ", ".join(added) or "nothing, all is in the MJCF",
        "LEFT": ",\n    ".join(map(str, made.left)) or "nothing is left out",
    }
    step = f'timestep="{time_step(body_of(made.carried), native)!r}"'
    files = {
        f"{stem}.xml": re.sub(r'timestep="[^"]*"', step, text.decode()).encode(),
        f"{name}.h": full.encode(),
        f"{name}_native.h": in_mjcf.encode(),
        f"{name}_passive.py": filled(template(SOURCE), words).encode(),
    }
    return replace(made, files=files)


def time_step(model: Model, native: Model) -> float:
    """Return a time step that what the callback adds does not outrun [s].

    Friction turns over a small speed: by its slope there, and by the inertia that a
    joint has with all others free, it ends a motion in so many seconds.
    """
    q = exciting(model.robot).q[:: round(SECONDS * RATE / POSES)]
    floor = model.speed_floor
    small = 0.05 * (LEAST_SPEED if floor is None else float(np.min(floor)))
    slope, still = np.zeros_like(q), np.zeros_like(q)
    t = np.arange(float(len(q)))
    for part, sign in ((model, 1.0), (native, -1.0)):
        terms = tuple(t for t in part.terms if Trait.REPORT not in t.effect.traits)
        part = replace(part.by_sign(), terms=terms)
        for j in range(q.shape[1]):
            qd = still.copy()
            qd[:, j] = small
            ends = [part.along(t, (q, x, still))[:, j] for x in (qd, -qd)]
            slope[:, j] += sign * (ends[0] - ends[1]) / (2 * small)
    mass = mass_matrices(model, q)
    if not np.linalg.eigvalsh(mass)[:, 0].min() > 0:
        raise InputError(
            "M(q) of the model is not positive definite, and MuJoCo cannot move it. "
            "Identify it with --consistent, or export it to c99."
        )
    fastest = float(np.abs(slope * np.einsum("nii->ni", np.linalg.inv(mass))).max())
    return float(max(SHORTEST, min(STEP, SHARE / max(fastest, 1e-9))))
