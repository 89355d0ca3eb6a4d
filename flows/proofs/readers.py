"""Exports that are read back by what reads them here: JSON and URDF."""

import json

import numpy as np

from flows.proofs.proof import Proof, compared, text_of
from residual.export.exported import Exported, body_of
from residual.export.motion import exciting, random_states
from residual.export.passive import saturated_speed
from residual.model.record import from_record
from residual.robot.dynamics import inverse_dynamics
from residual.robot.urdf import build_model

STATES = 1000


def prove_json(made: Exported) -> Proof:
    """Read the file and predict with it, along a motion.

    Args:
        made: The export.
    """
    again = from_record(json.loads(text_of(made)))
    motion = exciting(body_of(made.whole).robot)
    torques = [m.along(motion.t, motion.parts) for m in (again, made.carried)]
    return compared("read again and predicted", *torques)


def prove_urdf(made: Exported) -> Proof:
    """Let Pinocchio read inertias, damping and friction, and compute torque with them.

    Args:
        made: The export.
    """
    model = body_of(made.carried)
    read = build_model(text_of(made), "the URDF")
    # A URDF says nothing of gravity.
    read.gravity.linear = model.robot.model.gravity.linear
    speed = saturated_speed(model)
    states = random_states(model.robot, STATES, speed)
    got = inverse_dynamics(read, *states.parts)
    got += states.qd * read.damping + np.sign(states.qd) * read.upperDryFrictionLimit
    note = "gravity is not in a URDF: set it where the URDF is used"
    notes = (note, _slow(speed)) if (read.upperDryFrictionLimit > 0).any() else (note,)
    return compared("Pinocchio", got, model.torque(*states.parts), notes)


def _slow(speed: np.ndarray) -> str:
    shown = ", ".join(f"{v:.3g}" for v in speed)
    return (
        f"compared above {shown} rad/s: below, dry friction here is smooth and there "
        "it jumps"
    )
