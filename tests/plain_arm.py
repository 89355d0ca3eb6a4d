"""Logs of any arm by Pinocchio alone: body, friction, noise, and what is hidden."""

import numpy as np
import pinocchio as pin

from residual.recording import Recording
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import Robot

RATE = 200.0  # Hz
SCATTER = 0.02  # of the masses and tensors, that no file knows exactly
NOISE = 0.005  # of the rms of each joint's torque


def motion(robot: Robot, seconds: float, rng) -> tuple[np.ndarray, ...]:
    """Five harmonics a joint within its limits. Shapes (n,), and three of (n, dof)."""
    t = np.arange(0, seconds, 1 / RATE)
    low = np.where(np.isfinite(robot.lower), robot.lower, -1.5)
    high = np.where(np.isfinite(robot.upper), robot.upper, 1.5)
    half = np.minimum((high - low) / 2, 1.5)
    middle = np.clip(0.0, low + half, high - half)
    base = 2 * np.pi / 10.0
    out = np.zeros((3, len(t), robot.dof))
    for j in range(robot.dof):
        size = rng.normal(size=5) / np.arange(1, 6)
        phase = rng.uniform(0, 2 * np.pi, 5)
        w = base * np.arange(1, 6) * rng.uniform(0.9, 1.1)
        angle = np.outer(t, w) + phase
        q, qd = np.sin(angle) @ size, np.cos(angle) @ (size * w)
        limit = robot.velocity_limit[j] if robot.velocity_limit[j] < 1e3 else 3.0
        scale = min(0.85 * half[j] / np.abs(q).max(), 0.85 * limit / np.abs(qd).max())
        out[:, :, j] = (scale * q + middle[j], scale * qd, -scale * (np.sin(angle) @ (size * w**2)))
    return t, *out


def true_model(robot: Robot, rng) -> pin.Model:
    """The arm as it is: every body a little other than its file says."""
    true = pin.Model(robot.model)
    for i in range(1, true.njoints):
        body = true.inertias[i]
        by = 1 + SCATTER * rng.normal()
        true.inertias[i] = pin.Inertia(by * body.mass, body.lever, by * body.inertia)
    return true


def with_load(model: pin.Model, mass: float, at: np.ndarray) -> pin.Model:
    """The same arm with a small load in the frame of its last joint."""
    loaded = pin.Model(model)
    last = loaded.njoints - 1
    placed = pin.Inertia(mass, at, pin.Inertia.FromSphere(mass, 0.04).inertia)
    loaded.inertias[last] = loaded.inertias[last] + placed
    return loaded


def sizes(robot: Robot, model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    """Usual torque and speed of each joint, the same in all logs. Shapes (dof,)."""
    probe = motion(robot, 20.0, np.random.default_rng(0))
    usual = np.sqrt((compute_inverse_dynamics(model, *probe[1:]) ** 2).mean(axis=0))
    speed = np.sqrt((probe[2] ** 2).mean(axis=0))
    return np.maximum(usual, 0.05 * usual.max()), speed


def logs(robot, model, names, seed, hidden=None, seconds=20.0, friction=0.1):
    """Record logs of an arm.

    Args:
        model: Its true body.
        hidden: (q, qd, qdd) -> the torque of what nobody knows of. (n, dof).
        friction: Coulomb level, and viscous torque at usual speed, of the torque's rms.
    """
    out, rng = [], np.random.default_rng(seed)
    usual, speed = sizes(robot, model)
    for name in names:
        t, q, qd, qdd = motion(robot, seconds, rng)
        tau = compute_inverse_dynamics(model, q, qd, qdd)
        tau += friction * usual * (np.tanh(qd / (0.005 * speed)) + 0.6 * qd / speed)
        if hidden is not None:
            tau += hidden(q, qd, qdd)
        tau += NOISE * usual * rng.normal(size=tau.shape)
        q = q + 2e-5 * rng.normal(size=q.shape)
        out.append(Recording(id=name, robot=robot.name, t=t, q=q, tau=tau))
    return out


# Arms whose joints slide: name and type, axis, place, range, speed, effort, body.

_SCARA = (
    ("revolute", "0 0 1", "0 0 0.3", (-2.3, 2.3), 4, 120, 8, "0.2 0.01 0.02"),
    ("revolute", "0 0 1", "0.35 0 0", (-2.3, 2.3), 5, 60, 5, "0.15 0 0.03"),
    ("prismatic", "0 0 -1", "0.3 0 0", (0, 0.3), 1.2, 300, 2, "0.01 0 0.1"),
    ("revolute", "0 0 -1", "0 0 0", (-6, 6), 8, 10, 0.8, "0.03 0 0.05"),
)
_GANTRY = (
    ("prismatic", "1 0 0", "0 0 1", (-1, 1), 1.5, 800, 40, "0 0.3 0"),
    ("prismatic", "0 1 0", "0 0 0", (-0.6, 0.6), 1.5, 500, 18, "0 0 0"),
    ("prismatic", "0 0 1", "0 0 0", (-0.4, 0.4), 1, 600, 9, "0 0 -0.2"),
)
_RAIL = (
    ("prismatic", "0 1 0", "0 0 0.2", (-1.5, 1.5), 1.5, 2500, 60, "0 0 0.1"),
    ("revolute", "0 0 1", "0 0 0.3", (-2.8, 2.8), 2.5, 250, 12, "0.02 0 0.1"),
    ("revolute", "0 1 0", "0.1 0 0.2", (-1.8, 1.8), 2.5, 350, 10, "0 0.02 0.25"),
    ("revolute", "0 1 0", "0 0 0.5", (-2.4, 2.4), 3, 150, 6, "0.15 0 0.02"),
    ("revolute", "1 0 0", "0.3 0 0", (-3, 3), 4, 40, 2.5, "0.05 0 0.01"),
)
SLIDING = {"scara": _SCARA, "gantry": _GANTRY, "rail": _RAIL}


def sliding_arm(name: str) -> str:
    """URDF of a SCARA, of a gantry of three axes, or of an arm on a rail."""
    parts, parent = [f'<robot name="{name}"><link name="base"/>'], "base"
    for i, (kind, axis, at, span, v, e, mass, centre) in enumerate(SLIDING[name], 1):
        size = 0.02 * mass
        parts.append(
            f'<joint name="a{i}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="b{i}"/><origin xyz="{at}" rpy="0 0 0.1"/>'
            f'<axis xyz="{axis}"/><limit lower="{span[0]}" upper="{span[1]}" '
            f'velocity="{v}" effort="{e}"/></joint><link name="b{i}"><inertial>'
            f'<origin xyz="{centre}"/><mass value="{mass}"/><inertia ixx="{size}" '
            f'iyy="{1.2 * size}" izz="{0.9 * size}" ixy="0.001" ixz="0" iyz="0"/>'
            "</inertial></link>"
        )
        parent = f"b{i}"
    return "".join([*parts, "</robot>"])
