"""The arm that is there: not quite its description, and with something hidden."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.robot.robot import Robot
from sim import kinds
from sim.background.draw import Background, draw_background
from sim.background.heat import warmth_after
from sim.background.torque import USUAL_SPEED, usual_power
from sim.catalogue import Acting, acting, changed, check_effect
from sim.plant.controller import maker_of
from sim.plant.rows import (
    channels_of,
    contacts_of,
    friction_rows,
    shared,
    torque_rows,
    used_rows,
)
from sim.plant.signal_faults import (
    EncoderFaults,
    encoder_errors,
    encoder_faults,
    torque_constants,
)
from sim.plant.tables import Constants, State
from sim.plant.thermal import warmth_at
from sim.plant.transmission import series_spring
from sim.records import Drives, PlantEffect, PlantSpec
from sim.streams import stream
from sim.synthetic.body import scatter
from sim.synthetic.room import room

Array = np.ndarray


@dataclass(frozen=True, eq=False, slots=True)
class Arm:
    """One arm, as built.

    Attributes:
        robot: Its description.
        effects: What it hides.
        model: True rigid body without the effects.
        base: True friction and rotors without the effects.
        own: What all its joints have undeclared, None if it is clean.
        worked: Usual work before its session began [s].
    """

    robot: Robot
    effects: tuple[PlantEffect, ...]
    model: pin.Model
    base: Drives
    own: Background | None = None
    worked: float = 0.0

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of its explicit torques."""
        return channels_of(self.effects, self.own)


@dataclass(frozen=True, eq=False, slots=True)
class Phase:
    """The arm between two onsets.

    Attributes:
        first: First step.
        last: Step after the last one.
        model: Rigid body.
        constants: Everything else, as the compiled step reads it.
        pushes: Effects that push the links from outside.
        errors: Constant, cosine, sine of the encoder errors [rad]. Shape (3, dof).
        faults: Encoders that are broken, None if none is.
    """

    first: int
    last: int
    model: pin.Model
    constants: Constants
    pushes: tuple[Acting, ...]
    errors: Array
    faults: EncoderFaults | None = None


def build_arm(robot: Robot, plant: PlantSpec) -> Arm:
    """Build the arm of a spec.

    Raises:
        UnknownNameError: On an unknown effect or parameter.
        InputError: On an effect that cannot be.
    """
    for effect in plant.effects:
        check_effect(effect, robot)
    rng = stream(plant.seed, "friction")
    factors = 1.0 + plant.scatter * rng.normal(size=(3, robot.dof))
    base = Drives(
        *(f * value for f, value in zip(factors, maker_of(robot), strict=True))
    )
    model = scatter(robot.model, plant.scatter, stream(plant.seed, "scatter"))
    own = draw_background(robot, plant.background, plant.seed, base.coulomb)
    return Arm(robot, plant.effects, model, base, own, plant.worked_before)


def new_state(arm: Arm, start: float) -> State:
    """Return the state of an arm that has worked since its session began.

    Args:
        start: Time since then [s].
    """
    dof, count = arm.robot.dof, len(arm.effects)
    memory = np.zeros((count + 1) * dof)
    rows = friction_rows(arm.base, arm.effects, range(count))
    for _, _, slot, _, constant, *_ in rows[rows[:, 0] == kinds.WARMUP]:
        memory[int(slot)] = warmth_at(start, constant)
    if arm.own is not None:
        # Oil and housing side by side, joint by joint, as `used_rows` finds them.
        warmth = warmth_after(arm.own, arm.worked + start)
        memory = np.concatenate([memory, warmth.T.ravel()])
    gears = len(shared(arm.effects))
    return State(np.zeros((3, dof)), np.zeros(dof + gears), memory)


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
    what, p, _, onset = acting([effect])[0]
    if what.begins:
        onset = max(onset, what.begins(p) * steps * dt)
    return int(np.ceil(onset / dt - 1e-6))


def _phase(
    arm: Arm, active: list[int], span: tuple[int, int], dt: float, series: Array
) -> Phase:
    effects = acting(arm.effects[i] for i in active)
    robot, dof = arm.robot, arm.robot.dof
    rotor = arm.base.rotor + _added(effects, dof)
    if rotor.min() <= 0:
        raise InputError(
            f"The effects leave the rotor of joint {int(rotor.argmin()) + 1} with "
            f"{rotor.min():g} kg m^2, expected more than 0. Take a smaller change."
        )
    springs = _springs(effects, rotor, arm.own)
    elastic = (springs[0] > 0).astype(float)
    errors = encoder_errors(effects, dof)
    usual = USUAL_SPEED * room(robot).velocity
    constants = Constants(
        dt=dt,
        rotor=rotor,
        elastic=elastic,
        stiffness=springs[0],
        damping=springs[1],
        gap=springs[2],
        ratio=torque_constants(effects, dof) / (1.0 + _gain(arm.own)),
        limit=np.array(robot.torque_limit, dtype=float),
        power=usual_power(arm.base.coulomb, arm.base.viscous, usual),
        shift=errors[0],
        cos=errors[1],
        sin=errors[2],
        contacts=contacts_of(arm.effects, active, elastic),
        friction=friction_rows(arm.base, arm.effects, active, arm.own),
        torque=torque_rows(arm.effects, active, arm.own),
        series=series,
        used=used_rows(arm.own, (len(arm.effects) + 1) * dof),
    )
    faults = encoder_faults(effects, dt)
    pushes = tuple(effect for effect in effects if effect.what.push)
    model = changed(arm.model, effects)
    return Phase(*span, model, constants, pushes, errors, faults)


def _added(effects: Sequence[Acting], dof: int) -> Array:
    """Return what the effects add to the rotors [kg m^2]. Shape (dof,)."""
    total = np.zeros(dof)
    for what, p, joints, _ in effects:
        if what.of_drive == "rotor":
            total[list(joints)] += p[what.amount[0]]
    return total


def _gain(own: Background | None) -> Array | float:
    return 0.0 if own is None else own.gain


def _springs(effects: Sequence[Acting], rotor: Array, own: Background | None) -> Array:
    """Return stiffness, damping and half gap of each joint; rigid ones 0. (3, dof)."""
    springs = np.zeros((3, len(rotor)))
    for j in range(len(rotor)):
        here = [(e.what, e.p) for e in effects if j in e.joints]
        compliances = [what.compliance(p) for what, p in here if what.compliance]
        gaps = [what.gap(p) for what, p in here if what.gap]
        if own is not None:
            compliances.append(own.twist[j] / own.span[j])
        if compliances or gaps:
            springs[:, j] = series_spring(compliances, gaps, rotor[j])
    return springs
