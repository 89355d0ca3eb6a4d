"""Bodies: the true rigid arm, what hangs on it, and how it stands."""

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.robot.robot import Robot
from sim.plant.perturbations import parameters
from sim.records import PlantEffect
from sim.synthetic.body import scatter, with_payload
from sim.synthetic.seeds import stream
from sim.synthetic.state import Hidden

Array = np.ndarray


def scattered(robot: Robot, relative: float, seed: int) -> pin.Model:
    """Return the rigid body of one arm of that make, without anything hidden."""
    return scatter(robot.model, relative, stream(seed, "scatter"))


def with_effects(model: pin.Model, effects: tuple[PlantEffect, ...]) -> pin.Model:
    """Return the body with every payload, changed link and tilt among the effects.

    Args:
        model: Body without them.
        effects: Checked effects; others than those three are passed over.

    Returns:
        A changed copy.

    Raises:
        InputError: If a payload has a tensor that no body can have.
    """
    changed = pin.Model(model)
    for effect in effects:
        values = parameters(effect)
        if effect.name == "payload":
            changed = _loaded(changed, values)
        elif effect.name == "link_inertia":
            for joint in effect.joints:
                changed.inertias[joint] = _heavier(
                    changed.inertias[joint], 1.0 + values["scale"]
                )
        elif effect.name == "base_tilt":
            changed.gravity.linear = _tilted(changed.gravity.linear, values)
    return changed


def _loaded(model: pin.Model, values: dict[str, float]) -> pin.Model:
    hidden = Hidden("payload", (model.nv,), values)
    given = not np.isnan(values["ixx"])
    loaded = with_payload(model, hidden)
    body = loaded.inertias[model.nv]
    if (
        given
        and np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(body).toMatrix())[0] < 0
    ):
        raise InputError(
            "Payload: no body has these moments of inertia at that mass; give them "
            "about the centre of mass, each at most the sum of the other two."
        )
    return loaded


def _heavier(body: pin.Inertia, factor: float) -> pin.Inertia:
    """Scale all ten parameters: another density."""
    return pin.Inertia(factor * body.mass, body.lever, factor * body.inertia)


def _tilted(gravity: Array, values: dict[str, float]) -> Array:
    """Turn gravity so that to first order |g| (tilt_x, tilt_y, 0) is added to it."""
    size = np.linalg.norm(gravity)
    push = np.array([values["tilt_x"], values["tilt_y"], 0.0])
    return pin.exp3(np.cross(gravity, push) / size) @ gravity
