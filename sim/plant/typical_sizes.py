"""How far and fast a robot moves, how large its friction is; draws of what an arm hides."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.recording import Array
from residual.robot.dynamics import compute_gravity_torque, compute_inverse_dynamics
from residual.robot.robot import Robot
from sim.effects.base import Effect, Joints, PlantEffectTrait, Rng, TypicalJointSizes
from sim.engine.plant_records import (
    DriveParameters,
    PlantEffect,
    SyntheticEffect,
    TypicalSizes,
    create_random_stream,
)
from sim.plant.effect_catalogue import (
    check_effect_name,
    list_drive_effects,
    list_named_effects,
    list_plant_effects,
)

_MARGIN = 0.05  # rad kept free at each end of the range
_WIDEST = 1.3  # rad; larger sweeps add nothing and would hit a real cell
_SHARE_OF_SPEED = 0.5
_FASTEST = 3.0  # rad/s
_UNKNOWN_SPEED = 2.0  # rad/s, where the robot states no limit

# A six-axis arm of 100 kg: engineering judgement, not data of a manufacturer.
_ARM_100_KG = dict(
    torque=(57.0, 157.0, 54.0, 11.0, 7.0, 7.0),
    coulomb=(12.0, 14.0, 9.0, 4.0, 3.5, 2.5),
    viscous=(10.0, 11.0, 7.0, 2.5, 2.0, 1.5),
    rotor=(2.0, 2.0, 1.0, 0.3, 0.3, 0.15),
)


@dataclass(frozen=True, eq=False, slots=True)
class UsualMotionRange:
    """The range and speed of typical motions."""

    lower: Array  # lower end of the positions [rad], (dof,)
    upper: Array  # upper end of the positions [rad], (dof,)
    centre: Array  # usual middle of a motion [rad], (dof,)
    amplitude: Array  # largest deviation from the middle of a motion [rad], (dof,)
    velocity: Array  # largest speed [rad/s], (dof,)
    acceleration: Array  # largest acceleration [rad/s^2], (dof,)


def compute_usual_motion_range(robot: Robot) -> UsualMotionRange:
    """Return the range of typical motions, inside the limits with a margin."""
    lower = np.maximum(robot.lower, -np.pi) + _MARGIN
    upper = np.minimum(robot.upper, np.pi) - _MARGIN
    amplitude = np.minimum(0.35 * (upper - lower), _WIDEST)
    limit = np.asarray(robot.velocity_limit, dtype=float)
    known = np.isfinite(limit) & (limit > 0)
    velocity = np.where(known, _SHARE_OF_SPEED * limit, _UNKNOWN_SPEED)
    velocity = np.minimum(velocity, _FASTEST)
    acceleration = velocity / 0.15
    if robot.acceleration_limit is not None:
        acceleration = np.minimum(acceleration, 0.9 * robot.acceleration_limit)
    # As near to the zero posture as the range allows, where arms carry their weight.
    centre = np.clip(0.0, lower + amplitude, upper - amplitude)
    return UsualMotionRange(lower, upper, centre, amplitude, velocity, acceleration)


def draw_motion_centre(usual: UsualMotionRange, rng: np.random.Generator) -> Array:
    """Return the middle of one motion, up to 0.3 rad off the usual one [rad]."""
    centre = usual.centre + rng.uniform(-0.3, 0.3, len(usual.centre))
    return np.clip(centre, usual.lower + usual.amplitude, usual.upper - usual.amplitude)


def estimate_typical_sizes(robot: Robot) -> TypicalSizes:
    """Return the typical sizes on a robot.

    The built-in arm has a table; any other robot gets friction in proportion to the
    torques of its rigid body. Values that the robot declares win over both.
    """
    space = compute_usual_motion_range(robot)
    unit = create_random_stream(0, "sizes").uniform(-1, 1, (3, 300, robot.dof))
    q = space.centre + space.amplitude * unit[0]
    qd, qdd = space.velocity * unit[1], 0.5 * space.acceleration * unit[2]
    weight = np.abs(compute_gravity_torque(robot.model, q, robot.model.gravity.linear))
    weight = weight.mean(axis=0)
    loaded = np.flatnonzero(weight >= 0.05 * max(weight.max(), 1e-12)) + 1
    if robot.name == "irb140":
        table = {key: np.array(value) for key, value in _ARM_100_KG.items()}
    else:
        # Friction in the proportions of industrial arms; wrists get a floor.
        rigid = np.abs(compute_inverse_dynamics(robot.model, q, qd, qdd))
        torque = 1.5 * np.quantile(rigid, 0.99, axis=0)
        torque = np.maximum(torque, 0.03 * torque.max())
        shares = dict(coulomb=0.2 * torque, viscous=0.15 * torque, rotor=0.02 * torque)
        table = {"torque": torque, **shares}
    for effect in list_drive_effects():
        table[effect.of_drive] = read_declared_values(robot, effect, table[effect.of_drive])
    return TypicalSizes(**table, loaded=tuple(int(j) for j in loaded))


def read_nominal_drives(robot: Robot) -> DriveParameters:
    """Return the declared drives, or typical ones: a manufacturer knows them."""
    size = estimate_typical_sizes(robot)
    return DriveParameters(size.coulomb, size.viscous, size.rotor)


def read_declared_values(robot: Robot, effect: Effect, default: Array) -> Array:
    """Return the declared values of an effect of the drives, by joint. (dof,)."""
    known = robot.declared.get(effect.name)
    value = None if known is None else known.values.get(effect.amount[0])
    if value is None:
        return default
    return np.broadcast_to(np.asarray(value, dtype=float), (robot.dof,)).copy()


def scatter_inertias(model: pin.Model, relative: float, rng: np.random.Generator) -> pin.Model:
    """Return a copy whose bodies differ a little from the nominal ones.

    Mass and centre of mass are scaled, and each body is stretched about its centre:
    the second moment S = tr(I)/2 1 - I becomes s D S D with diagonal D. So the
    pseudo-inertia stays positive definite, and the body physically possible.
    """
    true = pin.Model(model)
    for i in range(1, true.njoints):
        body = true.inertias[i]
        factors = 1.0 + relative * rng.normal(size=7)
        mass, lever = factors[0] * body.mass, factors[1:4] * body.lever
        stretch = np.diag(factors[4:7])
        moment = np.trace(body.inertia) / 2 * np.eye(3) - body.inertia
        moment = factors[0] * stretch @ moment @ stretch
        inertia = np.trace(moment) * np.eye(3) - moment
        true.inertias[i] = pin.Inertia(mass, lever, inertia)
    return true


def draw_plant_effect(robot: Robot, rng: Rng, name: str | None = None) -> PlantEffect:
    """Draw one hidden effect of the plant in the physics engine.

    Args:
        name: Name of the effect; None to draw it too.
    """
    if name is None:
        name = str(rng.choice(list_drawable_effects()))
    drawn = draw_effect(robot, name, rng)
    return PlantEffect(name, drawn.joints, tuple(sorted(drawn.parameters.items())))


def list_drawable_effects() -> list[str]:
    """Return the names of the effects that may be drawn at random."""
    return [
        name
        for name in list_named_effects()
        if PlantEffectTrait.RARE not in list_plant_effects()[name].traits
    ]


def draw_effect(robot: Robot, effect: str, rng: Rng, joint: int | None = None) -> SyntheticEffect:
    """Draw one effect of usual size, on a joint where it makes sense.

    Args:
        joint: Joint from 1 (the first of a pair), or None to draw it.
    """
    kind = list_plant_effects()[check_effect_name(effect)]
    typical = estimate_typical_sizes(robot)
    joints = _joints(kind, robot.dof, typical, rng, joint)
    if not all(1 <= j <= robot.dof for j in joints):
        raise InputError(f"{effect} cannot sit on joints {joints} of {robot.dof}.")
    rows, space = [j - 1 for j in joints] or [0], compute_usual_motion_range(robot)
    least = (typical.torque, typical.coulomb, typical.viscous, typical.rotor)
    middle = (space.centre, space.amplitude)
    on_joints = TypicalJointSizes(
        robot,
        *(float(size[rows].min()) for size in least),
        *(float(size[rows[0]]) for size in middle),
    )
    values = kind.draw(rng, on_joints)
    return SyntheticEffect(effect, joints, {key: float(v) for key, v in values.items()})


def _joints(kind: Effect, dof: int, typical: TypicalSizes, rng: Rng, joint: int | None) -> Joints:
    match kind.scope:
        case "global":
            return ()
        case "flange":
            return (dof,)
        case "joint":
            return (joint or kind.where(rng, dof, typical),)
    if dof < 2:
        raise InputError(f"{kind.name} needs two joints.")
    # The last two pairs: in a wrist the motors drive their joints together.
    first = joint or dof - int(rng.integers(1, min(3, dof)))
    return (first, first + 1)
