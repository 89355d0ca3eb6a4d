"""What is left open after some logs: rival models, and what is known of each."""

from dataclasses import dataclass

from residual.diagnosis.result import Place
from residual.effects.base import Effect, Joints, Shape
from residual.model.model import Model
from residual.recording import Array

NOTHING = Place("nothing", ())
TOGETHER = " + "  # between the names of a rival of several effects
Column = tuple[Effect, Joints, Shape]


@dataclass(frozen=True, eq=False, slots=True)
class Rival:
    """One model that may be true, as a Gaussian over coefficients of shared columns.

    Attributes:
        place: The effect that makes the difference, `NOTHING` for none.
        columns: Which of the shared columns it has. Shape (k,).
        own: Which of these are the effect's own; empty for none. Shape (e,).
        mean: Their posterior mean [SI]. Shape (k,).
        precision: Their posterior precision. Shape (k, k).
        nats: Evidence of the logs so far, less the price of the name, up to a constant
            that is the same for all rivals of a contest.
        explained: What it explains on the joint of the contest beyond the model without
            the effect: fall of its weighted squared error [nats].
    """

    place: Place
    columns: Array
    own: Array
    mean: Array
    precision: Array
    nats: float
    explained: float


@dataclass(frozen=True, eq=False, slots=True)
class Contest:
    """Models of which one is true.

    Attributes:
        rivals: They; two or more.
        enough: Nats by which one must lead to be believed.
        joint: The joint where they differ most, from 0.
        kin: Pairs (of indices) that pass for one name while the second explains nearly
            all that the first does, whatever the nats.
        nothing: The model without any of them: what `explained` is counted from.
    """

    rivals: tuple[Rival, ...]
    enough: float
    joint: int
    kin: frozenset[tuple[int, int]]
    nothing: Rival

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Every ordered pair of rivals, by index: the true one first."""
        count = range(len(self.rivals))
        return tuple((a, b) for a in count for b in count if a != b)


@dataclass(frozen=True, eq=False, slots=True)
class Signals:
    """How the logs so far were read, and so will the next one be.

    Attributes:
        information: Of a row's squared error, row counts and noise in it
            [1 / N^2 m^2]. Shape (dof,).
        speed_floor: Speed under which a joint stands [rad/s]. Shape (dof,).
        rate: Rows per second [Hz].
        margin: Time about a standstill that does not count [s].
        edge: Time at both ends of a log that does not count [s].
        start: Session time at which the next log may begin [s].
    """

    information: Array
    speed_floor: Array
    rate: float
    margin: float
    edge: float
    start: float


@dataclass(frozen=True, eq=False, slots=True)
class Question:
    """What the logs so far leave open.

    Attributes:
        nominal: The model that deviations are counted from.
        seen_with: The model whose torque the effects see.
        effects: Columns after the inertial ones: effect, joints from 0, shape.
        signals: How logs are read.
        contests: What is to be decided; empty if nothing is open.
    """

    nominal: Model
    seen_with: Model
    effects: tuple[Column, ...]
    signals: Signals
    contests: tuple[Contest, ...]
