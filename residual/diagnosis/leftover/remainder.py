"""What remains after everything that was named: how much, and what it depends on."""

from dataclasses import dataclass

Number = float | None  # None where it is not known


@dataclass(frozen=True, slots=True)
class Dependence:
    """What the remainder of one joint varies with.

    Attributes:
        joint: Whose remainder, from 1.
        on: "q", "qd", "qdd", "tau", "t" or "frequency".
        of: Whose q, qd, qdd or tau, from 1.
        form: "curve", "by direction", "sum" or "difference".
        share: Of the squared remainder beyond noise.
        frequency: Of a line [Hz], else None.
    """

    joint: int
    on: str
    of: tuple[int, ...]
    form: str
    share: float
    frequency: Number


@dataclass(frozen=True, slots=True)
class Unexplained:
    """What remains after everything that was named.

    Attributes:
        joints: Joints from 1 on which more than noise remains.
        fraction, noise_floor: Of the torque, that nothing explains; that is noise.
        depends_on: What the remainder of these joints varies with.
        kind: "repeatable", "time-driven", or None.
        per_joint: Fraction of every joint.
        noise_model: Where the noise level is from.
    """

    joints: tuple[int, ...]
    fraction: Number
    noise_floor: Number
    depends_on: tuple[Dependence, ...]
    kind: str | None
    per_joint: tuple[Number, ...]
    noise_model: str | None
