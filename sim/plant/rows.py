"""From effects to the rows of friction and torque that the compiled step reads."""

from collections.abc import Sequence

import numpy as np

from sim import kinds
from sim.background.draw import Background
from sim.catalogue import Acting, acting
from sim.plant import tables as at
from sim.plant.thermal import SLOW
from sim.records import Drives, PlantEffect
from sim.streams import stream

Array = np.ndarray
Effects = Sequence[PlantEffect]
COGGING = "background"  # channel of what the background adds beside friction


def channels_of(effects: Effects, own: Background | None = None) -> tuple[str, ...]:
    """Return what has a torque channel: effects by name, then that of a background."""
    names = sorted({e.what.name for e in acting(effects) if e.what.has_channel})
    return (*names, COGGING) if own is not None else tuple(names)


def contacts_of(effects: Effects, active: Sequence[int], elastic: Array) -> Array:
    """Return the contacts (`Constants`). Shape (c, 6).

    A shared gear that does not act yet is there, without friction and inertia.
    """
    dof = len(elastic)
    motor = np.where(elastic > 0, dof + np.cumsum(elastic) - 1, np.arange(dof))
    rows = [(motor[j], -1.0, 0.0, j, -1.0, 0.0) for j in range(dof)]
    for i, gear in shared(effects):
        inertia, sign, *_ = gear.what.gear(gear.p)
        one, two = gear.joints
        inertia = inertia if i in active else 0.0
        rows.append((motor[one], motor[two], sign, one, two, inertia))
    return np.array(rows, dtype=float)


def shared(effects: Effects) -> list[tuple[int, Acting]]:
    """Return the gears that two joints share, with their place among the effects."""
    return [(i, e) for i, e in enumerate(acting(effects)) if e.what.gear]


def friction_rows(
    base: Drives,
    effects: Effects,
    active: Sequence[int],
    own: Background | None = None,
) -> Array:
    """Return the rows of friction that act. Shape (f, WIDTH)."""
    dof, hidden = len(base.coulomb), acting(effects)
    rows = []
    for j in range(dof):
        rows.append(_row(j, 0, (kinds.LEVEL, base.coulomb[j])))
        rows.append(_row(j, 0, (kinds.VISCOUS, base.viscous[j])))
        rows.append(_row(j, len(effects) * dof + j, (kinds.WARMUP, 0.0, SLOW)))
    gears = {i: dof + n for n, (i, _) in enumerate(shared(effects))}
    for i in active:
        what, p, joints, _ = hidden[i]
        if what.gear:
            _, _, level, coefficient = what.gear(p)
            rows.append(_row(gears[i], 0, (kinds.LEVEL, level)))
            rows.append(_row(gears[i], 0, (kinds.VISCOUS, coefficient)))
        if what.friction:
            rows += [
                _row(j, i * dof + j, what.friction(p, base.coulomb[j])) for j in joints
            ]
    for j in range(dof if own is not None else 0):
        rows.append(_row(j, 0, (kinds.FADING, own.level[j], own.speed[j])))
        rows.append(_row(j, 0, (kinds.PRESSED, own.press[j], own.span[j])))
    return np.array(rows)


def torque_rows(
    effects: Effects, active: Sequence[int], own: Background | None = None
) -> Array:
    """Return the rows of explicit torque that act. Shape (e, WIDTH)."""
    channels, columns = channels_of(effects, own), _columns(effects)
    hidden, rows = acting(effects), []
    for i in active:
        what, p, joints, _ = hidden[i]
        if what.series:
            channel = channels.index(what.name)
            rows += [_row(j, channel, (kinds.SERIES, columns[i, j])) for j in joints]
        if what.torque:
            channel, numbers = channels.index(what.name), what.torque(p, joints)
            on = joints[:1] if what.scope == "pair" else joints
            rows += [_row(j, channel, numbers) for j in on]
    for wave in own.waves if own is not None else ():
        channel = channels.index(COGGING)
        rows += [_row(j, channel, (kinds.WAVE, *row)) for j, row in enumerate(wave)]
    return np.array(rows, dtype=float).reshape(-1, at.WIDTH)


def used_rows(own: Background | None, first: int) -> Array:
    """Return what friction of each joint is by direction and warmth (`Constants`).

    Args:
        own: The background, None for a clean arm, which has no row.
    """
    if own is None:
        return np.zeros((0, 5))
    slots = first + 2 * np.arange(len(own.span))
    return np.column_stack([own.lean, own.growth, own.oil, own.housing, slots])


def series_of(effects: Effects, t: Array, seed: int, label: str) -> Array:
    """Return the torques that follow a clock or chance, for a whole motion.

    Args:
        t: Session time [s]. Shape (n,).
        label: Name of the motion; chance differs from motion to motion.

    Returns:
        Torques [N m], a column per such effect and joint. Shape (n, s).
    """
    columns, hidden = _columns(effects), acting(effects)
    out = np.zeros((len(t), len(columns)))
    for (i, j), column in columns.items():
        what, p, *_ = hidden[i]
        rng = stream(seed, f"effect/{i}/{what.name}/{j}/{label}")
        out[:, column] = what.series(p, t, rng)
    return out


def _columns(effects: Effects) -> dict[tuple[int, int], int]:
    """Return the column of each torque over time, by effect and joint (from 0)."""
    hidden = enumerate(acting(effects))
    keys = [(i, j) for i, e in hidden if e.what.series for j in e.joints]
    return {key: column for column, key in enumerate(keys)}


def _row(place: int, slot: int, row: Sequence[float]) -> list[float]:
    kind, *numbers = row
    padding = [0.0] * (at.WIDTH - 3 - len(numbers))
    return [float(kind), float(place), float(slot), *map(float, numbers), *padding]
