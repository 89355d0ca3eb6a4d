"""The faults that a check finds in logs, their repairs, and their JSON form."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from residual.drive import Drive
from residual.errors import InputError, format_joint_numbers, quote_value
from residual.quantity import convert_to_plain_values

SCHEMA = 1
MOUNTING, INTERLEAVED, REMOVED = "mounting", "interleaved", "gravity_removed"
UNITS = ("torque_unit", "gear_ratio", "angle_unit", "time_unit")
# Kinds in stored checks that are now named by the diagnosis.
FORMER = ("friction_removed", "delay", "filtered")
KINDS: tuple[str, ...] = (
    MOUNTING,
    *("torque_sign", "angle_sign", "angle_zero", "joint_order", "torque_unit"),
    *("torque_scale", "angle_unit", "time_unit", "gear_ratio", REMOVED, "commanded"),
    *("clock", INTERLEAVED, "drive"),
    *("spike", "frozen", "constant", "quantised", "saturated", "velocity_mismatch"),
    *("out_of_range", "lockstep", "too_short", "no_reversal"),
    *("robot_file", "wrong_robot", *FORMER),
)


@dataclass(frozen=True, slots=True)
class Repair:
    """The correct reading of a signal, or of the robot file; None: unchanged."""

    signal: str  # "q", "qd", "tau", "q_ref", "t", "robot" or "drive"
    joints: tuple[int, ...] = ()  # its joints, from 1; () for all
    sign: tuple[int, ...] | None = None  # of each of the joints
    # Factor on the signal, one for all or one for each of the joints.
    scale: tuple[float, ...] | float | None = None
    # The log's channel (from 1) of the signal of joint 1, 2, ...
    order: tuple[int, ...] | None = None
    gravity: tuple[float, ...] | None = None  # in the base frame [m/s^2]
    gravcomp: bool | None = None  # whether the declaration of an MJCF holds
    # Logged angle of each of the joints at its zero [rad].
    zero: tuple[float, ...] | None = None
    unwrap: bool = False  # whether to unwrap whole turns
    drive: Drive | None = None  # how torque follows from the goal


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault of a log or of the robot file."""

    kind: str  # one of KINDS (docs/check.md)
    joints: tuple[int, ...]  # from 1; () for all
    certain: bool  # the given reading is excluded; else it is a warning
    evidence: str  # one or two sentences, with numbers
    repairs: tuple[Repair, ...] = ()  # until `repair` has them as lines
    log: str = ""  # id of the recording, until it is in the evidence; "" for all
    # Lines for COLUMNS.toml or robot.toml, each a complete repair: any of them works.
    repair: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()  # causes that explain the log nearly as well
    settle: str = ""  # how to separate them
    # Other repairs that work as well.
    alternatives: tuple[tuple[Repair, ...], ...] = ()

    @property
    def where(self) -> str:
        """Kind and joints: 'torque sign, joint 2'."""
        return name_fault(self.kind, self.joints)

    @property
    def sentence(self) -> str:
        """The fault, its evidence and its repair, in one line."""
        sure = "certain" if self.certain else "suspected"
        fix = f" Fix: {' or: '.join(self.repair)}" if self.repair else ""
        text = f"fault of the logs ({self.where}, {sure}): {self.evidence}{fix}"
        return " ".join(text.split())


def name_fault(kind: str, joints: tuple[int, ...]) -> str:
    """Return a kind of fault and its joints in words."""
    return kind.replace("_", " ") + (f", {format_joint_numbers(joints)}" if joints else "")


def list_true_joints(mask: np.ndarray) -> tuple[int, ...]:
    """Return the joints (from 1) for which it is true. Shape (dof,), bool."""
    return tuple(int(j) + 1 for j in np.flatnonzero(mask))


# Of a fault, as JSON.
_TOLD = ("kind", "joints", "certain", "evidence", "repair", "rivals", "settle")


@dataclass(frozen=True, slots=True, repr=False)
class LogCheck:
    """The faults of the logs of one command."""

    faults: tuple[Fault, ...] = ()  # certain ones first

    @property
    def verdict(self) -> str:
        """Return "clean", "suspect", or "unusable" where any fault is certain."""
        if self.certain:
            return "unusable"
        return "suspect" if self.faults else "clean"

    @property
    def certain(self) -> tuple[Fault, ...]:
        """The faults that exclude the given reading."""
        return tuple(fault for fault in self.faults if fault.certain)

    @property
    def sentences(self) -> tuple[str, ...]:
        """Every fault in a line."""
        return tuple(fault.sentence for fault in self.faults)

    def to_json(self) -> dict:
        """Return the check in its documented form (docs/check.md)."""
        faults = [{name: getattr(f, name) for name in _TOLD} for f in self.faults]
        return convert_to_plain_values(
            {"schema": SCHEMA, "verdict": self.verdict, "faults": faults}
        )

    def __repr__(self) -> str:
        lines = [f"LogCheck({self.verdict})"]
        for fault in self.faults:
            sure = "certain" if fault.certain else "suspect"
            lines.append(f"  {fault.where} ({sure}): {fault.evidence}")
            lines += [f"    {x}" for each in fault.repair for x in each.splitlines()]
        return "\n".join(lines)


def read_log_check(document: Mapping) -> LogCheck:
    """Return the check of a document."""
    if document.get("schema") != SCHEMA:
        raise InputError(
            f"A check of schema {quote_value(document.get('schema'))}, expected {SCHEMA}."
        )
    faults = []
    try:
        for each in document["faults"]:
            line = each["repair"]  # in checks of before one line, or null
            own = each["kind"], tuple(each["joints"]), each["certain"], each["evidence"]
            repair = tuple([line] if isinstance(line, str) else line or ())
            rivals, settle = tuple(each.get("rivals", ())), each.get("settle", "")
            faults.append(Fault(*own, repair=repair, rivals=rivals, settle=settle))
    except (KeyError, TypeError) as error:
        raise InputError(f"This is no whole check: {error!r}.") from error
    return LogCheck(tuple(faults))
