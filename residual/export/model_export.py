"""The result of an export: its files, and the torque of the terms that they omit.

The torque is computed along one motion, which is the same at every call.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from residual.errors import InputError
from residual.model.lookup import AnyModel, CorrectedModel, remove_tables, replace_model
from residual.model.model import Model, Term
from residual.recording import Array
from residual.robot.robot import Robot

DEFAULT_SPEED = 2.0  # rad/s, for a joint without a speed limit
SECONDS, RATE = 10.0, 250.0
TRAVEL = 0.4  # of a joint's range to each side of its middle
WAVES = ((0.5, 1.0), (0.3, 2.7), (0.2, 5.3))  # share of the amplitude, times the lowest
LOWEST = 0.1  # Hz


@dataclass(frozen=True, eq=False, slots=True)
class NoiselessMotion:
    """A motion without measurement noise.

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


def build_reference_motion(robot: Robot, seconds: float = SECONDS) -> NoiselessMotion:
    """Return three sines per joint, within its range and near its speed limit."""
    lower, upper, speed = fill_joint_limits(robot)
    t = np.arange(round(seconds * RATE)) / RATE
    q, qd, qdd = np.zeros((3, len(t), robot.dof))
    for j in range(robot.dof):
        # Incommensurate frequencies: no pose repeats.
        lowest = 2 * np.pi * LOWEST * (1 + 0.13 * j)
        fastest = sum(share * times * lowest for share, times in WAVES)
        size = min(TRAVEL * (upper[j] - lower[j]), 0.9 * speed[j] / fastest)
        for k, (share, times) in enumerate(WAVES):
            w, phase = times * lowest, j + 2.0 * k
            q[:, j] += size * share * np.sin(w * t + phase)
            qd[:, j] += size * share * w * np.cos(w * t + phase)
            qdd[:, j] -= size * share * w**2 * np.sin(w * t + phase)
    return NoiselessMotion(t, q + (lower + upper) / 2, qd, qdd)


def fill_joint_limits(robot: Robot) -> tuple[Array, Array, Array]:
    """Return range and speed of each joint, defaults where it has none. (dof,) each."""
    speed = robot.velocity_limit
    return *robot.ends, np.where(np.isfinite(speed), speed, DEFAULT_SPEED)


@dataclass(frozen=True, slots=True)
class OmittedTerm:
    """A term that the target cannot represent, and its torque."""

    name: str  # the effect; "tables" on top of a model, or the "rigid body"
    joints: tuple[int, ...]  # from 1; empty for all
    why: str
    rms: float  # of the omitted torque, on the joint where it is largest [N m]
    largest: float  # omitted torque on any joint [N m]

    def __str__(self) -> str:
        on = "".join(f" J{j}" for j in self.joints)
        size = f"up to {self.largest:.3g} N m (rms {self.rms:.3g})"
        return f"{self.name}{on}: {size}; {self.why}"


@dataclass(frozen=True, eq=False, slots=True)
class ModelExport:
    """A model in the form of another program."""

    files: Mapping[str, bytes]  # content by file name
    source: AnyModel  # the model
    carried: AnyModel  # the exported part of it
    omissions: tuple[OmittedTerm, ...] = ()
    rms: float = 0.0  # torque of all omissions together, as in `OmittedTerm` [N m]
    largest: float = 0.0


def split_exportable_terms(
    source: AnyModel, explain_refusal: Callable[[Term], str], tables_refusal: str = ""
) -> ModelExport:
    """Separate the terms that a target can represent from the others.

    Args:
        explain_refusal: Returns why the target cannot represent a term; "" if it can.
        tables_refusal: Why it cannot represent tables; "" if it can.

    Returns:
        The export, still without files.
    """
    # Tables without a name count as terms.
    model = remove_tables(source)
    source = replace_terms(source, (*model.terms, *model.tables))
    terms = remove_tables(source).terms
    reasons = {term: why for term in terms if (why := explain_refusal(term))}
    kept = replace_terms(source, (t for t in terms if t not in reasons))
    corrected = source if tables_refusal and isinstance(source, CorrectedModel) else None
    if corrected:
        kept = remove_tables(kept)
    elif not reasons:
        return ModelExport({}, source, kept)
    motion = build_reference_motion(model.robot)
    full = source.along(motion.t, motion.parts)

    def lack(without: AnyModel) -> tuple[float, float]:
        return measure_torque_difference(full - without.along(motion.t, motion.parts))

    omissions = []
    for term, why in reasons.items():
        joints = tuple(j + 1 for j in term.joints)
        rest = replace_terms(source, (t for t in terms if t is not term))
        omissions.append(OmittedTerm(term.effect.name, joints, why, *lack(rest)))
    if corrected:
        joints = tuple(t.joint + 1 for t in corrected.tables)
        omissions.append(
            OmittedTerm("tables", joints, tables_refusal, *lack(remove_tables(source)))
        )
    return ModelExport({}, source, kept, tuple(omissions), *lack(kept))


def replace_terms(source: AnyModel, terms: Iterable[Term]) -> AnyModel:
    """Return a model with other terms and the same tables on top."""
    return replace_model(source, replace(remove_tables(source), terms=tuple(terms), tables=()))


def make_file_stem(source: AnyModel) -> str:
    """Return the robot's name with the characters that are safe in a file name."""
    return re.sub(r"[^A-Za-z0-9_-]+", "_", remove_tables(source).robot.name) or "arm"


def add_effect_bodies(model: Model) -> Array:
    """Return the inertial parameters including the bodies of all terms. (10 dof,)."""
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


def measure_torque_difference(difference: Array) -> tuple[float, float]:
    """Return a torque's rms on its strongest joint, and its largest value [N m]."""
    return float(np.sqrt((difference**2).mean(axis=0)).max()), float(np.abs(difference).max())


def to_json(source: AnyModel) -> ModelExport:
    """Return a model as the file that ``load_model`` reads."""
    text = json.dumps(source.to_record(), allow_nan=False, indent=1) + "\n"
    files = {f"{make_file_stem(source)}.json": text.encode()}
    return replace(split_exportable_terms(source, lambda term: ""), files=files)
