"""Draw what an arm hides: effect, joint and size, as on a 100-kg arm."""

from residual.errors import InputError
from residual.names import check_name
from residual.robot.robot import Robot
from sim.catalogue import kinds, vocabulary
from sim.effects.base import Effect, Here, Joints, Rng
from sim.records import Hidden, PlantEffect, Sizes
from sim.synthetic.room import room
from sim.synthetic.sizes import sizes


def draw_hidden(
    robot: Robot,
    stream: Rng,
    name: str | None = None,
    joint: int | None = None,
    every: bool = False,
) -> PlantEffect:
    """Draw one hidden effect of the plant in the physics engine.

    Args:
        robot: The robot; sizes scale with its torques and friction.
        name: Name of the effect; None to draw it too.
        joint: Joint from 1 (the first of a pair), None to draw it.

    Raises:
        UnknownNameError: On an unknown name.
        InputError: If it cannot sit there.
    """
    if name is None:
        name = str(stream.choice(vocabulary() if every else usual_effects()))
    drawn = draw(robot, name, stream, joint)
    return PlantEffect(name, drawn.joints, tuple(sorted(drawn.parameters.items())))


def usual_effects() -> list[str]:
    """Return the names of the effects that are drawn where none is asked for."""
    return [name for name in vocabulary() if not kinds()[name].rare]


def draw(robot: Robot, effect: str, rng: Rng, joint: int | None = None) -> Hidden:
    """Draw one effect of usual size, on a joint where it makes sense.

    Args:
        robot: The robot; sizes scale with its torques and friction.
        joint: Joint from 1 (the first of a pair), or None to draw it.

    Raises:
        UnknownNameError: On an unknown name.
        InputError: If it cannot sit there.
    """
    what = kinds()[check_name(effect, kinds(), "effect of the plant")]
    usual = sizes(robot)
    joints = _joints(what, robot.dof, usual, rng, joint)
    if not all(1 <= j <= robot.dof for j in joints):
        raise InputError(f"{effect} cannot sit on joints {joints} of {robot.dof}.")
    values = what.usual(rng, _here(robot, usual, joints))
    return Hidden(effect, joints, {key: float(v) for key, v in values.items()})


def _joints(
    what: Effect, dof: int, usual: Sizes, rng: Rng, joint: int | None
) -> Joints:
    match what.scope:
        case "global":
            return ()
        case "flange":
            return (dof,)
        case "joint":
            return (joint or what.where(rng, dof, usual),)
    if dof < 2:
        raise InputError(f"{what.name} needs two joints.")
    # The last two pairs: in a wrist the motors drive their joints together.
    first = joint or dof - int(rng.integers(1, min(3, dof)))
    return (first, first + 1)


def _here(robot: Robot, usual: Sizes, joints: Joints) -> Here:
    rows, space = [j - 1 for j in joints] or [0], room(robot)
    least = (usual.torque, usual.coulomb, usual.viscous, usual.rotor)
    middle = (space.centre, space.amplitude)
    return Here(
        robot,
        *(float(size[rows].min()) for size in least),
        *(float(size[rows[0]]) for size in middle),
    )
