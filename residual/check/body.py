"""Whether the robot file describes an arm that can be."""

import numpy as np

from residual.check.result import Fault, Repair
from residual.names import listed
from residual.robot.dynamics import joints_length
from residual.robot.robot import Robot

_HEAVIEST = 1e3  # kg/m^3 of the cube of the reach: arms have 1 to 200
_LIGHTEST = 1e-2  # kg/m^3: air weighs 1.2
_LONGEST = 50.0  # m
_WIDE = 3.0  # radius of gyration in reaches
_EARTH = (9.6, 10.0)  # m/s^2
_LARGEST_GRAVITY = 30.0  # m/s^2
_NEGATIVE = 1e-3  # of the largest moment
_TRIANGLE = 0.7  # of the largest moment: files round, and vendors simplify


def body_faults(robot: Robot) -> list[Fault]:
    """Check lengths, masses, inertias and gravity of the robot file."""
    return [fault for part in (_units, _gravity, _inertias) if (fault := part(robot))]


def _units(robot: Robot) -> Fault | None:
    bodies = list(robot.model.inertias)[1:]
    mass, reach = sum(b.mass for b in bodies), joints_length(robot.model)
    density = mass / max(reach, 1e-6) ** 3
    what = f"The arm weighs {mass:.4g} kg and reaches {reach:.4g} m"
    if reach > _LONGEST:
        words, repair = "its lengths look like millimetres", 1e-3
    elif density > _HEAVIEST and reach > 0.05:
        words, repair = "its masses look like grams", 1e-3
    elif reach < 0.01 and mass > 1:
        words, repair = "its lengths look like kilometres", 1e3
    elif density < _LIGHTEST:
        words, repair = "its masses look like tonnes", 1e3
    else:
        return None
    return Fault(
        "robot_file", (), True, f"{what}: {words}.", (Repair("robot", scale=repair),)
    )


def _gravity(robot: Robot) -> Fault | None:
    size = float(np.linalg.norm(robot.model.gravity.linear))
    if size == 0 or _EARTH[0] < size < _EARTH[1]:
        return None
    certain = size > _LARGEST_GRAVITY
    words = f"Gravity is {size:.4g} m/s^2 in the robot file, expected 9.81."
    return Fault("robot_file", (), certain, words)


def _inertias(robot: Robot) -> Fault | None:
    """Bodies whose moments no mass can have; with none at all they are left alone."""
    reach, impossible, doubtful, words = joints_length(robot.model), [], [], []
    for joint, body in enumerate(list(robot.model.inertias)[1:], start=1):
        moments = np.linalg.eigvalsh(body.inertia)
        largest = float(np.abs(moments).max())
        radius = np.sqrt(largest / max(body.mass, 1e-9))
        if body.mass < 0 or moments[0] < -_NEGATIVE * largest:
            impossible.append(joint)
            words.append(f"link {joint} has a moment of {moments[0]:.3g} kg m^2")
        elif body.mass > 1e-3 and radius > _WIDE * max(reach, 0.1):
            impossible.append(joint)
            words.append(f"the mass of link {joint} is spread over {radius:.3g} m")
        elif moments[2] - moments[0] - moments[1] > _TRIANGLE * largest:
            doubtful.append(joint)
            words.append(f"link {joint} has moments {listed(moments, '.3g')} kg m^2")
    if not words:
        return None
    joints = tuple(sorted(impossible + doubtful))
    evidence = f"No body is like that: {'; '.join(words)}."
    return Fault("robot_file", joints, bool(impossible), evidence)
