"""An MJCF file tried in MuJoCo."""

import numpy as np

from flows.proofs.proof import Proof, compared, extra, text_of
from residual.export.exported import Exported, Motion, body_of, random_states
from residual.export.simulators import saturated_speed
from residual.recording import Array

STATES = 1000
CREEP = 1e-3  # rad/s: dry friction must have its value from here on


def prove_mjcf(made: Exported) -> Proof:
    """Compare MuJoCo's inverse dynamics on random states, where friction is all there.

    Raises:
        InputError: If MuJoCo is not installed.
    """
    mujoco = extra("mujoco")
    model, text = body_of(made.carried), text_of(made)
    speed = saturated_speed(model)
    states = random_states(model.robot, STATES, speed)
    got = inverse(text, states)
    notes: tuple[str, ...] = ()
    if (np.array(loaded(text).dof_frictionloss) > 0).any():
        notes = (_slow(made, text, speed),)
    by = f"inverse dynamics of MuJoCo {mujoco.__version__}"
    return compared(by, got, model.torque(*states.parts), notes)


def loaded(text: str):
    """Return the compiled model of an MJCF text."""
    return extra("mujoco").MjModel.from_xml_string(text)


def inverse(text: str, states: Motion) -> Array:
    """Return the torque that MuJoCo finds for given states [N m]. Shape (n, dof)."""
    mujoco, model = extra("mujoco"), loaded(text)
    data, out = mujoco.MjData(model), np.empty_like(states.q)
    for i in range(len(out)):
        data.qpos[:], data.qvel[:], data.qacc[:] = (x[i] for x in states.parts)
        mujoco.mj_inverse(model, data)
        out[i] = data.qfrc_inverse
    return out


def _slow(made: Exported, text: str, speed: Array) -> str:
    """By how much the two differ where our dry friction is smooth."""
    model = body_of(made.carried)
    fast = random_states(model.robot, STATES, speed)
    rng = np.random.default_rng(1)  # the same states at every call
    qd = rng.uniform(-1, 1, fast.qd.shape) * speed
    slow = Motion(fast.t, fast.q, qd, 0 * fast.qdd)
    gap = np.abs(inverse(text, slow) - model.torque(*slow.parts)).max()
    shown = ", ".join(f"{v:.3g}" for v in speed)
    return (
        f"below {shown} rad/s dry friction is smooth here and jumps there: up to "
        f"{gap:.3g} N m apart while the joints creep"
    )
