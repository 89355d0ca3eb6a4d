"""The records that the rooms of the simulated world share, and its random streams.

Each thing that is drawn has a stream of its own, so that adding an effect changes
neither the arm nor anybody else's noise. Noise also depends on the motion: two
experiments on one arm share its scatter and nothing else.
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
    """What the arm is asked to do, at the rate of the controller."""

    kind: str  # family: fourier, cyclic, welding or move_stop_move
    t: Array  # times from 0, uniform [s], (n,)
    q: Array  # joint positions [rad], (n, dof)
    qd: Array  # joint velocities [rad/s], (n, dof)
    qdd: Array  # joint accelerations [rad/s^2], (n, dof)
    period: float | None  # length of one repetition [s], None where nothing repeats


@dataclass(frozen=True, slots=True)
class TrajectorySpec:
    """The reference asked for: a part of the open half of a spec."""

    kind: str = "fourier"  # family: fourier, cyclic, welding or move_stop_move
    duration: float = 20.0  # length [s]
    periods: int = 2  # repetitions within the duration
    seed: int = 0  # seed of whatever the family draws
    # Of a motion that is given and not searched for; a row has dof entries [rad].
    # Fourier: its centre, then the eight coefficients of every joint that rest at its
    # ends leaves free. Move-stop-move: the places that it goes round, `periods` times,
    # after a stand at the first. Empty to search.
    coefficients: tuple[tuple[float, ...], ...] = ()

    @classmethod
    def from_record(cls, record: Mapping) -> "TrajectorySpec":
        """Return the reference of a record, whose lists are tuples again."""
        rows = tuple(tuple(row) for row in record.get("coefficients", ()))
        return cls(**{**record, "coefficients": rows})


@dataclass(frozen=True, slots=True)
class PlantEffect:
    """One thing that the arm has and the nominal model lacks (sealed half)."""

    name: str  # name of a file of sim/effects, or ``x_...`` of one without a name
    joints: tuple[int, ...]  # joints that have it, from 1; () for a global effect
    parameters: tuple[tuple[str, float], ...]  # name and value of each parameter, SI
    onset: float = 0.0  # time from which it acts [s]


@dataclass(frozen=True, eq=False, slots=True)
class SyntheticEffect:
    """An effect that the arm has and its model may lack, from the beginning."""

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
    """What the sensors add."""

    # Standard deviation as a share of each joint's usual torque range.
    torque: float = 0.015
    # Quantisation step [rad]; white noise of half of it comes before.
    encoder: float = 1e-4


@dataclass(frozen=True, slots=True)
class ServoDrive:
    """What a position-controlled arm does with a goal, a value per joint or none."""

    gain: tuple[float, ...] = ()  # torque per angle [N m/rad]; none: 1
    limit: tuple[float, ...] = ()  # of its torque [N m]; none: that of the arm
    delay: tuple[float, ...] = ()  # until a goal arrives [s]
    goal_speed: tuple[float, ...] = ()  # with which its firmware follows [rad/s]
    damping: tuple[float, ...] = ()  # of the motor while it is on [N m s/rad]


@dataclass(frozen=True, slots=True)
class PlantSpec:
    """The hidden half of a spec: what the diagnosis must find out by itself."""

    # What the arm has and the nominal model lacks.
    effects: tuple[PlantEffect, ...] = ()
    # Relative standard deviation of the rigid and declared parameters around the
    # nominal ones.
    scatter: float = 0.02
    noise: SensorNoise = SensorNoise()
    seed: int = 0  # seed of every named stream of the plant
    salt: str = ""  # any text: keeps the hash of this half from being guessed
    # What all joints have undeclared: nothing, that of an arm in use, or twice as much.
    # Drawn from the seed, so it is the arm's own in all its runs.
    background: BackgroundWord = CLEAN
    # Usual work of the arm before its session began, which left it warm; only a
    # background feels it [s].
    worked_before: float = 0.0
    # Of an arm that is sent goals and nothing else; None where the controller sends
    # torques.
    drive: ServoDrive | None = None


class DriveParameters(NamedTuple):
    """What is known of the friction and rotors of an arm, per joint. Shapes (dof,)."""

    coulomb: Array  # dry friction [N m]
    viscous: Array  # viscosity [N m s/rad]
    rotor: Array  # rotor inertia at the joint [kg m^2]


@dataclass(frozen=True, eq=False, slots=True)
class TypicalSizes:
    """Usual sizes on one robot, per joint."""

    torque: Array  # range of the torque in normal motion [N m], (dof,)
    coulomb: Array  # Coulomb friction [N m], (dof,)
    viscous: Array  # viscous friction [N m s/rad], (dof,)
    rotor: Array  # inertia of the rotor at the link side [kg m^2], (dof,)
    loaded: tuple[int, ...]  # joints, from 1, that carry a good part of the weight


@dataclass(frozen=True, eq=False, slots=True)
class PlantRun:
    """One experiment on the plant."""

    log: Recording  # what a robot would log, at the log's rate: t, q, tau and q_ref
    # What no robot logs, by name, at the log's rate: true motion, one ``tau_<channel>``
    # per torque, temperatures, (n, ...).
    truth: Mapping[str, Array]
    # Errors e_q, e_qd, e_qdd, e_tau of the plant against the nominal closed-loop twin
    # on the same reference, (n, dof) each.
    twin: Mapping[str, Array]


def create_random_stream(seed: int, name: str) -> np.random.Generator:
    """Return the random stream of that name.

    Streams of different names are independent; drawing more from one, or adding
    another, changes nothing in the rest.
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
