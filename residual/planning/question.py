"""What logs leave open: contests of rival models, as records."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import permutations

from residual.effects.base import PlacedEffect
from residual.model.model import Model
from residual.recording import Array
from residual.verdict.result import Place

NOTHING = Place("nothing", ())
TOGETHER = " + "  # between the names of a rival of several effects


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
    """

    place: Place
    columns: Array
    own: Array
    mean: Array
    precision: Array
    nats: float


@dataclass(frozen=True, eq=False, slots=True)
class Contest:
    """Models of which one is true.

    Attributes:
        rivals: The competing models, two or more.
        enough: Nats by which one must lead to be believed.
    """

    rivals: tuple[Rival, ...]
    enough: float

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Every ordered pair of rivals: the true one first."""
        return tuple(permutations(range(len(self.rivals)), 2))

    def lead(self, a: int, b: int) -> float:
        """By how much the logs so far prefer one rival to another [nats]."""
        return self.rivals[a].nats - self.rivals[b].nats


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
    effects: tuple[PlacedEffect, ...]
    signals: Signals
    contests: tuple[Contest, ...]


def together(places: Sequence[Place]) -> Place:
    """The name of a rival: that of its effect, or of several together."""
    if not places:
        return NOTHING
    joints = sorted({j for place in places for j in place.joints})
    return Place(TOGETHER.join(place.name for place in places), tuple(joints))
