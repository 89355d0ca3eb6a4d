"""Draw what an arm hides: effect, joint and size, as on a 100-kg arm."""

from collections.abc import Callable, Mapping

import numpy as np

from residual.names import check_name
from residual.robot.robot import Robot
from sim.plant.perturbations import KINDS
from sim.records import PlantEffect
from sim.synthetic import effects
from sim.synthetic.draw import draw
from sim.synthetic.room import room
from sim.synthetic.sizes import sizes

Rng = np.random.Generator
Parameters = dict[str, float]

# What the diagnosis looks for today.
SOUGHT = tuple(sorted(effects.NAMED))


def draw_hidden(
    robot: Robot,
    stream: Rng,
    name: str | None = None,
    joint: int | None = None,
    every: bool = False,
) -> PlantEffect:
    """Draw one hidden effect.

    Args:
        robot: The robot; sizes scale with its torques and friction.
        stream: Random stream.
        name: Name of the effect; None to draw it too.
        joint: Joint from 1 (the first of a pair), None to draw it.
        every: Draw among the whole vocabulary, not only what is looked for today.

    Returns:
        The effect.

    Raises:
        UnknownNameError: On an unknown name.
    """
    if name is None:
        named = sorted(n for n in KINDS if not n.startswith("x_"))
        name = str(stream.choice(named if every else SOUGHT))
    check_name(name, KINDS, "effect of the plant")
    if name not in _SIZES:
        hidden = draw(robot, name, stream, joint)
        return _effect(name, hidden.joints, hidden.parameters)
    place = KINDS[name].scope
    joints = () if place == "global" else (joint or _joint(robot, name, stream),)
    return _effect(name, joints, _SIZES[name](stream, robot, (joints or (1,))[0] - 1))


def _effect(name: str, joints: tuple[int, ...], values: Mapping) -> PlantEffect:
    numbers = ((key, float(value)) for key, value in sorted(values.items()))
    return PlantEffect(name, tuple(int(j) for j in joints), tuple(numbers))


def _joint(robot: Robot, name: str, rng: Rng) -> int:
    # The first joints carry the arm: there springs, play and range show.
    heavy = name in ("elasticity", "backlash", "link_inertia", "saturation")
    return int(rng.integers(1, min(3, robot.dof) + 1 if heavy else robot.dof + 1))


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _angle(size: float, rng: Rng) -> tuple[float, float]:
    turn = rng.uniform(0, 2 * np.pi)
    return size * float(np.cos(turn)), size * float(np.sin(turn))


def _eccentricity(rng: Rng, robot: Robot, j: int) -> Parameters:
    cos, sin = _angle(np.deg2rad(rng.uniform(0.3, 1.0)), rng)
    return {"cos": cos, "sin": sin}


def _tilt(rng: Rng, robot: Robot, j: int) -> Parameters:
    x, y = _angle(np.deg2rad(rng.uniform(1.0, 4.0)), rng)
    return {"tilt_x": x, "tilt_y": y}


def _force(rng: Rng, robot: Robot, j: int) -> Parameters:
    push = rng.normal(size=3)
    push *= rng.uniform(10.0, 40.0) / np.linalg.norm(push)
    return dict(zip("xyz", map(float, push), strict=True))


def _wall(rng: Rng, robot: Robot, j: int) -> Parameters:
    space, side = room(robot), _sign(rng)
    angle = space.centre[j] + side * rng.uniform(0.1, 0.4) * space.amplitude[j]
    stiffness = rng.uniform(0.5, 1.0) * sizes(robot).torque[j]
    return {"angle": float(angle), "stiffness": float(stiffness), "side": side}


_SIZES: dict[str, Callable[[Rng, Robot, int], Parameters]] = {
    "link_inertia": lambda r, arm, j: {"scale": _sign(r) * r.uniform(0.15, 0.3)},
    "presliding": lambda r, arm, j: {
        "level": sizes(arm).coulomb[j],
        "displacement": r.uniform(0.003, 0.03),
    },
    "saturation": lambda r, arm, j: {
        "level": r.uniform(0.5, 0.75) * sizes(arm).torque[j]
    },
    "encoder_offset": lambda r, arm, j: {
        "angle": _sign(r) * np.deg2rad(r.uniform(0.5, 2.0))
    },
    "encoder_eccentricity": _eccentricity,
    "elasticity": lambda r, arm, j: {"stiffness": r.uniform(3e3, 1.5e4)},
    "backlash": lambda r, arm, j: {"half_gap": r.uniform(5e-4, 3e-3)},
    "base_tilt": _tilt,
    "delay": lambda r, arm, j: {"delay": r.uniform(0.004, 0.02)},
    "tool_force": _force,
    "x_dead_zone": lambda r, arm, j: {
        "level": r.uniform(0.02, 0.06) * sizes(arm).torque[j]
    },
    "x_wall": _wall,
    "x_fault_frozen": lambda r, arm, j: {},
    "x_fault_drift": lambda r, arm, j: {
        "rate": _sign(r) * np.deg2rad(r.uniform(0.02, 0.2))
    },
    "x_fault_torque_bias": lambda r, arm, j: {
        "torque": _sign(r) * r.uniform(0.1, 0.2) * sizes(arm).torque[j]
    },
    "x_fault_torque_gain": lambda r, arm, j: {"gain": -r.uniform(0.2, 0.4)},
    "x_fault_torque_spikes": lambda r, arm, j: {
        "size": _sign(r) * r.uniform(0.5, 1.0) * sizes(arm).torque[j]
    },
}
