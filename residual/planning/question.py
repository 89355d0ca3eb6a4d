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
    """One model that may be true, as a Gaussian over coefficients of shared columns."""

    place: Place  # the effect that makes the difference, `NOTHING` for none
    columns: Array  # which of the shared columns it has, (k,)
    effect_columns: Array  # which of these are the effect's own; empty for none, (e,)
    mean: Array  # their posterior mean [SI], (k,)
    precision: Array  # their posterior precision, (k, k)
    # Evidence of the logs so far, less the price of the name [nats], up to a constant
    # that is the same for all rivals of a contest.
    nats: float


@dataclass(frozen=True, eq=False, slots=True)
class Contest:
    """Models of which one is true."""

    rivals: tuple[Rival, ...]  # two or more
    enough: float  # nats by which one must lead to be believed

    @property
    def pairs(self) -> tuple[tuple[int, int], ...]:
        """Every ordered pair of rivals: the true one first."""
        return tuple(permutations(range(len(self.rivals)), 2))

    def lead(self, a: int, b: int) -> float:
        """By how much the logs so far prefer one rival to another [nats]."""
        return self.rivals[a].nats - self.rivals[b].nats


@dataclass(frozen=True, eq=False, slots=True)
class Signals:
    """How the logs so far were read, and so will the next one be."""

    information: Array  # of a row's squared error [1 / N^2 m^2], (dof,)
    speed_floor: Array  # speed under which a joint stands [rad/s], (dof,)
    rate: float  # rows per second [Hz]
    margin: float  # time about a standstill that does not count [s]
    edge: float  # time at both ends of a log that does not count [s]
    start: float  # session time at which the next log may begin [s]


@dataclass(frozen=True, eq=False, slots=True)
class Question:
    """What the logs so far leave open."""

    nominal: Model  # the model that deviations are counted from
    seen_with: Model  # the model whose torque the effects see
    effects: tuple[PlacedEffect, ...]  # columns after the inertial ones
    signals: Signals
    contests: tuple[Contest, ...]  # empty if nothing is open


def together(places: Sequence[Place]) -> Place:
    """The name of a rival: that of its effect, or of several together."""
    if not places:
        return NOTHING
    joints = sorted({j for place in places for j in place.joints})
    return Place(TOGETHER.join(place.name for place in places), tuple(joints))
