"""What a check finds in a log, and how it is repaired."""

from dataclasses import dataclass

DELAY = "delay"
KINDS: tuple[str, ...] = (
    "torque_sign",
    "angle_sign",
    "joint_order",
    "torque_unit",
    "angle_unit",
    "time_unit",
    "gear_ratio",
    "torque_scale",
    "gravity_removed",
    "friction_removed",
    "commanded",
    "clock",
    "spike",
    "frozen",
    "constant",
    "quantised",
    "saturated",
    DELAY,
    "filtered",
    "velocity_mismatch",
    "out_of_range",
    "lockstep",
    "too_short",
    "no_reversal",
    "robot_file",
    "wrong_robot",
)


@dataclass(frozen=True, slots=True)
class Repair:
    """How a signal of the log, or the robot file, has to be read.

    Attributes:
        signal: "q", "qd", "tau", "q_ref", "t" or "robot".
        joints: Joints that it concerns, from 1; () for all.
        sign: Sign of each of the joints; None where it stays.
        scale: Factor on the signal, one for all or one for each of the joints; None
            where it stays.
        order: The log's channel (from 1) that is the signal of joint 1, 2, ...; None
            where it stays.
    """

    signal: str
    joints: tuple[int, ...] = ()
    sign: tuple[int, ...] | None = None
    scale: tuple[float, ...] | float | None = None
    order: tuple[int, ...] | None = None


@dataclass(frozen=True, slots=True)
class Fault:
    """One thing that is wrong with a log or with the robot file.

    Attributes:
        kind: One of KINDS.
        joints: Its joints, from 1; () for all.
        certain: Whether the reading given is excluded; else it is a warning.
        evidence: One or two sentences, with numbers.
        repairs: What mends it; empty where nothing can.
        log: Id of the recording, "" for all of them.
    """

    kind: str
    joints: tuple[int, ...]
    certain: bool
    evidence: str
    repairs: tuple[Repair, ...] = ()
    log: str = ""


@dataclass(frozen=True, slots=True)
class LogCheck:
    """What is wrong with the logs of one diagnosis.

    Attributes:
        faults: The faults, certain ones first.
    """

    faults: tuple[Fault, ...]
