"""The arm that is there: not quite its description, and with something hidden."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.robot.robot import Robot
from sim.plant.bodies import scattered, with_effects
from sim.plant.controller import Maker, maker_of
from sim.plant.perturbations import check_effect, parameters
from sim.plant.rows import contacts_of, friction_rows, torque_rows
from sim.plant.sensor_faults import EncoderFaults, encoder_faults
from sim.plant.signal_faults import encoder_errors, torque_constants
from sim.plant.tables import Constants, State
from sim.plant.thermal import SLOW, warmth_at
from sim.plant.transmission import series_spring
from sim.records import PlantEffect, PlantSpec
from sim.synthetic.room import room
from sim.synthetic.seeds import stream

Array = np.ndarray

_USUAL_SPEED = 0.35  # of the speed of the robot's room


@dataclass(frozen=True, eq=False, slots=True)
class Arm:
    """One arm, as built.

    Attributes:
        robot: Its description.
        effects: What it hides.
        model: True rigid body without the effects.
        base: True friction and rotors without the effects.
    """

    robot: Robot
    effects: tuple[PlantEffect, ...]
    model: pin.Model
    base: Maker


@dataclass(frozen=True, eq=False, slots=True)
class Phase:
    """The arm between two onsets.

    Attributes:
        first: First step.
        last: Step after the last one.
        model: Rigid body.
        constants: Everything else, as the compiled step reads it.
        force: Force on the flange in the base frame [N]. Shape (3,), or None.
        errors: Constant, cosine, sine of the encoder errors [rad]. Shape (3, dof).
        faults: Encoders that are broken, None if none is.
    """

    first: int
    last: int
    model: pin.Model
    constants: Constants
    force: Array | None
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
    base = Maker(
        *(f * value for f, value in zip(factors, maker_of(robot), strict=True))
    )
    model = scattered(robot, plant.scatter, plant.seed)
    return Arm(robot, plant.effects, model, base)


def new_state(arm: Arm, start: float) -> State:
    """Return the state of an arm that has worked since its session began.

    Args:
        arm: The arm.
        start: Time since then [s].
    """
    dof, count = arm.robot.dof, len(arm.effects) + 1
    pairs = sum(effect.name == "coupled_friction" for effect in arm.effects)
    memory = np.zeros(count * dof)
    for i, effect in enumerate(arm.effects):
        if effect.name == "warmup":
            constant = parameters(effect)["time_constant"]
            memory[i * dof : (i + 1) * dof] = warmth_at(start, constant)
    memory[-dof:] = warmth_at(start, SLOW)
    return State(np.zeros((3, dof)), np.zeros(dof + pairs), memory)


def phases(arm: Arm, steps: int, dt: float, series: Array) -> list[Phase]:
    """Return the arm between the onsets of its effects.

    Args:
        arm: The arm.
        steps: Number of control steps.
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
    onset = effect.onset
    if effect.name == "x_friction_jump":
        onset = max(onset, parameters(effect)["share"] * steps * dt)
    return int(np.ceil(onset / dt - 1e-6))


def _phase(
    arm: Arm, active: list[int], span: tuple[int, int], dt: float, series: Array
) -> Phase:
    effects = tuple(arm.effects[i] for i in active)
    robot, dof = arm.robot, arm.robot.dof
    rotor = arm.base.rotor + _added(effects, "rotor_inertia", "inertia", dof)
    if rotor.min() <= 0:
        raise InputError(
            f"Effect 'rotor_inertia' leaves joint {int(rotor.argmin()) + 1} with "
            f"{rotor.min():g} kg m^2, expected more than 0. Take a smaller change."
        )
    springs = _springs(effects, rotor)
    elastic = (springs[0] > 0).astype(float)
    errors = encoder_errors(effects, dof)
    usual = _USUAL_SPEED * room(robot).velocity
    constants = Constants(
        dt=dt,
        rotor=rotor,
        elastic=elastic,
        stiffness=springs[0],
        damping=springs[1],
        gap=springs[2],
        ratio=torque_constants(effects, dof),
        limit=np.array(robot.torque_limit, dtype=float),
        power=arm.base.coulomb * usual + arm.base.viscous * usual**2 + 1e-9,
        shift=errors[0],
        cos=errors[1],
        sin=errors[2],
        contacts=contacts_of(arm.effects, active, elastic),
        friction=friction_rows(arm.base, arm.effects, active),
        torque=torque_rows(arm.effects, active),
        series=series,
    )
    model = with_effects(arm.model, effects)
    faults = encoder_faults(effects, dt)
    return Phase(*span, model, constants, _force(effects), errors, faults)


def _added(effects: Sequence[PlantEffect], name: str, key: str, dof: int) -> Array:
    total = np.zeros(dof)
    for effect in effects:
        if effect.name == name:
            total[[j - 1 for j in effect.joints]] += parameters(effect)[key]
    return total


def _force(effects: Sequence[PlantEffect]) -> Array | None:
    forces = [
        [parameters(effect)[axis] for axis in "xyz"]
        for effect in effects
        if effect.name == "tool_force"
    ]
    return np.sum(forces, axis=0) if forces else None


def _springs(effects: Sequence[PlantEffect], rotor: Array) -> Array:
    """Return stiffness, damping and half gap of each joint; rigid ones 0. (3, dof)."""
    springs = np.zeros((3, len(rotor)))
    for joint in range(1, len(rotor) + 1):
        here = [effect for effect in effects if joint in effect.joints]
        compliances = [
            1.0 / parameters(e)["stiffness"] for e in here if e.name == "elasticity"
        ]
        gaps = [parameters(e)["half_gap"] for e in here if e.name == "backlash"]
        if compliances or gaps:
            springs[:, joint - 1] = series_spring(compliances, gaps, rotor[joint - 1])
    return springs
