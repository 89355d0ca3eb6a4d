"""Light arms of seven joints, each of a geometry and masses of its own.

Sizes are of no maker: engineering judgement for an arm that a person can carry, with
strain wave gears, whose rotors seen from the link weigh as much as the links do.
"""

import json
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from residual.recording import Array
from residual.robot.robot import Robot, build_robot
from sim.engine.plant_records import create_random_stream
from sim.plant.effect_catalogue import list_drive_effects

NAME = "light"
_AXES = "zyzyzyz"  # rolls and pitches in turn
_MASS = (4.2, 4.0, 3.2, 3.0, 2.2, 1.8, 0.7)  # kg
_RADIUS = (0.065, 0.06, 0.055, 0.055, 0.05, 0.045, 0.04)  # m
_SPEED = (2.2, 2.2, 2.4, 2.4, 2.6, 2.6, 2.8)  # rad/s
_EFFORT = (110.0, 110.0, 70.0, 70.0, 35.0, 30.0, 20.0)  # N m
_COULOMB = (4.5, 5.0, 3.2, 3.0, 1.4, 1.2, 0.8)  # N m
_VISCOUS = (6.0, 6.5, 4.0, 4.0, 1.4, 1.2, 0.7)  # N m s/rad
_ROTOR = (0.8, 0.8, 0.5, 0.5, 0.16, 0.14, 0.09)  # kg m^2
_DRIVE = {"N m": _COULOMB, "N m s/rad": _VISCOUS, "kg m^2": _ROTOR}
_ROLL, _PITCH = 2.8, 1.9  # rad
_LINK = """<link name="link_{i}"><inertial>
<origin xyz="{centre}"/><mass value="{mass}"/>
<inertia ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"/></inertial>
</link>
<joint name="joint_{i}" type="revolute"><parent link="link_{before}"/>
<child link="link_{i}"/><origin xyz="{place}"/><axis xyz="{axis}"/>
<limit lower="-{reach}" upper="{reach}" velocity="{speed}" effort="{effort}"/></joint>
"""


class _Body(NamedTuple):
    """One link: where its joint is in the frame before, and its inertia."""

    place: Array  # (3,) m
    mass: float
    centre: Array  # (3,) m
    inertia: Array  # (3, 3) kg m^2 about the centre


@lru_cache(maxsize=16)
def draw_light_arm(seed: int) -> Robot:
    """Return an arm of about 20 kg, its friction and rotors declared with values."""
    rng = create_random_stream(seed, "light arm")
    urdf = [f'<robot name="{NAME}"><link name="link_0"/>']
    for i, body in enumerate(_bodies(rng)):
        urdf.append(_written(i, body))
    # By unit, since the drive's effects have their names in their own files.
    known = {
        unit: (e.name, key) for e in list_drive_effects() for key, unit in e.parameters.items()
    }
    declared = {
        name: {key: (np.array(values) * np.exp(0.2 * rng.normal(size=7))).tolist()}
        for unit, values in _DRIVE.items()
        for name, key in [known[unit]]
    }
    toml = json.dumps({"declared": declared}, sort_keys=True)
    return build_robot(NAME, "".join([*urdf, "</robot>"]), toml)


def _bodies(rng: np.random.Generator) -> list[_Body]:
    """Draw the links: shoulder, upper arm, forearm and wrist, the elbow set off."""
    base, upper, fore = rng.uniform((0.25, 0.30, 0.30), (0.35, 0.42, 0.40))
    elbow, wrist = rng.uniform((-0.09, 0.07), (0.09, 0.12))
    reach = np.array([base, upper / 2, upper / 2, fore / 2, fore / 2, wrist, wrist])
    places = [np.array([0, 0, z]) for z in (base / 2, base / 2, *reach[1:6])]
    places[3][0], places[4][0] = elbow, -elbow
    masses = np.array(_MASS) * np.exp(0.12 * rng.normal(size=7))
    bodies = []
    for i, (place, mass) in enumerate(zip(places, masses, strict=True)):
        along = rng.uniform(0.3, 0.6) * reach[i]
        centre = np.array([*rng.uniform(-0.025, 0.025, 2), along])
        tensor = _cylinder(float(mass), _RADIUS[i], reach[i])
        turned, _ = np.linalg.qr(np.eye(3) + 0.1 * rng.normal(size=(3, 3)))
        bodies.append(_Body(place, float(mass), centre, turned @ tensor @ turned.T))
    return bodies


def _cylinder(mass: float, radius: float, length: float) -> Array:
    """Inertia of a solid cylinder along z about its centre [kg m^2]. Shape (3, 3)."""
    across = mass * (3 * radius**2 + length**2) / 12
    return np.diag([across, across, mass * radius**2 / 2])


def _written(i: int, body: _Body) -> str:
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = body.inertia
    roll = _AXES[i] == "z"
    return _LINK.format(
        i=i + 1,
        before=i,
        centre=" ".join(map(repr, map(float, body.centre))),
        mass=body.mass,
        xx=xx,
        xy=xy,
        xz=xz,
        yy=yy,
        yz=yz,
        zz=zz,
        place=" ".join(map(repr, map(float, body.place))),
        axis="0 0 1" if roll else "0 1 0",
        reach=_ROLL if roll else _PITCH,
        speed=_SPEED[i],
        effort=_EFFORT[i],
    )
