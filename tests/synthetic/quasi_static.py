"""The synthetic arm: the torque that a given motion takes, part by part.

There is no controller and no simulation in time, so that logs cost little. The formulas
of the hidden effects are deliberately not those of the diagnosis.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.recording import Array
from residual.robot.dynamics import compute_inverse_dynamics
from residual.robot.robot import Robot
from sim.effects import load_effects
from sim.engine.plant_records import (
    CLEAN,
    BackgroundWord,
    PlantEffect,
    ReferenceMotion,
    SyntheticEffect,
    create_random_stream,
)
from sim.plant.effect_catalogue import ActingEffect, apply_body_effects
from sim.plant.plant_arm import USUAL_SPEED, JointBackground, draw_background
from sim.plant.sensors import simulate_torque_report, sum_encoder_errors
from sim.plant.typical_sizes import (
    compute_usual_motion_range,
    estimate_typical_sizes,
    scatter_inertias,
)
from tests.synthetic import other_forms
from tests.synthetic.background import (
    BackgroundTorque,
    FrictionMotion,
    compute_background_torque,
    gear_twist_angle,
)
from tests.synthetic.laws import (
    SyntheticMotion,
    compute_bristle_states,
    compute_effect_torque,
    compute_motor_lead,
    compute_push_torque,
    supports_synthetic_arm,
)

_RIGID_SCATTER = 0.02
# Friction that the robot declares is off by little; that of a bare URDF is anything.
_DECLARED_SCATTER, _UNKNOWN_SCATTER = 0.02, 0.1
_DISPLACEMENT = (1e-4, 3e-4)  # rad


@dataclass(frozen=True, eq=False, slots=True)
class Plant:
    """A synthetic arm."""

    robot: Robot  # its nominal description, which is not quite true of it
    hidden: tuple[PlantEffect | SyntheticEffect, ...]  # the effects that its description lacks
    seed: int  # seed of what makes this arm differ from its description
    background: BackgroundWord = CLEAN  # what all joints have undeclared, at all times
    # How far its bodies, friction and rotors are off what the description says, as a
    # share; None for as far as those of any arm.
    scatter: float | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Friction:
    """True base friction and rotors, per joint, always there."""

    coulomb: Array  # level [N m], (dof,)
    viscous: Array  # coefficient [N m s/rad], (dof,)
    rotor: Array  # inertia at the link side [kg m^2], (dof,)
    displacement: Array  # displacement over which the bristles yield [rad], (dof,)


@dataclass(frozen=True, eq=False, slots=True)
class Torque:
    """The torque of one motion and its parts [N m], shapes (n, dof)."""

    rigid: Array  # rigid body with payload
    base: Array  # Coulomb and viscous friction and rotors
    # Additive hidden effects, one array each, in the order of the plant's.
    hidden: tuple[Array, ...]
    tau: Array  # what is reported: the sum, times a hidden torque gain, late or cut
    reading: Array  # what the encoders read, noise apart [rad], (n, dof)
    background: BackgroundTorque | None = None  # what the background adds, None on a clean arm


def true_model(plant: Plant) -> pin.Model:
    relative = _RIGID_SCATTER if plant.scatter is None else plant.scatter
    return scatter_inertias(
        plant.robot.model, relative, create_random_stream(plant.seed, "scatter")
    )


def true_friction(plant: Plant) -> Friction:
    """Return base friction and rotors of this arm without hidden effects."""
    usual, rng = (estimate_typical_sizes(plant.robot), create_random_stream(plant.seed, "friction"))
    relative = _DECLARED_SCATTER if plant.robot.declared else _UNKNOWN_SCATTER
    relative = relative if plant.scatter is None else plant.scatter
    factor = np.exp(relative * rng.normal(size=(3, plant.robot.dof)))
    return Friction(
        coulomb=factor[0] * usual.coulomb,
        viscous=factor[1] * usual.viscous,
        rotor=factor[2] * usual.rotor,
        displacement=rng.uniform(*_DISPLACEMENT, plant.robot.dof),
    )


def background_of(plant: Plant) -> JointBackground | None:
    """Return what all joints of this arm have undeclared, None if it is clean."""
    if plant.background == CLEAN:
        return None
    coulomb = true_friction(plant).coulomb
    return draw_background(plant.robot, plant.background, plant.seed, coulomb)


def true_torque(
    plant: Plant,
    motion: ReferenceMotion,
    log: str,
    start: float = 0.0,
    active: bool = True,
    worked: float | None = None,
) -> Torque:
    """Return the torque that the motion takes.

    tau = gain * (RNEA(q, qd, qdd) + Fc z + Fv qd + Jr qdd + sum of hidden effects
    + background)

    Args:
        log: Name of the log, which names the random streams of its effects.
        start: Session time of the first sample [s].
        active: Whether the hidden effects are there; not so when it was commissioned.
        worked: Usual work of the arm before the first sample [s], which left it warm;
            None for all of the session. Only a background feels it.
    """
    hidden = resolve_synthetic_effects(plant.hidden if active else ())
    for effect in hidden:
        if not supports_synthetic_arm(effect.kind):
            raise InputError(f"A synthetic arm cannot have '{effect.kind.name}'.")
    model = apply_body_effects(true_model(plant), hidden)
    rigid = compute_inverse_dynamics(model, motion.q, motion.qd, motion.qdd)
    for effect in hidden:  # a force on the arm as a whole loads its gears
        if effect.kind.push and effect.kind.scope == "global":
            rigid += compute_push_torque(effect, model, motion.q, motion.qd)
    friction, own = true_friction(plant), background_of(plant)
    drives, qd, qdd = _drives(hidden, motion, rigid, own)
    z = compute_bristle_states(drives, friction.displacement)
    base = friction.coulomb * z + friction.viscous * qd + friction.rotor * qdd
    parts = []
    for i, effect in enumerate(hidden):
        rng = create_random_stream(plant.seed, f"effect/{i}/{effect.kind.name}/{log}")
        parts.append(_part(effect, model, motion, start, rigid, z, friction, rng))
    total, more, gain = rigid + base + sum(parts), None, _gain(hidden, plant.robot.dof)
    if own is not None:
        rubbing = FrictionMotion(
            t=motion.t,
            q=drives,
            qd=qd,
            bristle=z,
            load=rigid,
            coulomb=friction.coulomb,
            viscous=friction.viscous,
            usual_speed=USUAL_SPEED * compute_usual_motion_range(plant.robot).velocity,
            worked=start if worked is None else worked,
        )
        more = compute_background_torque(own, rubbing)
        total, gain = total + more.torque, gain * (1.0 + own.gain)
    tau = simulate_torque_report(total * gain, motion.t, hidden)
    # What the encoders read of the angles of the motors.
    shift, cos, sin = sum_encoder_errors(hidden, plant.robot.dof)
    reading = drives - (shift + cos * np.cos(drives) + sin * np.sin(drives))
    return Torque(rigid, base, tuple(parts), tau, reading, more)


def resolve_synthetic_effects(
    effects: Sequence[PlantEffect | SyntheticEffect],
) -> list[ActingEffect]:
    """Return effects with their definitions, those of other authors' forms too."""
    known = other_forms.EFFECTS
    kinds = [known.get(e.name) or load_effects()[e.name] for e in effects]
    return [
        ActingEffect(
            kind, {**kind.defaults, **dict(e.parameters)}, tuple(j - 1 for j in e.joints), e.onset
        )
        for kind, e in zip(kinds, effects, strict=True)
    ]


def _drives(
    hidden: Sequence[ActingEffect],
    motion: ReferenceMotion,
    load: Array,
    own: JointBackground | None,
) -> tuple[Array, Array, Array]:
    """Return position, speed and acceleration of the motors, which may lead.

    In angles of the links; the load is what the gears pass on [N m].
    """
    rate = 1 / (motion.t[1] - motion.t[0])
    q = motion.q.copy()
    for what, p, joints, _ in hidden:
        for j in joints:
            if what.transmission:
                spring = what.transmission(p)
                q[:, j] += compute_motor_lead(*spring, load[:, j], rate)
            if lead := other_forms.LEADS.get(what.name):
                q[:, j] += lead(load[:, j], rate, p)
    if own is not None:
        q += gear_twist_angle(load, own.twist, own.span)
    lead = q - motion.q
    first = np.gradient(lead, 1 / rate, axis=0)
    second = np.gradient(first, 1 / rate, axis=0)
    return motion.q + lead, motion.qd + first, motion.qdd + second


def _part(
    effect: ActingEffect,
    model: pin.Model,
    motion: ReferenceMotion,
    start: float,
    rigid: Array,
    z: Array,
    friction: Friction,
    rng: np.random.Generator,
) -> Array:
    """Return the torque of one additive effect on all joints. Shape (n, dof)."""
    torque, rows = np.zeros_like(rigid), list(effect.joints)
    if effect.kind.scope == "global":
        return torque
    state = SyntheticMotion(
        t=start + motion.t,
        q=motion.q[:, rows],
        qd=motion.qd[:, rows],
        qdd=motion.qdd[:, rows],
        every_q=motion.q,
        bristle=z[:, rows],
        load=rigid[:, rows],
        coulomb=friction.coulomb[rows],
        displacement=friction.displacement[rows],
        rng=rng,
    )
    if law := other_forms.LAWS.get(effect.kind.name):
        torque[:, rows] = law(state, effect.values)
    else:
        torque[:, rows] = compute_effect_torque(effect, state)
    if effect.kind.push:
        pushed = compute_push_torque(effect, model, motion.q, motion.qd)
        torque[:, rows] += pushed[:, rows]
    return torque


def _gain(hidden: Sequence[ActingEffect], dof: int) -> Array:
    """Return reported over real torque of each joint. Shape (dof,)."""
    gain = np.ones(dof)
    for what, p, joints, _ in hidden:
        if what.gain:
            gain[list(joints)] += what.gain(p)
    return gain
