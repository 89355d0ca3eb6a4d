"""The result of an export: files, what of the model they hold, and what they lack.

The lack is measured as torque, along one motion that is the same at every call.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.model.corrected import CorrectedModel
from residual.model.model import Model, Term
from residual.model.record import to_record
from residual.recording import Array
from residual.robot.robot import Robot

DEFAULT_SPEED = 2.0  # rad/s, of a joint without a speed limit
SECONDS, RATE = 10.0, 250.0
TRAVEL = 0.4  # of a joint's range to each side of its middle
WAVES = ((0.5, 1.0), (0.3, 2.7), (0.2, 5.3))  # share of the amplitude, times the lowest
LOWEST = 0.1  # Hz

Whole = Model | CorrectedModel


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """A motion that is known exactly.

    Attributes:
        t: Session time [s]. Shape (n,).
        q, qd, qdd: Motion [rad, rad/s, rad/s^2]. Shapes (n, dof).
    """

    t: Array
    q: Array
    qd: Array
    qdd: Array

    @property
    def parts(self) -> tuple[Array, Array, Array]:
        """Positions, velocities, accelerations."""
        return self.q, self.qd, self.qdd


def exciting(robot: Robot, seconds: float = SECONDS, rate: float = RATE) -> Motion:
    """Return three sines per joint, within its range and near its speed limit."""
    lower, upper, speed = limits(robot)
    t = np.arange(round(seconds * rate)) / rate
    q, qd, qdd = np.zeros((3, len(t), robot.dof))
    for j in range(robot.dof):
        # No two joints ever repeat the same pose together.
        lowest = 2 * np.pi * LOWEST * (1 + 0.13 * j)
        fastest = sum(share * times * lowest for share, times in WAVES)
        size = min(TRAVEL * (upper[j] - lower[j]), 0.9 * speed[j] / fastest)
        for k, (share, times) in enumerate(WAVES):
            w, phase = times * lowest, j + 2.0 * k
            q[:, j] += size * share * np.sin(w * t + phase)
            qd[:, j] += size * share * w * np.cos(w * t + phase)
            qdd[:, j] -= size * share * w**2 * np.sin(w * t + phase)
    return Motion(t, q + (lower + upper) / 2, qd, qdd)


def limits(robot: Robot) -> tuple[Array, Array, Array]:
    """Return range and speed of each joint, defaults where it has none. (dof,) each."""
    lower = np.where(np.isfinite(robot.lower), robot.lower, -np.pi)
    upper = np.where(np.isfinite(robot.upper), robot.upper, np.pi)
    limited = np.isfinite(robot.velocity_limit)
    return lower, upper, np.where(limited, robot.velocity_limit, DEFAULT_SPEED)


@dataclass(frozen=True, slots=True)
class Left:
    """What a target has no place for, and the torque that it lacks for that.

    Attributes:
        name: The effect; "tables" on top of a model, or the "rigid body".
        joints: Its joints, from 1; empty for all.
        why: Why it is left out.
        rms: Torque that is missing, of the joint that misses most [N m].
        largest: Largest torque that is missing on any joint [N m].
    """

    name: str
    joints: tuple[int, ...]
    why: str
    rms: float
    largest: float

    def __str__(self) -> str:
        on = "".join(f" J{j}" for j in self.joints)
        size = f"up to {self.largest:.3g} N m (rms {self.rms:.3g})"
        return f"{self.name}{on}: {size}; {self.why}"


@dataclass(frozen=True, eq=False, slots=True)
class Exported:
    """A model in the form of another program.

    Attributes:
        files: Content by file name.
        whole: The model.
        carried: What of it is in the files.
        left: What is not.
        rms, largest: Torque that is missing for all that is left out together [N m].
    """

    files: Mapping[str, bytes]
    whole: Whole
    carried: Whole
    left: tuple[Left, ...] = ()
    rms: float = 0.0
    largest: float = 0.0


def split(whole: Whole, refuse: Callable[[Term], str], tables: str = "") -> Exported:
    """Part what a target can carry from what it cannot.

    Args:
        refuse: Why the target has no place for a term; "" where it has.
        tables: Why it has none for tables; "" where it has.

    Returns:
        The export, its files still missing.
    """
    # What the model has without a name is among its terms.
    model = body_of(whole)
    whole = with_terms(whole, (*model.terms, *model.tables))
    terms = body_of(whole).terms
    reasons = {term: why for term in terms if (why := refuse(term))}
    kept = with_terms(whole, (t for t in terms if t not in reasons))
    corrected = whole if tables and isinstance(whole, CorrectedModel) else None
    if corrected:
        kept = body_of(kept)
    elif not reasons:
        return Exported({}, whole, kept)
    motion = exciting(model.robot)
    full = whole.along(motion.t, motion.parts)

    def lack(without: Whole) -> tuple[float, float]:
        return size_of(full - without.along(motion.t, motion.parts))

    left = []
    for term, why in reasons.items():
        joints = tuple(j + 1 for j in term.joints)
        rest = with_terms(whole, (t for t in terms if t is not term))
        left.append(Left(term.effect.name, joints, why, *lack(rest)))
    if corrected:
        joints = tuple(t.joint + 1 for t in corrected.tables)
        left.append(Left("tables", joints, tables, *lack(body_of(whole))))
    return Exported({}, whole, kept, tuple(left), *lack(kept))


def with_terms(whole: Whole, terms: Iterable[Term]) -> Whole:
    """Return a model with other terms, and nothing beside them but tables on top."""
    model = replace(body_of(whole), terms=tuple(terms), tables=())
    return replace(whole, model=model) if isinstance(whole, CorrectedModel) else model


def body_of(whole: Whole) -> Model:
    """Return the model without its tables."""
    return whole.model if isinstance(whole, CorrectedModel) else whole


def file_stem(whole: Whole) -> str:
    """Return the robot's name as a file may have it: a record may be a stranger's."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", body_of(whole).robot.name) or "arm"


def with_bodies(model: Model) -> Array:
    """Return inertial parameters with all bodies that its terms add. (10 dof,)."""
    total = model.inertial.copy()
    for term in model.terms:
        if add := term.effect.portable.bodies:
            total += add(term.theta, term.joints, model.robot)
    for number, mass in enumerate(total[::10], start=1):
        if not mass > 0:
            raise InputError(
                f"Link {number} has mass {mass:.3g} kg in this model, and no simulator "
                "takes that. Identify it with --consistent, which keeps bodies "
                "possible, or export it to c99, which takes any numbers."
            )
    return total


def size_of(gap: Array) -> tuple[float, float]:
    """Return a torque's rms on the joint that has most, and its largest value [N m]."""
    return float(np.sqrt((gap**2).mean(axis=0)).max()), float(np.abs(gap).max())


def to_json(whole: Whole) -> Exported:
    """Return a model as the file that ``load_model`` reads."""
    text = json.dumps(to_record(whole), allow_nan=False, indent=1) + "\n"
    files = {f"{file_stem(whole)}.json": text.encode()}
    return replace(split(whole, lambda term: ""), files=files)
