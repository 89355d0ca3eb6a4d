"""The record of a simulated effect: its data, and its functions in the plant."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum, auto
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from residual.errors import InputError
from residual.recording import Array
from residual.robot.robot import Robot
from sim.engine.plant_records import TypicalSizes

Rng = np.random.Generator
Values = Mapping[str, float]
Joints = tuple[int, ...]  # from 0, unless said otherwise
Scope = Literal["joint", "pair", "flange", "global"]
OfDrive = Literal["viscous", "coulomb", "rotor"]  # fields of `TypicalSizes`


@dataclass(frozen=True, eq=False, slots=True)
class TypicalJointSizes:
    """Typical sizes on the joints of a drawn effect: of several joints the least.

    Attributes:
        robot: The arm.
        torque: Range of the torque in normal motion [N m].
        coulomb: Coulomb friction [N m].
        viscous: Viscous friction [N m s/rad].
        rotor: Inertia of the rotor at the link side [kg m^2].
        centre: Middle of a motion of the first of the joints [rad].
        amplitude: Largest deviation from it [rad].
    """

    robot: Robot
    torque: float
    coulomb: float
    viscous: float
    rotor: float
    centre: float
    amplitude: float


class MovingArm(NamedTuple):
    """The arm in the physics engine at one step.

    Attributes:
        model: Its rigid body.
        data: Of Pinocchio, for that state.
        q: Positions [rad]. Shape (dof,).
        qd: Velocities [rad/s]. Shape (dof,).
    """

    model: pin.Model
    data: pin.Data
    q: Array
    qd: Array


def draw_any_joint(rng: Rng, dof: int, sizes: TypicalSizes) -> int:
    """Draw a joint, from 1."""
    return int(rng.integers(1, dof + 1))


def draw_any_joint_skipping(rng: Rng, dof: int, sizes: TypicalSizes) -> int:
    """Draw a joint, from 1, after a number that old draws need to keep their seeds."""
    rng.uniform()
    return draw_any_joint(rng, dof, sizes)


def draw_first_joint(rng: Rng, dof: int, sizes: TypicalSizes) -> int:
    """Draw one of the first three joints, which carry the arm."""
    return int(rng.integers(1, min(3, dof) + 1))


def draw_loaded_joint(rng: Rng, dof: int, sizes: TypicalSizes) -> int:
    """Draw one with weight to carry nine times in ten, else one of the first half."""
    if rng.uniform() < 0.1:
        return int(rng.integers(1, max(2, dof // 2 + 1)))
    return _heaviest(rng, sizes)


def draw_balanced_joint(rng: Rng, dof: int, sizes: TypicalSizes) -> int:
    """Draw one with weight to balance, after a number as in `draw_any_joint_skipping`."""
    rng.uniform()
    return _heaviest(rng, sizes)


def _heaviest(rng: Rng, sizes: TypicalSizes) -> int:
    """Draw one of the two joints that carry most."""
    most = sorted(sizes.loaded, key=lambda j: -sizes.torque[j - 1])[:2]
    return int(rng.choice(most))


class PlantEffectTrait(Enum):
    """A special trait of an effect."""

    RARE = auto()  # drawn only on request
    INVERSE = auto()  # its torque falls as its amount rises (a stiffness)
    SENSOR = auto()  # a broken sensor; its report comes after all others
    FROZEN = auto()  # the encoder stands still


@dataclass(frozen=True, eq=False, slots=True)
class Effect:
    """One effect that an arm may hide.

    Most effects need `name`, `parameters`, `amount`, `draw` and one function of the
    plant (`push` is the most general); all other fields have defaults. Each function
    takes the values p with defaults filled in. None is a formula of the diagnosis.

    Attributes:
        name: Its name in the vocabulary; ``x_...`` outside of it.
        parameters: Keys with their SI units, in order.
        defaults: Values of those keys that need not be given.
        scope: Where it sits: on each of its joints, on a pair, the flange, or the arm.
        above: Lower limits of values, exclusive.
        signs: Keys that are 1 or -1.
        together: Keys that are given all or none.
        of_drive: The parameter of the drives that it changes, by its name in
            `OfDrive`; its value adds to the declared one.
        amount: Parameters that its torque is proportional to; the first states its
            size, several form one vector.
        along: Parameters that grow along without being the size.
        also: Names in the vocabulary for a part of its torque, true beside its own.
        traits: Its special traits (`PlantEffectTrait`).
        where: (rng, dof, sizes) -> a joint, from 1, where the effect is typical.
        draw: (rng, sizes) -> values of typical size.

        body: (model, joints, p) -> the changed rigid body.
        encoder: p -> constant, cosine and sine of true minus reading [rad].
        gain: p -> excess of reported over real torque, as a share.
        report: (tau, t, onset, p) -> the reported torque (n, k).

        friction: (p, Coulomb level) -> kind and numbers of a row of friction.
        gear: p -> inertia, sign, level and coefficient of a gear that a pair shares.
        torque: (p, joints) -> kind and numbers of a row of torque, on each joint, of a
            pair on the first.
        series: (p, t, rng) -> torque over the whole motion on one joint. Shape (n,).
        push: (p, moving arm) -> torque that moves the joints, at every step [N m];
            only entries of its joints count, of a global effect all. Shape (dof,).
        transmission: p -> compliance of a spring between motor and link [rad/(N m)],
            half of the play between them [rad]; 0 for none.
        onset_share: p -> share of the motion after which it acts.
        drift: p -> rate at which an encoder drifts [rad/s].
    """

    name: str
    parameters: Mapping[str, str]
    defaults: Values = field(default_factory=dict)
    scope: Scope = "joint"
    above: Values = field(default_factory=dict)
    signs: tuple[str, ...] = ()
    together: tuple[str, ...] = ()
    of_drive: OfDrive | None = None
    amount: tuple[str, ...] = ()
    along: tuple[str, ...] = ()
    also: tuple[str, ...] = ()
    traits: frozenset[PlantEffectTrait] = frozenset()
    where: Callable[[Rng, int, TypicalSizes], int] = draw_any_joint_skipping
    draw: Callable[[Rng, TypicalJointSizes], dict[str, float]] | None = None

    body: Callable[[pin.Model, Joints, Values], pin.Model] | None = None
    encoder: Callable[[Values], tuple[float, float, float]] | None = None
    gain: Callable[[Values], float] | None = None
    report: Callable[[Array, Array, float, Values], Array] | None = None

    friction: Callable[[Values, float], Sequence[float]] | None = None
    gear: Callable[[Values], tuple[float, float, float, float]] | None = None
    torque: Callable[[Values, Joints], Sequence[float]] | None = None
    series: Callable[[Values, Array, Rng], Array] | None = None
    push: Callable[[Values, MovingArm], Array] | None = None
    transmission: Callable[[Values], tuple[float, float]] | None = None
    onset_share: Callable[[Values], float] | None = None
    drift: Callable[[Values], float] | None = None

    @property
    def named(self) -> bool:
        """Whether the vocabulary has a name for it."""
        return not self.name.startswith("x_")

    @property
    def has_channel(self) -> bool:
        """Whether the plant records a separate torque for it."""
        return any((self.torque, self.series, self.push))


def build_row_function(kind: int, *keys: str) -> Callable[[Values, object], tuple[float, ...]]:
    """Return a function of (p, anything) that makes a row of that kind from values."""
    return lambda p, _: (kind, *(p[key] for key in keys))


def draw_sign(rng: Rng) -> float:
    """Draw 1 or -1."""
    return float(rng.choice([-1.0, 1.0]))


def draw_angle(rng: Rng) -> float:
    """Draw an angle of a whole turn [rad]."""
    return rng.uniform(0.0, 2 * np.pi)


def split_into_components(size: float, angle: float, keys: Sequence[str] = ("cos", "sin")) -> dict:
    """Return a vector of that length and direction by its two components."""
    parts = size * float(np.cos(angle)), size * float(np.sin(angle))
    return dict(zip(keys, parts, strict=True))


TENSOR = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
CENTRE = ("com_x", "com_y", "com_z")


# Fields of an `Effect` that adds a body to the arm.
BODY = {
    "parameters": {"mass": "kg"} | dict.fromkeys(CENTRE, "m") | dict.fromkeys(TENSOR, "kg m^2"),
    "defaults": dict.fromkeys(CENTRE, 0.0) | dict.fromkeys(TENSOR, math.nan),
    "above": {"mass": 0.0},
    "together": TENSOR,
    "amount": ("mass",),
}


def build_body_inertia(p: Values) -> pin.Inertia:
    """Return a body by its values, in the frame that they are stated in.

    Args:
        p: `mass` [kg] and `com_x`, `com_y`, `com_z` [m]; `ixx` to `izz` about that
            centre [kg m^2], NaN where they are not known.
    """
    # Radius of a steel ball of that mass (7850 kg/m^3).
    radius = (3 * p["mass"] / (4 * np.pi * 7850.0)) ** (1 / 3)
    inertia = 0.4 * p["mass"] * radius**2 * np.eye(3)
    if not np.isnan(p["ixx"]):
        inertia[np.triu_indices(3)] = [p[key] for key in TENSOR]
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
    return pin.Inertia(p["mass"], np.array([p[key] for key in CENTRE]), inertia)


def add_body(model: pin.Model, link: int, body: pin.Inertia, name: str) -> pin.Model:
    """Return a copy of an arm with an additional body on a link.

    Args:
        link: Index of its joint in the model.
        name: What a message calls the body.

    Raises:
        InputError: If no link can have the sum.
    """
    loaded = pin.Model(model)
    loaded.inertias[link] += body
    pseudo = pin.PseudoInertia.FromInertia(loaded.inertias[link]).toMatrix()
    if np.linalg.eigvalsh(pseudo)[0] < 0:
        raise InputError(
            f"{name}: no body has these moments of inertia at that mass; give them "
            "about the centre of mass, each at most the sum of the other two."
        )
    return loaded
