"""Dry friction in MuJoCo, and a closed loop in it beside the same loop of ours."""

import numpy as np

from benchmarks.export_parts.models import ARMS, model_with, robot_of, term
from benchmarks.figures import Figures, figure
from flows.proofs.proof import CREEP, extra, inverse, mujoco_model, text_of
from residual.export.exported import Motion, exciting
from residual.export.simulators import STEP, to_mjcf
from residual.model.model import Model
from residual.robot.dynamics import (
    inertial_parameters,
    inverse_dynamics,
    mass_matrix,
)

SHORT = 1e-3  # of its value: what friction may lack where the joint creeps
SECONDS = 2.0
SUBSTEPS = 5  # of ours per step of MuJoCo
STIFF, DAMPED = 400.0, 40.0  # 1/s^2, 1/s of the loop


def mujoco_figures(quick: bool) -> Figures:
    """Friction at 1e-3 rad/s, and how far the two loops part."""
    arms = ARMS[:1] if quick else ARMS
    short = max(_short(arm) for arm in arms)
    loops = {arm: _loop(arm) for arm in arms}
    apart = max(a for a, _ in loops.values())
    told = {arm: f"{1e6 * t:.3g}" for arm, (_, t) in loops.items()}
    return {
        "mjcf_friction_short": figure(short, SHORT, 2 * len(arms)),
        "mjcf_loop_apart": figure(
            1e6 * apart, None, len(arms), what=f"error of the loop itself {told} µrad"
        ),
    }


def _short(arm: str) -> float:
    """By how much dry friction falls short of its value, as a share of it."""
    robot = robot_of(arm)
    whole = model_with(robot, "coulomb", speed_floor=np.full(robot.dof, 1e-5))
    (own,) = whole.terms
    (j,), zero = own.joints, np.zeros((2, robot.dof))
    qd = CREEP * np.array([[1.0], [-1.0]]) * np.ones(robot.dof)
    states = Motion(np.arange(2.0), zero, qd, zero)
    up, down = inverse(text_of(to_mjcf(whole)), states)[:, j]
    return float(1 - (up - down) / 2 / own.theta[0])


def _model(arm: str) -> Model:
    robot = robot_of(arm)
    names = ("viscous", "coulomb", "rotor_inertia")
    terms = [term(robot, n, j) for n in names for j in range(robot.dof)]
    terms += [term(robot, "payload"), term(robot, "spring", 1)]
    floor = np.full(robot.dof, 1e-3)
    return Model(robot, inertial_parameters(robot.model), tuple(terms), floor)


def _loop(arm: str) -> tuple[float, float]:
    """Largest distance of the loops, and of ours from its reference [rad]."""
    model = _model(arm)
    motion = exciting(model.robot, SECONDS, 1 / STEP)
    # Both drives know the rigid body as described and nothing else.
    forward = inverse_dynamics(model.robot.model, *motion.parts)
    scale = np.diag(mass_matrix(model.robot.model, motion.q[:1])[0]) + 0.6
    theirs = _in_mujoco(text_of(to_mjcf(model)), motion, forward, scale)
    ours = _ours(model, motion, forward, scale)
    return float(np.abs(theirs - ours).max()), float(np.abs(ours - motion.q).max())


def _drive(motion: Motion, k: int, q, qd, scale):
    return scale * (STIFF * (motion.q[k] - q) + DAMPED * (motion.qd[k] - qd))


def _in_mujoco(text: str, motion: Motion, forward, scale) -> np.ndarray:
    mujoco, model = extra("mujoco"), mujoco_model(text)
    model.actuator_ctrllimited[:] = 0
    data, out = mujoco.MjData(model), np.empty_like(motion.q)
    data.qpos[:], data.qvel[:] = motion.q[0], motion.qd[0]
    for k in range(len(out)):
        out[k] = data.qpos
        data.ctrl[:] = forward[k] + _drive(motion, k, data.qpos, data.qvel, scale)
        mujoco.mj_step(model, data)
    return out


def _ours(model: Model, motion: Motion, forward, scale) -> np.ndarray:
    """The model of ours by its own torque, semi-implicit steps of 0.2 ms."""
    q, qd, h = motion.q[0].copy(), motion.qd[0].copy(), STEP / SUBSTEPS
    dof, out = model.robot.dof, np.empty_like(motion.q)
    for k in range(len(out)):
        out[k] = q
        drive = forward[k] + _drive(motion, k, q, qd, scale)
        for _ in range(SUBSTEPS):
            # Torque is linear in acceleration: a row for each joint gives M and h.
            rows = np.vstack([np.zeros(dof), np.eye(dof)])
            torque = model.torque(*(np.tile(x, (dof + 1, 1)) for x in (q, qd)), rows)
            mass = (torque[1:] - torque[0]).T
            qd = qd + h * np.linalg.solve(mass, drive - torque[0])
            q = q + h * qd
    return out
