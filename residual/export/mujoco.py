"""A model for MuJoCo with all forces that a motion feels: MJCF and a callback beside.

What MJCF has a place for is in it; the rest (Stribeck's friction, load friction, waves,
tables) is added as passive force by a Python module that compiles the model's headers.
"""

import re
from dataclasses import replace

import numpy as np

from residual.effects.base import Trait
from residual.errors import InputError
from residual.export.c99 import header, prefix_of
from residual.export.exported import (
    Exported,
    Split,
    Whole,
    body_of,
    file_stem,
    random_states,
    split,
)
from residual.export.program import filled, program_of, split_program, template
from residual.export.simulators import MJCF_CAN, STEP, to_mjcf
from residual.model.forward import mass_matrices
from residual.model.model import Model, Term
from residual.recording import Array

SOURCE = "passive.py.txt"
# Dry friction is the callback's: a joint of MuJoCo jumps and sticks, the model's does
# not, and over seconds the two arms would part by some tenths of a milliradian.
NATIVE = tuple(name for name in MJCF_CAN if name != "friction")
REPORT = "it is of the report of torque: no motion feels it"
# Of the step that would outrun friction where a joint turns: an explicit force is
# stable below 2.
SHARE, SHORTEST = 1.0, 2e-5  # 1, s


def to_mujoco(whole: Whole) -> Exported:
    """Return an MJCF, the headers of what is and is not in it, and the module.

    Raises:
        InputError: If a link is none that MuJoCo takes.
    """
    parts = _split(whole)
    found, mjcf = parts.exported({}), to_mjcf(parts.carried, NATIVE)
    stem = file_stem(whole)
    name, native = prefix_of(stem), _renamed(mjcf.carried, f"{stem}_native")
    (text,) = mjcf.files.values()
    size = max(program_of(x).memory for x in (parts.carried, native))
    words = {
        "NAME": stem,
        "STEM": stem,
        "P": name,
        "DOF": str(body_of(whole).robot.dof),
        "MEMORY": str(max(size, 1)),
        "ADDED": ", ".join(map(_said, mjcf.left)) or "nothing, all is in the MJCF",
        "LEFT": ",\n    ".join(map(str, found.left)) or "nothing is left out",
    }
    step = f'timestep="{time_step(parts.carried, mjcf.carried)!r}"'
    files = {
        f"{stem}.xml": re.sub(r'timestep="[^"]*"', step, text.decode()).encode(),
        f"{name}.h": header(parts, found.left).encode(),
        f"{name}_native.h": header(split_program(native)).encode(),
        f"{name}_passive.py": filled(template(SOURCE), words).encode(),
    }
    return replace(found, files=files)


def _split(whole: Whole) -> Split:
    """Part what the two together can carry from the rest."""
    said = {term for term, _ in split_program(whole).reasons}

    def refuse(term: Term) -> str:
        if Trait.REPORT in term.effect.traits:
            return REPORT
        return term.effect.portable.why_not if term in said else ""

    return split(whole, refuse)


def _said(left) -> str:
    return f"{left.name}{''.join(f' J{j}' for j in left.joints)}"


def _renamed(whole: Whole, name: str) -> Model:
    model = body_of(whole)
    return replace(model, robot=replace(model.robot, name=name))


def time_step(whole: Whole, native: Whole) -> float:
    """Return a time step that what the callback adds does not outrun [s].

    Friction turns over a small speed: by its slope there, and by the inertia that a
    joint has with all others free, it ends a motion in so many seconds.
    """
    model, rest = body_of(whole), body_of(native)
    states = random_states(model.robot, 8)
    floor = model.speed_floor
    small = 0.05 * (1e-3 if floor is None else float(np.min(floor)))
    slope = _slope(model, states.q, small) - _slope(rest, states.q, small)
    mass = mass_matrices(model, states.q)
    if not np.linalg.eigvalsh(mass)[:, 0].min() > 0:
        raise InputError(
            "M(q) of the model is not positive definite, and MuJoCo cannot move it. "
            "Identify it with --consistent, or export it to c99."
        )
    free = 1 / np.einsum("nii->ni", np.linalg.inv(mass))
    fastest = float(np.abs(slope / free).max())
    return float(max(SHORTEST, min(STEP, SHARE / max(fastest, 1e-9))))


def _slope(model: Model, q: Array, small: float) -> Array:
    """Growth of a model's torque with speed, about standstill [N m s/rad]. (n, dof)."""
    still, out = np.zeros_like(q), np.zeros_like(q)
    own = replace(
        model.by_sign() if _has_bristle(model) else model,
        terms=tuple(t for t in model.terms if Trait.REPORT not in t.effect.traits),
    )
    t = np.arange(len(q)) / 1.0
    for j in range(q.shape[1]):
        qd = still.copy()
        qd[:, j] = small
        ends = [own.along(t, (q, x, still))[:, j] for x in (qd, -qd)]
        out[:, j] = (ends[0] - ends[1]) / (2 * small)
    return out


def _has_bristle(model: Model) -> bool:
    return any(s.kind == "bristle" and s.size > 0 for s in model.standstill)
