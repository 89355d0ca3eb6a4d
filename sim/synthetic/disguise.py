"""Effects that are no torque of their own: other bodies, angles and reports.

All exact, none of them linear in its size: bodies and gravity are changed themselves,
angles are what an encoder on the motor would read, reports are cut and shifted.
"""

import numpy as np
import pinocchio as pin
from scipy.ndimage import uniform_filter1d

from residual.robot.dynamics import flange_placement
from sim.synthetic.effects.forms import soft_limit
from sim.synthetic.state import Hidden

Array = np.ndarray

CROSSING = 0.04  # s that a link takes from one side of its play to the other


def changed_body(model: pin.Model, effect: Hidden) -> pin.Model:
    """Return the arm with a heavier link or on a tilted base; else the same.

    Args:
        model: The arm.
        effect: One hidden effect.
    """
    p, changed = effect.parameters, pin.Model(model)
    if effect.name == "link_inertia":
        for joint in effect.joints:
            body, factor = changed.inertias[joint], 1 + p["scale"]
            changed.inertias[joint] = pin.Inertia(
                factor * body.mass, body.lever, factor * body.inertia
            )
    elif effect.name == "base_tilt":
        gravity = model.gravity.linear
        # Turned so that to first order |g| (tilt_x, tilt_y, 0) is added to it.
        axis = np.cross(gravity, [p["tilt_x"], p["tilt_y"], 0.0])
        changed.gravity.linear = pin.exp3(axis / np.linalg.norm(gravity)) @ gravity
    return changed


def pushed(model: pin.Model, effects: tuple[Hidden, ...], q: Array) -> Array:
    """Return what the drives need against forces on the flange [N m]. Shape (n, dof).

    A force does what a weight of 1 kg at the flange does in a field of that strength.

    Args:
        model: The arm.
        effects: All hidden effects.
        q: True positions [rad]. Shape (n, dof).
    """
    bare, out = pin.Model(model), np.zeros_like(q)
    for i in range(1, bare.njoints):
        bare.inertias[i] = pin.Inertia.Zero()
    point = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    bare.inertias[bare.njoints - 1] = flange_placement(model).act(point)
    data = bare.createData()
    for effect in effects:
        if effect.name == "tool_force":
            bare.gravity.linear = np.array([effect.parameters[k] for k in "xyz"])
            out += [pin.computeGeneralizedGravity(bare, data, x) for x in q]
    return out


def motor(effects: tuple[Hidden, ...], q: Array, load: Array, rate: float) -> Array:
    """Return where the motors are, in angles of the links [rad]. Shape (n, dof).

    Args:
        effects: All hidden effects.
        q: True positions of the links [rad]. Shape (n, dof).
        load: Torque that the gears pass on [N m]. Shape (n, dof).
        rate: Samples per second [Hz].
    """
    out = q.copy()
    for effect in effects:
        for j in (joint - 1 for joint in effect.joints):
            if effect.name == "elasticity":
                out[:, j] += load[:, j] / effect.parameters["stiffness"]
            elif effect.name == "backlash":
                side = np.sign(load[:, j])
                for _ in range(3):
                    side = uniform_filter1d(side, max(1, round(CROSSING * rate / 2)))
                out[:, j] += effect.parameters["half_gap"] * side
    return out


def reading(effects: tuple[Hidden, ...], angle: Array) -> Array:
    """Return what the encoders read [rad]. Shape (n, dof).

    Args:
        effects: All hidden effects.
        angle: True angles of the motors [rad]. Shape (n, dof).
    """
    out = angle.copy()
    for effect in effects:
        p = effect.parameters
        for j in (joint - 1 for joint in effect.joints):
            if effect.name == "encoder_offset":
                out[:, j] -= p["angle"]
            elif effect.name == "encoder_eccentricity":
                x = angle[:, j]
                out[:, j] -= p["cos"] * np.cos(x) + p["sin"] * np.sin(x)
    return out


def reported(effects: tuple[Hidden, ...], t: Array, tau: Array) -> Array:
    """Return the torque as it is reported, noise apart [N m]. Shape (n, dof).

    Args:
        effects: All hidden effects.
        t: Times [s]. Shape (n,).
        tau: True torque [N m]. Shape (n, dof).
    """
    out = tau.copy()
    for effect in effects:
        if effect.name == "saturation":
            level = effect.parameters["level"]
            for j in (joint - 1 for joint in effect.joints):
                out[:, j] = np.clip(out[:, j], -level, level)
        elif effect.name == "soft_limit":
            for j in (joint - 1 for joint in effect.joints):
                out[:, j] = soft_limit(out[:, j], effect.parameters["level"])
    for effect in effects:
        if effect.name == "delay":
            then = t - effect.parameters["delay"]
            out = np.column_stack([np.interp(then, t, column) for column in out.T])
    return out
