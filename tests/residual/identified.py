"""Logs of known parameters for the tests of identification: no noise but what is asked.

Torque is made by Pinocchio's RNEA and written-out friction, never by a regressor.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from residual.recording import Recording
from residual.robot.dynamics import compute_inverse_dynamics as inverse_dynamics
from residual.robot.dynamics import read_inertial_parameters
from residual.robot.dynamics import replace_inertial_parameters as with_inertial
from residual.robot.robot import Robot
from tests.residual.arms import arm, urdf_text
from tests.synthetic.logs import write_csv

AXES = ("0 0 1", "0 1 0", "0 1 0")
VISCOUS, COULOMB, ROTOR = (2.0, 3.0, 1.0), (4.0, 5.0, 2.0), (0.3, 0.4, 0.1)


@dataclass(frozen=True, eq=False)
class Truth:
    """An arm whose body and friction are known and not the nominal ones."""

    robot: Robot
    parameters: np.ndarray

    def torque(self, q, qd, qdd, moving=True):
        """RNEA plus friction; the sign of a joint at rest is 0."""
        model = with_inertial(self.robot.model, self.parameters)
        friction = np.array(VISCOUS) * qd + np.array(COULOMB) * np.sign(qd)
        return inverse_dynamics(model, q, qd, qdd) + friction + np.array(ROTOR) * qdd


@cache
def truth() -> Truth:
    """Masses 20 % up, centres 1 cm off; bodies that exist."""
    robot = arm(AXES)
    parameters = read_inertial_parameters(robot.model).reshape(-1, 10) * 1.2
    parameters[:, 1:4] += 0.01 * parameters[:, :1]
    return Truth(robot, parameters.ravel())


def logs(count=2, noise=0.0, joints=(0, 1, 2), seed=0, duration=12.0):
    """Slow sines, exact in their derivatives; joints not named stand still."""
    known, out = truth(), []
    for k in range(count):
        rng = np.random.default_rng([seed, k])
        t = np.arange(round(250 * duration)) / 250
        w = 2 * np.pi * rng.uniform(0.15, 0.6, (3, 3))
        size = rng.uniform(0.2, 0.5, (3, 3)) * np.isin(range(3), joints)
        angle = t[:, None, None] * w + rng.uniform(0, 6, (3, 3))
        q = (size * np.sin(angle)).sum(axis=1)
        qd = (size * w * np.cos(angle)).sum(axis=1)
        tau = known.torque(q, qd, (-size * w**2 * np.sin(angle)).sum(axis=1))
        tau = tau + noise * rng.normal(size=tau.shape)
        out.append(Recording(f"log{k}", "any", 100.0 * k + t, q, tau))
    return out


def workplace(folder: Path, names: Iterable[str], seconds: float) -> Path:
    (folder / "arm.urdf").write_text(urdf_text(AXES))
    recordings = logs(len(names), noise=0.5, duration=seconds)
    for name, log in zip(names, recordings, strict=True):
        write_csv(folder / f"{name}.csv", log)
    return folder
