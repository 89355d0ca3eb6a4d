"""Exports that are read back by what reads them here: JSON, URDF and tables."""

import json

import numpy as np

from flows.proofs.proof import Proof, compared, text_of
from residual.export.exported import Exported, body_of, exciting, random_states
from residual.export.simulators import saturated_speed
from residual.export.table import POSITION, SPEED, curve_at
from residual.model.record import from_record
from residual.robot.dynamics import inverse_dynamics
from residual.robot.urdf import build_model

STATES = 1000


def prove_json(made: Exported) -> Proof:
    """Read the file and predict with it, along a motion."""
    again = from_record(json.loads(text_of(made)))
    motion = exciting(body_of(made.whole).robot)
    torques = [m.along(motion.t, motion.parts) for m in (again, made.carried)]
    return compared("read again and predicted", *torques)


def prove_urdf(made: Exported) -> Proof:
    """Let Pinocchio read inertias, damping and friction, and compute torque."""
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


def prove_table(made: Exported) -> Proof:
    """Read the support points and go along lines between them."""
    model, gaps, sizes, points = body_of(made.carried), [0.0], [0.0], 0
    notes = ["between support points the torque is taken along straight lines"]
    for name in (name for name in (SPEED, POSITION) if name in made.files):
        text = made.files[name].decode().splitlines()
        rows = np.loadtxt(text, delimiter=",", skiprows=1, ndmin=2)
        for j in range(model.robot.dof):
            _, x, y = rows[rows[:, 0] == j + 1].T
            if not len(x):
                continue
            places = np.random.default_rng(j).uniform(x[0], x[-1], STATES)
            want = curve_at(model, name, j, places)
            gap = float(np.abs(np.interp(places, x, y) - want).max())
            gaps, sizes = [*gaps, gap], [*sizes, float(np.abs(want).max())]
            points += len(places)
            notes.append(f"{name}, joint {j + 1}: {len(x)} points, {gap:.2g} N m off")
    by = "read back and taken between its support points"
    return Proof(by, points, max(gaps), max(sizes), tuple(notes))


def _slow(speed: np.ndarray) -> str:
    shown = ", ".join(f"{v:.3g}" for v in speed)
    return (
        f"compared above {shown} rad/s: below, dry friction here is smooth and there "
        "it jumps"
    )
