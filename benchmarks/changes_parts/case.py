"""The records of a case: what is listed of it, and the logs that it becomes."""

from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import TypeAdapter

from residual.recording import Recording
from residual.robot.robot import Robot

SIZES = (0.10, 0.05, 0.025)

# Groups of simulated arms, then of measured ones.
UNCHANGED, CHANGE, PAIRS, UNNAMED = "unchanged", "change", "pairs", "unnamed"
DRIFT, EDGE = "drift", "edge"
SIMULATED = (UNCHANGED, CHANGE, PAIRS, UNNAMED, DRIFT, EDGE)
REAL_UNCHANGED, REAL_CHANGE, LOAD = "measured_unchanged", "measured_change", "load"
MEASURED = (REAL_UNCHANGED, REAL_CHANGE, LOAD)
GROUPS = (*SIMULATED, *MEASURED)


@dataclass(frozen=True, slots=True)
class Part:
    """One log of an epoch."""

    what: str  # family of the motion; of a measured log its file
    seed: int  # seed of the motion; 0 of a measured log
    start: float  # where in the file it begins [s]; 0 of a simulated log
    duration: float  # its length [s]


@dataclass(frozen=True, slots=True)
class Planted:
    """One change."""

    name: str  # its name in the vocabulary; ``x_...`` outside of it
    joints: tuple[int, ...]  # its joints, from 1; () for one of the whole arm
    parameters: tuple[tuple[str, float], ...]  # Name and value of each parameter, SI
    # RMS of its torque over RMS of the joint's; 0 where that is not known
    size: float = 0.0


@dataclass(frozen=True, slots=True)
class Case:
    """One arm in two epochs, as the list has it."""

    group: str
    seed: int
    index: int
    arm: str
    background: str  # how dirty it is; "" of a measured arm
    plant: int  # seed of what makes this arm differ from its description
    noise: int
    worked: tuple[float, float]  # usual work before each session [s]
    first: tuple[Part, ...]
    second: tuple[Part, ...]
    # A further log of the second epoch; none of a measured arm
    held_out: tuple[Part, ...] = ()
    planted: tuple[Planted, ...] = ()
    target: float = 0.0  # size asked for; 0 where none was

    @property
    def name(self) -> str:
        """Key of its result: without what was drawn, since the seed decides that."""
        size = f" {self.target:g}" if self.target else ""
        changed = "".join(f" {p.name} {list(p.joints)}" for p in self.planted)
        if self.group in (REAL_UNCHANGED, LOAD):
            epochs = ("+".join(p.what for p in e) for e in (self.first, self.second))
            return f"{self.group} {self.arm} {' -> '.join(epochs)} {self.index}"
        return f"{self.group}{size} {self.seed}/{self.index} {self.arm}{changed}"


@dataclass(frozen=True, slots=True)
class Truth:
    """What changed, as a verdict ought to say it."""

    name: str
    # Its joints from 1, in order; of a load the last, () for the whole arm
    joints: tuple[int, ...]
    parameters: Mapping[str, float]  # in the torque that the drives report
    size: float  # RMS of its torque over RMS of the joint's


@dataclass(frozen=True, eq=False, slots=True)
class Made:
    """The logs of a case, with the truth beside them."""

    robot: Robot  # the arm as its description has it
    first: tuple[Recording, ...]
    second: tuple[Recording, ...]
    # A further log of the second epoch; () to let the method cut one
    held_out: tuple[Recording, ...]
    truth: tuple[Truth, ...]
    # Friction of the second epoch over that of the first, by warmth alone, over all
    # joints; None where nothing warms or nobody knows
    factor: float | None = None


def from_json(record: Mapping) -> Case:
    return _CASE.validate_python(record)


_CASE = TypeAdapter(Case)
