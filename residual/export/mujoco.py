"""A model for MuJoCo with all passive forces: MJCF and a callback.

MJCF holds what it can represent; a Python module compiles the model's headers and adds
the other terms (Stribeck friction, load friction, ripple, tables) as passive force.
"""

import re
from dataclasses import replace

import numpy as np

from residual.effects.base import Trait
from residual.errors import InputError
from residual.export.c99 import filled, header, prefix_of, refuse, template
from residual.export.export import (
    RATE,
    SECONDS,
    AnyModel,
    ModelExport,
    excitation,
    file_stem,
    split,
    without_tables,
)
from residual.export.simulators import MJCF_CAN, STEP, to_mjcf
from residual.model.dynamics import mass_matrices
from residual.model.model import LEAST_SPEED, Model

SOURCE = "passive.py.txt"
# Dry friction is the callback's: a joint of MuJoCo jumps and sticks, the model's does
# not, and over seconds the two arms would part by some tenths of a milliradian.
NATIVE = tuple(name for name in MJCF_CAN if name != "friction")
REPORT = "it distorts the torque reading only, not the motion"
# Of the step that would outrun friction where a joint turns: an explicit force is
# stable below 2.
SHARE, SHORTEST = 1.0, 2e-5  # 1, s
POSES = 8  # that the time step is found at


def to_mujoco(source: AnyModel) -> ModelExport:
    """Return an MJCF, headers of the model and of its MJCF part, and the module.

    Raises:
        InputError: If a link is none that MuJoCo takes.
    """
    made = split(
        source, lambda t: REPORT if Trait.REPORT in t.effect.traits else refuse(t)
    )
    mjcf, stem = to_mjcf(made.carried, NATIVE), file_stem(source)
    robot = replace(without_tables(source).robot, name=f"{stem}_native")
    native = replace(without_tables(mjcf.carried), robot=robot)
    name, (text,) = prefix_of(stem), mjcf.files.values()
    full, memory = header(made.carried, made.omissions)
    in_mjcf, native_memory = header(native)
    added = (x.name + "".join(f" J{j}" for j in x.joints) for x in mjcf.omissions)
    words = {
        "NAME": stem,
        "STEM": stem,
        "P": name,
        "DOF": str(robot.dof),
        "MEMORY": str(max(memory, native_memory, 1)),
        "ADDED": ", ".join(added) or "nothing, all is in the MJCF",
        "LEFT": ",\n    ".join(map(str, made.omissions)) or "nothing is left out",
    }
    step = f'timestep="{time_step(without_tables(made.carried), native)!r}"'
    files = {
        f"{stem}.xml": re.sub(r'timestep="[^"]*"', step, text.decode()).encode(),
        f"{name}.h": full.encode(),
        f"{name}_native.h": in_mjcf.encode(),
        f"{name}_passive.py": filled(template(SOURCE), words).encode(),
    }
    return replace(made, files=files)


def time_step(model: Model, native: Model) -> float:
    """Return a time step at which the explicit friction of the callback is stable [s].

    The slope of friction over a small speed, and the inertia of a joint with all others
    free, give the time constant in which it stops a motion.
    """
    q = excitation(model.robot).q[:: round(SECONDS * RATE / POSES)]
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
