"""The records that the folders of the simulation share, and its random streams.

Each drawn quantity has a separate stream, so that adding an effect changes neither the
arm nor any other noise. Noise also depends on the motion: two experiments on one arm
share only its scatter.
"""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, Literal, NamedTuple, get_args

import numpy as np

from residual.recording import Array, Recording

BackgroundWord = Literal["clean", "workshop", "worn"]
CLEAN: BackgroundWord = "clean"
BACKGROUNDS: tuple[BackgroundWord, ...] = get_args(BackgroundWord)

HIDDEN = "hidden"
# What a manifest lists: the streams that one experiment draws from.
NAMES = ("scatter", "friction", "encoder", "torque", "effect")


@dataclass(frozen=True, eq=False, slots=True)
class ReferenceMotion:
    """The reference of the arm, at the rate of the controller."""

    kind: str  # family: fourier, cyclic, welding or move_stop_move
    t: Array  # times from 0, uniform [s], (n,)
    q: Array  # joint positions [rad], (n, dof)
    qd: Array  # joint velocities [rad/s], (n, dof)
    qdd: Array  # joint accelerations [rad/s^2], (n, dof)
    period: float | None  # length of one repetition [s], None where nothing repeats


@dataclass(frozen=True, slots=True)
class TrajectorySpec:
    """The specification of a reference: a part of the open half of a spec."""

    kind: str = "fourier"  # family: fourier, cyclic, welding or move_stop_move
    duration: float = 20.0  # length [s]
    periods: int = 2  # repetitions within the duration
    seed: int = 0  # seed of whatever the family draws
    # Of a given motion, without a search; a row has dof entries [rad].
    # Fourier: its centre, then the eight free coefficients of every joint (rest at both
    # ends fixes two). Move-stop-move: the places to visit in turn, `periods` times,
    # after a dwell at the first. Empty to search.
    coefficients: tuple[tuple[float, ...], ...] = ()

    @classmethod
    def from_record(cls, record: Mapping) -> "TrajectorySpec":
        """Return the reference of a record, whose lists are tuples again."""
        rows = tuple(tuple(row) for row in record.get("coefficients", ()))
        return cls(**{**record, "coefficients": rows})


@dataclass(frozen=True, slots=True)
class PlantEffect:
    """One effect of the arm that the nominal model lacks (sealed half)."""

    name: str  # name of a file of sim/effects, or ``x_...`` of one without a name
    joints: tuple[int, ...]  # joints that have it, from 1; () for a global effect
    parameters: tuple[tuple[str, float], ...]  # name and value of each parameter, SI
    onset: float = 0.0  # time from which it acts [s]


@dataclass(frozen=True, eq=False, slots=True)
class SyntheticEffect:
    """An effect of the arm that its model may lack, from the start of the motion."""

    onset: ClassVar[float] = 0.0

    name: str  # name of the effect; those out of the vocabulary begin with "x_"
    joints: tuple[int, ...]  # joints that have it, from 1
    # SI values; an array has one entry per joint.
    parameters: Mapping[str, float | Array]


@dataclass(frozen=True, slots=True)
class SampleRates:
    """Rates of the controller and of the log; control a whole multiple of log [Hz]."""

    control: float = 1000.0
    log: float = 250.0


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """The noise of the sensors."""

    # Standard deviation as a share of each joint's typical torque range.
    torque: float = 0.015
    # Quantisation step [rad]; white noise of half of it comes before.
    encoder: float = 1e-4


@dataclass(frozen=True, slots=True)
class ServoDrive:
    """The servos of a position-controlled arm, a value per joint or none."""

    gain: tuple[float, ...] = ()  # torque per angle [N m/rad]; none: 1
    limit: tuple[float, ...] = ()  # of its torque [N m]; none: that of the arm
    delay: tuple[float, ...] = ()  # until a goal arrives [s]
    goal_speed: tuple[float, ...] = ()  # with which its firmware follows [rad/s]
    damping: tuple[float, ...] = ()  # of the motor while it is on [N m s/rad]


@dataclass(frozen=True, slots=True)
class PlantSpec:
    """The hidden half of a spec, which the diagnosis has to find."""

    # Effects of the arm that the nominal model lacks.
    effects: tuple[PlantEffect, ...] = ()
    # Relative standard deviation of the rigid and declared parameters around the
    # nominal ones.
    scatter: float = 0.02
    noise: SensorNoise = SensorNoise()
    seed: int = 0  # seed of every named stream of the plant
    salt: str = ""  # any text: keeps the hash of this half from being guessed
    # Undeclared effects of all joints: none, those of an arm in use, or twice as much.
    # Drawn from the seed, so they are the same in all runs of the arm.
    background: BackgroundWord = CLEAN
    # Typical work of the arm before its session, which warmed it; affects only a
    # background [s].
    worked_before: float = 0.0
    # Of an arm that is only sent goals; None where the controller sends torques.
    drive: ServoDrive | None = None


class DriveParameters(NamedTuple):
    """Friction and rotors of an arm, per joint. Shapes (dof,)."""

    coulomb: Array  # dry friction [N m]
    viscous: Array  # viscosity [N m s/rad]
    rotor: Array  # rotor inertia at the joint [kg m^2]


@dataclass(frozen=True, eq=False, slots=True)
class TypicalSizes:
    """Typical sizes on one robot, per joint."""

    torque: Array  # range of the torque in normal motion [N m], (dof,)
    coulomb: Array  # Coulomb friction [N m], (dof,)
    viscous: Array  # viscous friction [N m s/rad], (dof,)
    rotor: Array  # inertia of the rotor at the link side [kg m^2], (dof,)
    loaded: tuple[int, ...]  # joints, from 1, that carry much of the weight


@dataclass(frozen=True, eq=False, slots=True)
class PlantRun:
    """One experiment on the plant."""

    log: Recording  # the log of the robot, at the log's rate: t, q, tau and q_ref
    # Hidden channels by name, at the log's rate: true motion, one ``tau_<channel>``
    # per torque, temperatures, (n, ...).
    truth: Mapping[str, Array]
    # Errors e_q, e_qd, e_qdd, e_tau of the plant against the nominal closed-loop twin
    # on the same reference, (n, dof) each.
    twin: Mapping[str, Array]


def create_random_stream(seed: int, name: str) -> np.random.Generator:
    """Return the random stream of that name.

    Streams of different names are independent; drawing more from one, or adding
    another, does not change the others.
    """
    digest = hashlib.sha256(name.encode()).digest()
    entropy = [seed, int.from_bytes(digest[:8], "little")]
    return np.random.default_rng(np.random.SeedSequence(entropy))


def format_motion_label(reference: ReferenceMotion, start: float) -> str:
    """Return a label of one motion at one time of the session, for stream names."""
    digest = hashlib.sha256(reference.kind.encode())
    for array in (reference.t, reference.q):
        digest.update(np.ascontiguousarray(array, dtype="<f8").tobytes())
    return f"{digest.hexdigest()[:16]}/{start!r}"
