"""Draw a hidden effect: where it sits and how large it is."""

from collections.abc import Callable

import numpy as np

from residual.robot.robot import Robot
from sim.synthetic.body import outward
from sim.synthetic.room import room
from sim.synthetic.sizes import Sizes, sizes
from sim.synthetic.state import Hidden

Rng = np.random.Generator

_ON_LOADED_JOINTS = ("balancer", "torque_gain", "load_friction")


def draw(robot: Robot, effect: str, rng: Rng, joint: int | None = None) -> Hidden:
    """Draw one effect of usual size (a 100-kg arm: notes on the vocabulary).

    Args:
        robot: The robot; sizes scale with its torques and friction.
        effect: A name of `sim.synthetic.effects`.
        rng: Random stream.
        joint: Joint from 1 (the first of a pair), or None to draw it.

    Returns:
        The effect, on a joint where it makes sense.

    Raises:
        ValueError: If there is no such effect, or not on that joint.
    """
    if effect not in _SIZES:
        raise ValueError(f"No hidden effect {effect!r}; there are {sorted(_SIZES)}.")
    usual = sizes(robot)
    joints = _joints(robot, usual, effect, rng, joint)
    if not all(1 <= j <= robot.dof for j in joints):
        raise ValueError(f"{effect} cannot sit on joints {joints} of {robot.dof}.")
    if effect == "payload":
        return Hidden(effect, joints, _payload(robot, usual, rng))
    parameters = _SIZES[effect](rng, _AtJoint(usual, joints))
    if effect == "spring":
        parameters["rest"] += float(room(robot).centre[joints[0] - 1])
    return Hidden(effect, joints, parameters)


class _AtJoint:
    """Usual sizes at the weakest joint of an effect: R, fc, fv and jr."""

    def __init__(self, usual: Sizes, joints: tuple[int, ...]) -> None:
        rows = [j - 1 for j in joints]
        self.R = float(usual.torque[rows].min())
        self.fc = float(usual.coulomb[rows].min())
        self.fv = float(usual.viscous[rows].min())
        self.jr = float(usual.rotor[rows].min())


def _joints(
    robot: Robot, usual: Sizes, effect: str, rng: Rng, joint: int | None
) -> tuple[int, ...]:
    if effect == "payload":
        return (robot.dof,)
    if effect in ("coupled_friction", "x_cogging_sum"):
        if robot.dof < 2:
            raise ValueError(f"{effect} needs two joints.")
        # The last two pairs: in a wrist the motors drive their joints together.
        first = joint or robot.dof - int(rng.integers(1, min(3, robot.dof)))
        return (first, first + 1)
    if joint is not None:
        return (joint,)
    # Nine in ten where there is weight to balance or to carry, the rest anywhere.
    anywhere = rng.uniform() < 0.1 and effect != "balancer"
    if effect in _ON_LOADED_JOINTS and not anywhere:
        heavy = sorted(usual.loaded, key=lambda j: -usual.torque[j - 1])[:2]
        return (int(rng.choice(heavy)),)
    if effect in _ON_LOADED_JOINTS:
        return (int(rng.integers(1, max(2, robot.dof // 2 + 1))),)
    return (int(rng.integers(1, robot.dof + 1)),)


def _payload(robot: Robot, usual: Sizes, rng: Rng) -> dict[str, float]:
    """Draw 1 to 6 kg at 70 to 200 mm on a 100-kg arm, in proportion on others."""
    arm = sum(body.mass for body in list(robot.model.inertias)[1:])
    # The moving bodies of the 98-kg arm weigh 72 kg.
    mass = rng.uniform(1.0, 6.0) * min(1.0, arm / 72.0)
    axis = outward(robot.model)
    lateral = rng.uniform(-0.05, 0.05, 3)
    centre = rng.uniform(0.07, 0.2) * axis + lateral - (lateral @ axis) * axis
    x, y, z = (float(c) for c in centre)
    return {"mass": float(mass), "com_x": x, "com_y": y, "com_z": z}


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _split(size: float, angle: float) -> dict[str, float]:
    return {"cos": size * float(np.cos(angle)), "sin": size * float(np.sin(angle))}


def _turn(rng: Rng) -> float:
    return rng.uniform(0.0, 2 * np.pi)


_SIZES: dict[str, Callable[[Rng, _AtJoint], dict[str, float]]] = {
    "payload": lambda r, a: {},
    "viscous": lambda r, a: {"coefficient": r.uniform(0.3, 1.0) * a.fv},
    "coulomb": lambda r, a: {"level": r.uniform(0.3, 1.0) * a.fc},
    "rotor_inertia": lambda r, a: {"inertia": r.uniform(0.3, 1.0) * a.jr},
    "offset": lambda r, a: {"torque": _sign(r) * r.uniform(0.02, 0.06) * a.R},
    "coulomb_asymmetry": lambda r, a: {"level": _sign(r) * r.uniform(0.1, 0.4) * a.fc},
    "viscous_asymmetry": lambda r, a: {
        "coefficient": _sign(r) * r.uniform(0.1, 0.4) * a.fv
    },
    "quadratic_viscous": lambda r, a: {"coefficient": r.uniform(0.15, 0.5) * a.fv},
    "power_viscous": lambda r, a: {
        "coefficient": r.uniform(0.3, 1.0) * a.fv,
        "exponent": r.uniform(0.3, 0.7),
    },
    "stribeck": lambda r, a: {
        "level": r.uniform(0.2, 0.6) * a.fc,
        "velocity": r.uniform(0.03, 0.15),
    },
    "load_friction": lambda r, a: {"coefficient": r.uniform(0.03, 0.1)},
    "position_friction": lambda r, a: _split(r.uniform(0.2, 0.5) * a.fc, _turn(r)),
    "coupled_friction": lambda r, a: {
        "level": r.uniform(0.3, 0.8) * a.fc,
        "coefficient": r.uniform(0.1, 0.3) * a.fv,
        "sign": _sign(r),
    },
    "warmup": lambda r, a: {
        "level": r.uniform(0.3, 0.8) * a.fc,
        "time_constant": r.uniform(40.0, 150.0),
    },
    "spring": lambda r, a: {
        "stiffness": r.uniform(0.03, 0.1) * a.R,
        "rest": r.uniform(-0.3, 0.3),
    },
    # Near the phase that helps against weight: where else would one mount it?
    "balancer": lambda r, a: _split(
        _sign(r) * r.uniform(0.05, 0.15) * a.R, np.pi / 2 + r.uniform(-0.5, 0.5)
    ),
    "ripple": lambda r, a: {
        "amplitude": r.uniform(0.01, 0.04) * a.R,
        "order": r.uniform(6.0, 50.0),
        "phase": _turn(r),
    },
    "torque_gain": lambda r, a: {"gain": _sign(r) * r.uniform(0.05, 0.15)},
    "x_vibration": lambda r, a: {
        "amplitude": r.uniform(0.03, 0.06) * a.R,
        "frequency": r.uniform(2.0, 7.0),
        "phase": _turn(r),
    },
    "x_cogging_sum": lambda r, a: {
        "amplitude": r.uniform(0.03, 0.06) * a.R,
        "order": r.uniform(8.0, 14.0),
    },
    "x_random_walk": lambda r, a: {"amplitude": r.uniform(0.03, 0.06) * a.R},
    "x_square_wave": lambda r, a: {
        "amplitude": r.uniform(0.03, 0.06) * a.R,
        "frequency": r.uniform(0.2, 0.4),
    },
    "x_friction_jump": lambda r, a: {
        "level": r.uniform(0.4, 0.8) * a.fc,
        "share": r.uniform(0.4, 0.6),
    },
}
