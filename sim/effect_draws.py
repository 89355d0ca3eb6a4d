"""Draw a hidden effect: name, joint and size, as on a 100-kg arm."""

from residual.errors import InputError
from residual.robot.robot import Robot
from sim.effects.base import Effect, Joints, PlantEffectTrait, Rng, TypicalJointSizes
from sim.engine.plant_records import PlantEffect, SyntheticEffect, TypicalSizes
from sim.plant.effect_catalogue import check_effect_name, list_named_effects, list_plant_effects
from sim.plant.typical_sizes import compute_usual_motion_range, estimate_typical_sizes


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
