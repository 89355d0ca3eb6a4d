"""The real arm: scattered around its description, with hidden effects."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
import pinocchio as pin

from residual.errors import InputError, check_name
from residual.recording import Array
from residual.robot.robot import Robot, refuse_carried_weight
from sim.engine import friction_laws
from sim.engine.plant_records import (
    CLEAN,
    BackgroundWord,
    DriveParameters,
    PlantSpec,
    create_random_stream,
)
from sim.plant import step_tables as at
from sim.plant.drive_train_step import SLOW, combine_springs, compute_warmth_after
from sim.plant.effect_catalogue import (
    ActingEffect,
    apply_body_effects,
    check_effect,
    resolve_effects,
)
from sim.plant.sensors import (
    EncoderFaults,
    collect_encoder_faults,
    compute_torque_ratios,
    sum_encoder_errors,
)
from sim.plant.step_tables import PlantState, StepConstants
from sim.plant.typical_sizes import (
    compute_usual_motion_range,
    estimate_typical_sizes,
    read_nominal_drives,
    scatter_inertias,
)

# Small undeclared effects of every joint of a used arm, in forms of their own.
#
# Drawn from the seed of the arm, the same in all its runs; the laws are in
# `sim.engine.friction_laws`.

# Scale of all sizes.
_SCALE: Mapping[BackgroundWord, float] = {CLEAN: 0.0, "workshop": 1.0, "worn": 2.0}

# Engineering judgement, after logs of arms in use.
_LEVEL = (0.15, 0.5)  # of Coulomb friction
_SPEED = (0.03, 0.12)  # rad/s
_PRESS = (0.01, 0.05)  # of the torque that the gear carries
_LEAN = 0.08
_LOSS, _TIME = (0.05, 0.2), (100.0, 400.0)  # of all friction when warm; s
_QUICK = 0.25  # time constant of the housing over that of the oil
_RIPPLE, _ORDERS = (0.003, 0.012), (6.0, 30.0)  # of the torque range; per turn
_HARMONICS = ((1.0, 1.0), (2.0, 0.5), (3.0, 0.3))  # order and weight
_GAIN = 0.04
_TWIST = (3e-4, 1.5e-3)  # rad under the torque range
_CUTOFF, _STEP = 40.0, 0.001  # Hz; of the torque range
USUAL_SPEED = 0.35  # of the robot's usual speed


@dataclass(frozen=True, eq=False, slots=True)
class JointBackground:
    """The undeclared effects on all joints of one arm."""

    span: Array  # torque range that scales the sizes [N m], (dof,)
    level: Array  # extra dry friction at rest [N m], (dof,)
    speed: Array  # speed at which a third of it is left [rad/s], (dof,)
    press: Array  # friction per torque that the gear carries, at its range, (dof,)
    lean: Array  # part by which dry friction is more forwards, less backwards, (dof,)
    growth: Array  # cold friction over warm one, less one, (dof,)
    oil: Array  # time constant of the oil [s], (dof,)
    housing: Array  # time constant of the housing [s], (dof,)
    ripple: Array  # amplitude of each wave of cogging [N m], (h, dof)
    order: Array  # waves per turn, (h, dof)
    phase: Array  # phase of each wave [rad], (h, dof)
    gain: Array  # reported torque over real torque, less one, (dof,)
    twist: Array  # twist of the gear under the torque range [rad], (dof,)
    cutoff: Array  # corner of the low pass that torque goes through [Hz], (dof,)
    step: Array  # step of the reported torque [N m], (dof,)

    @property
    def waves(self) -> Array:
        """Amplitude, order and phase of each wave on each joint. Shape (h, dof, 3)."""
        return np.stack([self.ripple, self.order, self.phase], axis=-1)

    @property
    def drawn(self) -> dict[str, Array]:
        """Every number by name, those of several waves numbered. Shapes (dof,)."""
        out = {}
        for each in fields(self):
            value = getattr(self, each.name)
            if value.ndim == 1:
                out[each.name] = value
            else:
                out |= {f"{each.name}_{i}": v for i, v in enumerate(value, 1)}
        return out


def draw_background(
    robot: Robot, level: BackgroundWord, seed: int, coulomb: Array
) -> JointBackground | None:
    """Draw the background of one arm.

    Args:
        level: Its scale: "clean", "workshop", or "worn", twice as much.
        coulomb: True Coulomb friction of the arm [N m]. Shape (dof,).
    """
    scale = _SCALE[check_name(level, _SCALE, "background of the plant")]
    if scale == 0:
        return None
    span, dof = estimate_typical_sizes(robot).torque, robot.dof

    def uniform(name: str, low: float, high: float) -> Array:
        return create_random_stream(seed, f"background/{name}").uniform(low, high, dof)

    loss, time = scale * uniform("loss", *_LOSS), uniform("time", *_TIME)
    waves = _waves(scale * uniform("peak", *_RIPPLE) * span, seed)
    return JointBackground(
        span=span,
        level=scale * uniform("level", *_LEVEL) * coulomb,
        speed=uniform("speed", *_SPEED),
        press=scale * uniform("press", *_PRESS),
        lean=scale * uniform("lean", -_LEAN, _LEAN),
        growth=loss / (1.0 - loss),
        oil=_QUICK * time,
        housing=time,
        ripple=waves[0],
        order=waves[1],
        phase=waves[2],
        gain=scale * uniform("gain", -_GAIN, _GAIN),
        twist=scale * uniform("twist", *_TWIST),
        cutoff=np.full(dof, _CUTOFF / scale),
        step=scale * _STEP * span,
    )


def _waves(amplitude: Array, seed: int) -> Array:
    """Return amplitude, order and phase of waves whose sum has a given peak. (3, h, dof).

    A gear and its harmonics, of a random phase each.
    """
    rng, dof = create_random_stream(seed, "background/waves"), len(amplitude)
    multiple, weight = np.array(_HARMONICS).T[:, :, None]
    order = multiple * rng.uniform(*_ORDERS, dof)
    phase = rng.uniform(0.0, 2 * np.pi, order.shape)
    turn = np.linspace(-np.pi, np.pi, 7201)[:, None, None]
    peak = np.abs((weight * np.sin(order * turn + phase)).sum(axis=1)).max(axis=0)
    return np.array([weight * amplitude / peak, order, phase])


def compute_start_warmth(background: JointBackground, working_time: float) -> Array:
    """Return the warmth of oil and housing after some time of typical work. (2, dof)."""
    return 1.0 - np.exp(-working_time / np.array([background.oil, background.housing]))


def compute_usual_friction_power(coulomb: Array, viscous: Array, speed: Array) -> Array:
    """Return the power of friction in typical work, which warms by one unit [W]."""
    return coulomb * speed + viscous * speed**2 + 1e-9


def simulate_torque_logging(background: JointBackground | None, tau: Array, rate: float) -> Array:
    """Return a torque as logged: low-passed, rounded to steps [N m].

    Args:
        background: That of the arm; a clean one logs the torque unchanged.
    """
    if background is None:
        return tau
    from scipy.signal import lfilter

    out = np.empty_like(tau)
    for j, corner in enumerate(background.cutoff):
        keep = np.exp(-2 * np.pi * corner / rate)
        at_rest = [keep * tau[0, j]]
        out[:, j], _ = lfilter([1 - keep], [1, -keep], tau[:, j], zi=at_rest)
    return np.round(out / background.step) * background.step


COGGING = "background"  # channel of the background torques other than friction


def _row(place: int, slot: int, row: Sequence[float]) -> list[float]:
    kind, *numbers = row
    padding = [0.0] * (at.WIDTH - 3 - len(numbers))
    return [float(kind), float(place), float(slot), *map(float, numbers), *padding]


@dataclass(frozen=True, eq=False, slots=True)
class PlantArm:
    """One arm, as built."""

    robot: Robot
    effects: tuple[ActingEffect, ...]  # its hidden effects
    model: pin.Model  # true rigid body without the effects
    base: DriveParameters  # true friction and rotors without the effects
    # Undeclared effects of all its joints, None if it is clean.
    background: JointBackground | None = None
    worked: float = 0.0  # typical work before its session began [s]

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of its explicit torques: effects by name, then that of a background."""
        names = sorted({e.kind.name for e in self.effects if e.kind.has_channel})
        return (*names, COGGING) if self.background is not None else tuple(names)

    @property
    def gears(self) -> dict[int, ActingEffect]:
        """Gears that two joints share, by their place among the effects."""
        return {i: e for i, e in enumerate(self.effects) if e.kind.gear}

    @property
    def series(self) -> dict[tuple[int, int], int]:
        """Column of each torque over time, by effect and joint (from 0)."""
        keys = [(i, j) for i, e in enumerate(self.effects) if e.kind.series for j in e.joints]
        return {key: column for column, key in enumerate(keys)}

    def draw_torque_series(self, t: Array, seed: int, label: str) -> Array:
        """Return the torques driven by time or chance, for the whole motion.

        Args:
            t: Session time [s]. Shape (n,).
            label: Name of the motion; chance differs from motion to motion.

        Returns:
            Torques [N m], a column per such effect and joint. Shape (n, s).
        """
        out = np.zeros((len(t), len(self.series)))
        for (i, j), column in self.series.items():
            kind, p, *_ = self.effects[i]
            rng = create_random_stream(seed, f"effect/{i}/{kind.name}/{j}/{label}")
            out[:, column] = kind.series(p, t, rng)
        return out

    def build_contact_rows(self, active: Sequence[int], soft: Array) -> Array:
        """Return the contacts (`StepConstants`). Shape (c, 6).

        A shared gear before its onset has no friction or inertia.
        """
        dof = len(soft)
        motor = np.where(soft > 0, dof + np.cumsum(soft) - 1, np.arange(dof))
        rows = [(motor[j], -1.0, 0.0, j, -1.0, 0.0) for j in range(dof)]
        for i, gear in self.gears.items():
            inertia, sign, *_ = gear.kind.gear(gear.values)
            one, two = gear.joints
            inertia = inertia if i in active else 0.0
            rows.append((motor[one], motor[two], sign, one, two, inertia))
        return np.array(rows, dtype=float)

    def build_friction_rows(self, active: Sequence[int]) -> Array:
        """Return the rows of friction that act. Shape (f, WIDTH)."""
        dof, base, rows = self.robot.dof, self.base, []
        for j in range(dof):
            rows.append(_row(j, 0, (friction_laws.LEVEL, base.coulomb[j])))
            rows.append(_row(j, 0, (friction_laws.VISCOUS, base.viscous[j])))
            rows.append(_row(j, len(self.effects) * dof + j, (friction_laws.WARMUP, 0.0, SLOW)))
        contacts = {i: dof + n for n, i in enumerate(self.gears)}
        for i in active:
            kind, p, joints, _ = self.effects[i]
            if kind.gear:
                _, _, level, coefficient = kind.gear(p)
                rows.append(_row(contacts[i], 0, (friction_laws.LEVEL, level)))
                rows.append(_row(contacts[i], 0, (friction_laws.VISCOUS, coefficient)))
            if kind.friction:
                rows += [_row(j, i * dof + j, kind.friction(p, base.coulomb[j])) for j in joints]
        if (own := self.background) is not None:
            for j in range(dof):
                rows.append(_row(j, 0, (friction_laws.FADING, own.level[j], own.speed[j])))
                rows.append(_row(j, 0, (friction_laws.PRESSED, own.press[j], own.span[j])))
        return np.array(rows)

    def build_torque_rows(self, active: Sequence[int]) -> Array:
        """Return the rows of explicit torque that act. Shape (e, WIDTH)."""
        channels, columns, rows = self.channels, self.series, []
        for i in active:
            kind, p, joints, _ = self.effects[i]
            if kind.series:
                channel = channels.index(kind.name)
                rows += [_row(j, channel, (friction_laws.SERIES, columns[i, j])) for j in joints]
            if kind.torque:
                channel, numbers = channels.index(kind.name), kind.torque(p, joints)
                on = joints[:1] if kind.scope == "pair" else joints
                rows += [_row(j, channel, numbers) for j in on]
        for wave in self.background.waves if self.background is not None else ():
            channel = channels.index(COGGING)
            rows += [_row(j, channel, (friction_laws.WAVE, *row)) for j, row in enumerate(wave)]
        return np.array(rows, dtype=float).reshape(-1, at.WIDTH)

    def build_background_rows(self) -> Array:
        """Return friction of each joint by direction and warmth (`StepConstants`)."""
        if (own := self.background) is None:
            return np.zeros((0, 5))
        first, dof = (len(self.effects) + 1) * self.robot.dof, self.robot.dof
        slots = first + 2 * np.arange(dof)
        return np.column_stack([own.lean, own.growth, own.oil, own.housing, slots])


@dataclass(frozen=True, eq=False, slots=True)
class ArmPhase:
    """The arm between two onsets."""

    first: int
    end_step: int  # step after the last one
    model: pin.Model  # rigid body
    constants: StepConstants  # everything else, as the compiled step reads it
    pushes: tuple[ActingEffect, ...]  # effects that push the links from outside
    faults: EncoderFaults | None = None  # encoders that are broken, None if none is


def build_plant_arm(robot: Robot, plant: PlantSpec) -> PlantArm:
    """Build the arm of a spec."""
    refuse_carried_weight(robot, "the simulated arm")
    for effect in plant.effects:
        check_effect(effect, robot)
    rng = create_random_stream(plant.seed, "friction")
    factors = 1.0 + plant.scatter * rng.normal(size=(3, robot.dof))
    base = DriveParameters(
        *(f * value for f, value in zip(factors, read_nominal_drives(robot), strict=True))
    )
    if plant.drive is not None and plant.drive.damping:
        # Of the motor, not of its gears; to the arm it is the same.
        base = base._replace(viscous=base.viscous + np.array(plant.drive.damping))
    model = scatter_inertias(
        robot.model, plant.scatter, create_random_stream(plant.seed, "scatter")
    )
    background = draw_background(robot, plant.background, plant.seed, base.coulomb)
    effects = tuple(resolve_effects(plant.effects))
    return PlantArm(robot, effects, model, base, background, plant.worked_before)


def build_initial_state(arm: PlantArm, start: float) -> PlantState:
    """Return the state of an arm at some time of its session."""
    dof, count = arm.robot.dof, len(arm.effects)
    memory = np.zeros((count + 1) * dof)
    rows = arm.build_friction_rows(range(count))
    for _, _, slot, _, constant, *_ in rows[rows[:, 0] == friction_laws.WARMUP]:
        memory[int(slot)] = compute_warmth_after(start, constant)
    if arm.background is not None:
        # Oil and housing side by side, joint by joint (`PlantArm.build_background_rows`).
        warmth = compute_start_warmth(arm.background, arm.worked + start)
        memory = np.concatenate([memory, warmth.T.ravel()])
    return PlantState(np.zeros((3, dof)), np.zeros(dof + len(arm.gears)), memory)


def split_into_phases(arm: PlantArm, steps: int, dt: float, series: Array) -> list[ArmPhase]:
    """Return the arm between the onsets of its effects.

    Args:
        dt: Time step [s].
        series: Torques given over time, one per effect and joint [N m]. (steps, s).
    """
    onsets = [find_onset_step(effect, steps, dt) for effect in arm.effects]
    starts = sorted({0, *(k for k in onsets if k < steps)})
    out = []
    for first, last in zip(starts, [*starts[1:], steps], strict=True):
        active = [i for i, k in enumerate(onsets) if k <= first]
        out.append(_phase(arm, active, (first, last), dt, series))
    return out


def find_onset_step(effect: ActingEffect, steps: int, dt: float) -> int:
    """Return the first control step on which an effect acts."""
    kind, p, _, onset = effect
    if kind.onset_share:
        onset = max(onset, kind.onset_share(p) * steps * dt)
    return int(np.ceil(onset / dt - 1e-6))


def _phase(
    arm: PlantArm, active: list[int], span: tuple[int, int], dt: float, series: Array
) -> ArmPhase:
    effects = [arm.effects[i] for i in active]
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
    errors = sum_encoder_errors(effects, dof)
    speed = USUAL_SPEED * compute_usual_motion_range(robot).velocity
    gain = 0.0 if arm.background is None else arm.background.gain
    ratio = compute_torque_ratios(effects, dof) / (1.0 + gain)
    power = compute_usual_friction_power(arm.base.coulomb, arm.base.viscous, speed)
    joints = [rotor, elastic, *springs, ratio, robot.torque_limit, power, *errors]
    constants = StepConstants(
        dt=dt,
        joints=np.array(joints, dtype=float),
        contacts=arm.build_contact_rows(active, elastic),
        friction=arm.build_friction_rows(active),
        torque=arm.build_torque_rows(active),
        series=series,
        used=arm.build_background_rows(),
    )
    faults = collect_encoder_faults(effects, dt)
    pushes = tuple(effect for effect in effects if effect.kind.push)
    model = apply_body_effects(arm.model, effects)
    return ArmPhase(*span, model, constants, pushes, faults)


def _springs(
    effects: Sequence[ActingEffect], rotor: Array, background: JointBackground | None
) -> Array:
    """Return stiffness, damping and half gap of each joint; rigid ones 0. (3, dof)."""
    springs = np.zeros((3, len(rotor)))
    for j in range(len(rotor)):
        soft = [
            e.kind.transmission(e.values) for e in effects if j in e.joints and e.kind.transmission
        ]
        compliances = [compliance for compliance, _ in soft if compliance]
        gaps = [gap for _, gap in soft if gap]
        if background is not None:
            compliances.append(background.twist[j] / background.span[j])
        if compliances or gaps:
            springs[:, j] = combine_springs(compliances, gaps, rotor[j])
    return springs
