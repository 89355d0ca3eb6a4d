"""The arm that is there: not quite its description, and with something hidden."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine import laws
from sim.engine.records import Drives, PlantEffect, PlantSpec, stream
from sim.plant import tables as at
from sim.plant.background import (
    USUAL_SPEED,
    Background,
    draw_background,
    usual_power,
    warmth_after,
)
from sim.plant.catalogue import Acting, acting, changed, check_effect
from sim.plant.sensors import (
    EncoderFaults,
    encoder_errors,
    encoder_faults,
    torque_constants,
)
from sim.plant.sizes import maker_of, scatter, usual_limits
from sim.plant.step import SLOW, series_spring, warmth_at
from sim.plant.tables import Constants, PlantState

Effects = Sequence[PlantEffect]
COGGING = "background"  # channel of what the background adds beside friction


def channels_of(
    effects: Effects, background: Background | None = None
) -> tuple[str, ...]:
    """Return what has a torque channel: effects by name, then that of a background."""
    names = sorted({e.kind.name for e in acting(effects) if e.kind.has_channel})
    return (*names, COGGING) if background is not None else tuple(names)


def contacts_of(effects: Effects, active: Sequence[int], elastic: Array) -> Array:
    """Return the contacts (`Constants`). Shape (c, 6).

    A shared gear that does not act yet is there, without friction and inertia.
    """
    dof = len(elastic)
    motor = np.where(elastic > 0, dof + np.cumsum(elastic) - 1, np.arange(dof))
    rows = [(motor[j], -1.0, 0.0, j, -1.0, 0.0) for j in range(dof)]
    for i, gear in shared(effects):
        inertia, sign, *_ = gear.kind.gear(gear.p)
        one, two = gear.joints
        inertia = inertia if i in active else 0.0
        rows.append((motor[one], motor[two], sign, one, two, inertia))
    return np.array(rows, dtype=float)


def shared(effects: Effects) -> list[tuple[int, Acting]]:
    """Return the gears that two joints share, with their place among the effects."""
    return [(i, e) for i, e in enumerate(acting(effects)) if e.kind.gear]


def friction_rows(
    base: Drives,
    effects: Effects,
    active: Sequence[int],
    background: Background | None = None,
) -> Array:
    """Return the rows of friction that act. Shape (f, WIDTH)."""
    dof, hidden = len(base.coulomb), acting(effects)
    rows = []
    for j in range(dof):
        rows.append(_row(j, 0, (laws.LEVEL, base.coulomb[j])))
        rows.append(_row(j, 0, (laws.VISCOUS, base.viscous[j])))
        rows.append(_row(j, len(effects) * dof + j, (laws.WARMUP, 0.0, SLOW)))
    gears = {i: dof + n for n, (i, _) in enumerate(shared(effects))}
    for i in active:
        kind, p, joints, _ = hidden[i]
        if kind.gear:
            _, _, level, coefficient = kind.gear(p)
            rows.append(_row(gears[i], 0, (laws.LEVEL, level)))
            rows.append(_row(gears[i], 0, (laws.VISCOUS, coefficient)))
        if kind.friction:
            rows += [
                _row(j, i * dof + j, kind.friction(p, base.coulomb[j])) for j in joints
            ]
    for j in range(dof if background is not None else 0):
        rows.append(_row(j, 0, (laws.FADING, background.level[j], background.speed[j])))
        rows.append(_row(j, 0, (laws.PRESSED, background.press[j], background.span[j])))
    return np.array(rows)


def torque_rows(
    effects: Effects, active: Sequence[int], background: Background | None = None
) -> Array:
    """Return the rows of explicit torque that act. Shape (e, WIDTH)."""
    channels, columns = channels_of(effects, background), _columns(effects)
    hidden, rows = acting(effects), []
    for i in active:
        kind, p, joints, _ = hidden[i]
        if kind.series:
            channel = channels.index(kind.name)
            rows += [_row(j, channel, (laws.SERIES, columns[i, j])) for j in joints]
        if kind.torque:
            channel, numbers = channels.index(kind.name), kind.torque(p, joints)
            on = joints[:1] if kind.scope == "pair" else joints
            rows += [_row(j, channel, numbers) for j in on]
    for wave in background.waves if background is not None else ():
        channel = channels.index(COGGING)
        rows += [_row(j, channel, (laws.WAVE, *row)) for j, row in enumerate(wave)]
    return np.array(rows, dtype=float).reshape(-1, at.WIDTH)


def used_rows(background: Background | None, first: int) -> Array:
    """Return what friction of each joint is by direction and warmth (`Constants`)."""
    if background is None:
        return np.zeros((0, 5))
    slots = first + 2 * np.arange(len(background.span))
    return np.column_stack(
        [background.lean, background.growth, background.oil, background.housing, slots]
    )


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
        kind, p, *_ = hidden[i]
        rng = stream(seed, f"effect/{i}/{kind.name}/{j}/{label}")
        out[:, column] = kind.series(p, t, rng)
    return out


def _columns(effects: Effects) -> dict[tuple[int, int], int]:
    """Return the column of each torque over time, by effect and joint (from 0)."""
    hidden = enumerate(acting(effects))
    keys = [(i, j) for i, e in hidden if e.kind.series for j in e.joints]
    return {key: column for column, key in enumerate(keys)}


def _row(place: int, slot: int, row: Sequence[float]) -> list[float]:
    kind, *numbers = row
    padding = [0.0] * (at.WIDTH - 3 - len(numbers))
    return [float(kind), float(place), float(slot), *map(float, numbers), *padding]


@dataclass(frozen=True, eq=False, slots=True)
class Arm:
    """One arm, as built."""

    robot: Robot
    effects: tuple[PlantEffect, ...]  # what it hides
    model: pin.Model  # true rigid body without the effects
    base: Drives  # true friction and rotors without the effects
    # What all its joints have undeclared, None if it is clean.
    background: Background | None = None
    worked: float = 0.0  # usual work before its session began [s]

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of its explicit torques."""
        return channels_of(self.effects, self.background)


@dataclass(frozen=True, eq=False, slots=True)
class Phase:
    """The arm between two onsets."""

    first: int
    last: int  # step after the last one
    model: pin.Model  # rigid body
    constants: Constants  # everything else, as the compiled step reads it
    pushes: tuple[Acting, ...]  # effects that push the links from outside
    errors: Array  # constant, cosine, sine of the encoder errors [rad], (3, dof)
    faults: EncoderFaults | None = None  # encoders that are broken, None if none is


def build_arm(robot: Robot, plant: PlantSpec) -> Arm:
    """Build the arm of a spec."""
    for effect in plant.effects:
        check_effect(effect, robot)
    rng = stream(plant.seed, "friction")
    factors = 1.0 + plant.scatter * rng.normal(size=(3, robot.dof))
    base = Drives(
        *(f * value for f, value in zip(factors, maker_of(robot), strict=True))
    )
    model = scatter(robot.model, plant.scatter, stream(plant.seed, "scatter"))
    background = draw_background(robot, plant.background, plant.seed, base.coulomb)
    return Arm(robot, plant.effects, model, base, background, plant.worked_before)


def new_state(arm: Arm, start: float) -> PlantState:
    """Return the state of an arm that has worked since its session began."""
    dof, count = arm.robot.dof, len(arm.effects)
    memory = np.zeros((count + 1) * dof)
    rows = friction_rows(arm.base, arm.effects, range(count))
    for _, _, slot, _, constant, *_ in rows[rows[:, 0] == laws.WARMUP]:
        memory[int(slot)] = warmth_at(start, constant)
    if arm.background is not None:
        # Oil and housing side by side, joint by joint, as `used_rows` finds them.
        warmth = warmth_after(arm.background, arm.worked + start)
        memory = np.concatenate([memory, warmth.T.ravel()])
    gears = len(shared(arm.effects))
    return PlantState(np.zeros((3, dof)), np.zeros(dof + gears), memory)


def phases(arm: Arm, steps: int, dt: float, series: Array) -> list[Phase]:
    """Return the arm between the onsets of its effects.

    Args:
        dt: Time step [s].
        series: Torques given over time, one per effect and joint [N m]. (steps, s).
    """
    onsets = [first_step(effect, steps, dt) for effect in arm.effects]
    starts = sorted({0, *(k for k in onsets if k < steps)})
    out = []
    for first, last in zip(starts, [*starts[1:], steps], strict=True):
        active = [i for i, k in enumerate(onsets) if k <= first]
        out.append(_phase(arm, active, (first, last), dt, series))
    return out


def first_step(effect: PlantEffect, steps: int, dt: float) -> int:
    """Return the first control step on which an effect acts."""
    kind, p, _, onset = acting([effect])[0]
    if kind.begins:
        onset = max(onset, kind.begins(p) * steps * dt)
    return int(np.ceil(onset / dt - 1e-6))


def _phase(
    arm: Arm, active: list[int], span: tuple[int, int], dt: float, series: Array
) -> Phase:
    effects = acting(arm.effects[i] for i in active)
    robot, dof = arm.robot, arm.robot.dof
    change = np.zeros(dof)
    for kind, p, joints, _ in effects:
        if kind.of_drive == "rotor":
            change[list(joints)] += p[kind.amount[0]]
    rotor = arm.base.rotor + change
    if rotor.min() <= 0:
        raise InputError(
            f"The effects leave the rotor of joint {int(rotor.argmin()) + 1} with "
            f"{rotor.min():g} kg m^2, expected more than 0. Take a smaller change."
        )
    springs = _springs(effects, rotor, arm.background)
    elastic = (springs[0] > 0).astype(float)
    errors = encoder_errors(effects, dof)
    speed = USUAL_SPEED * usual_limits(robot).velocity
    gain = 0.0 if arm.background is None else arm.background.gain
    constants = Constants(
        dt=dt,
        rotor=rotor,
        elastic=elastic,
        stiffness=springs[0],
        damping=springs[1],
        gap=springs[2],
        ratio=torque_constants(effects, dof) / (1.0 + gain),
        limit=np.array(robot.torque_limit, dtype=float),
        power=usual_power(arm.base.coulomb, arm.base.viscous, speed),
        shift=errors[0],
        cos=errors[1],
        sin=errors[2],
        contacts=contacts_of(arm.effects, active, elastic),
        friction=friction_rows(arm.base, arm.effects, active, arm.background),
        torque=torque_rows(arm.effects, active, arm.background),
        series=series,
        used=used_rows(arm.background, (len(arm.effects) + 1) * dof),
    )
    faults = encoder_faults(effects, dt)
    pushes = tuple(effect for effect in effects if effect.kind.push)
    model = changed(arm.model, effects)
    return Phase(*span, model, constants, pushes, errors, faults)


def _springs(
    effects: Sequence[Acting], rotor: Array, background: Background | None
) -> Array:
    """Return stiffness, damping and half gap of each joint; rigid ones 0. (3, dof)."""
    springs = np.zeros((3, len(rotor)))
    for j in range(len(rotor)):
        soft = [
            e.kind.transmission(e.p)
            for e in effects
            if j in e.joints and e.kind.transmission
        ]
        compliances = [compliance for compliance, _ in soft if compliance]
        gaps = [gap for _, gap in soft if gap]
        if background is not None:
            compliances.append(background.twist[j] / background.span[j])
        if compliances or gaps:
            springs[:, j] = series_spring(compliances, gaps, rotor[j])
    return springs
