"""From effects to the rows of friction and torque that the compiled step reads."""

from collections.abc import Sequence

import numpy as np

from sim import laws
from sim.plant import tables as at
from sim.plant.controller import Maker
from sim.plant.perturbations import parameters
from sim.plant.thermal import SLOW
from sim.records import PlantEffect

Array = np.ndarray
Effects = Sequence[PlantEffect]

_FRICTION = {
    "coulomb": (at.LEVEL, "level"),
    "x_friction_jump": (at.LEVEL, "level"),
    "coulomb_asymmetry": (at.ASYMMETRY, "level"),
    "viscous": (at.VISCOUS, "coefficient"),
    "viscous_asymmetry": (at.VISCOUS_ASYMMETRY, "coefficient"),
    "quadratic_viscous": (at.QUADRATIC, "coefficient"),
    "power_viscous": (at.POWER, "coefficient", "exponent"),
    "stribeck": (at.STRIBECK, "level", "velocity", "exponent"),
    "warmup": (at.WARMUP, "level", "time_constant"),
    "presliding": (at.BRISTLE, "level", "displacement"),
}
_TORQUE = {
    "offset": (at.CONSTANT, "torque"),
    "spring": (at.HOSE, "stiffness", "rest"),
    "ripple": (at.RIPPLE, "amplitude", "order", "phase"),
    "x_wall": (at.WALL, "stiffness", "angle", "side"),
    "x_dead_zone": (at.DEAD_ZONE, "level"),
    "x_cogging_sum": (at.COGGING_SUM, "amplitude", "order"),
    "balancer": (at.GAS_SPRING,),
}
SERIES = ("x_vibration", "x_square_wave", "x_random_walk")


def channels_of(effects: Effects) -> tuple[str, ...]:
    """Return the names of the effects that have a torque channel of their own."""
    own = {*_TORQUE, *SERIES, "tool_force"}
    return tuple(sorted({effect.name for effect in effects} & own))


def contacts_of(effects: Effects, active: Sequence[int], elastic: Array) -> Array:
    """Return the contacts (`Constants`). Shape (c, 6).

    A shared gear that does not act yet is there, without friction and inertia.
    """
    dof = len(elastic)
    motor = np.where(elastic > 0, dof + np.cumsum(elastic) - 1, np.arange(dof))
    rows = [(motor[j], -1.0, 0.0, j, -1.0, 0.0) for j in range(dof)]
    for i, effect in _shared(effects):
        first, second = (j - 1 for j in effect.joints)
        values = parameters(effect)
        inertia = values["inertia"] if i in active else 0.0
        sign = values["sign"]
        rows.append((motor[first], motor[second], sign, first, second, inertia))
    return np.array(rows, dtype=float)


def friction_rows(base: Maker, effects: Effects, active: Sequence[int]) -> Array:
    """Return the rows of friction that act. Shape (f, WIDTH)."""
    dof = len(base.coulomb)
    rows = []
    for j in range(dof):
        rows.append(_row(at.LEVEL, j, 0, base.coulomb[j]))
        rows.append(_row(at.VISCOUS, j, 0, base.viscous[j]))
        rows.append(_row(at.WARMUP, j, len(effects) * dof + j, 0.0, SLOW))
    gears = {i: dof + n for n, (i, _) in enumerate(_shared(effects))}
    for i in active:
        effect, values = effects[i], parameters(effects[i])
        if i in gears:
            rows.append(_row(at.LEVEL, gears[i], 0, values["level"]))
            rows.append(_row(at.VISCOUS, gears[i], 0, values["coefficient"]))
            continue
        for j in (joint - 1 for joint in effect.joints):
            rows += _friction_row(effect.name, values, (j, i * dof + j), base)
    return np.array(rows)


def _friction_row(name: str, p: dict, place: tuple[int, int], base: Maker) -> list:
    joint, slot = place
    if name in _FRICTION:
        kind, *keys = _FRICTION[name]
        return [_row(kind, joint, slot, *(p[key] for key in keys))]
    if name == "load_friction":
        floor = 0.1 * base.coulomb[joint]
        return [_row(at.CARRIED, joint, slot, p["coefficient"], floor)]
    if name == "position_friction":
        size, phase = np.hypot(p["cos"], p["sin"]), np.arctan2(p["sin"], p["cos"])
        return [_row(at.POSITION, joint, slot, size, phase)]
    return []


def torque_rows(effects: Effects, active: Sequence[int]) -> Array:
    """Return the rows of explicit torque that act. Shape (e, WIDTH)."""
    channels, columns = channels_of(effects), series_columns(effects)
    rows = []
    for i in active:
        effect, p = effects[i], parameters(effects[i])
        joints = [joint - 1 for joint in effect.joints]
        if effect.name in SERIES:
            channel = channels.index(effect.name)
            rows += [_row(at.SERIES, j, channel, columns[i, j]) for j in joints]
        elif effect.name in _TORQUE:
            kind, *keys = _TORQUE[effect.name]
            numbers = [p[key] for key in keys]
            if effect.name == "balancer":
                size = np.hypot(p["cos"], p["sin"]) / laws.gas_spring_peak()
                numbers = [size, np.arctan2(-p["cos"], p["sin"])]
            if effect.name == "x_cogging_sum":
                numbers.append(joints.pop())
            channel = channels.index(effect.name)
            rows += [_row(kind, j, channel, *numbers) for j in joints]
    return np.array(rows, dtype=float).reshape(-1, at.WIDTH)


def series_columns(effects: Effects) -> dict[tuple[int, int], int]:
    """Return the column of each torque over time, by effect and joint (from 0)."""
    keys = [
        (i, joint - 1)
        for i, effect in enumerate(effects)
        if effect.name in SERIES
        for joint in effect.joints
    ]
    return {key: column for column, key in enumerate(keys)}


def _shared(effects: Effects) -> list[tuple[int, PlantEffect]]:
    return [(i, e) for i, e in enumerate(effects) if e.name == "coupled_friction"]


def _row(kind: int, place: int, slot: int, *numbers: float) -> list[float]:
    padding = [0.0] * (at.WIDTH - 3 - len(numbers))
    return [float(kind), float(place), float(slot), *map(float, numbers), *padding]
