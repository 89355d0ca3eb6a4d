"""What a search works on, and the thresholds that it and the gate go by."""

from collections.abc import Sequence
from dataclasses import dataclass

from residual.diagnosis.candidates import Candidates
from residual.evidence.design import Design, Group
from residual.evidence.fit import Fit, Prior, fit, gain, settled, start
from residual.recording import Array


@dataclass(frozen=True, slots=True)
class Rules:
    """Thresholds of the search and of the gate (measured: docs/method.md).

    Attributes:
        threshold: Evidence that a name must win [nats].
        plausible: The same where only implausible parameters speak for it [nats].
        tolerance: Least fall of a joint's error, as a share of torque rms.
        share: Least share of what was left unexplained.
        clear: The share from which half of the tolerance is enough.
        size: Least torque of a name won by plausibility, as a share of rms.
        bent: Least part of such a win that the nominal parameters' prior saves.
        most: Most effects to add.
        shortlist: Candidates that get an exact look per step.
    """

    threshold: float = 10.0
    plausible: float = 30.0
    tolerance: float = 0.005
    share: float = 0.08
    clear: float = 0.15
    size: float = 0.02
    bent: float = 0.2
    most: int = 30
    shortlist: int = 15

    def lower(self, fall: Array, share: Array) -> Array:
        """Where an error falls by enough: of torque rms, and of what was left."""
        usual = (fall >= self.tolerance) & (share >= self.share)
        return usual | ((fall >= self.tolerance / 2) & (share >= self.clear))


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """What a search works on: data, prior, candidates and rules."""

    design: Design
    prior: Prior
    candidates: Candidates
    rules: Rules

    def fit(self, members: Sequence[Group], like: Fit, rounds: int = 3) -> Fit:
        """Fit a set with the row counts and noise of another fit to start from."""
        counted, variance = like.counted, like.variance
        return fit(self.design, self.prior, members, counted, variance, rounds)

    def settle(self, fitted: Fit) -> Fit:
        """Count rows anew by the fit's own residual and fit again."""
        return settled(self.design, self.prior, fitted)

    def start(self) -> Fit:
        """Fit of the nominal structure alone."""
        return start(self.design, self.prior)

    def net_gain(self, big: Fit, small: Fit, group: Group) -> float:
        """Evidence of ``big`` over ``small`` less the price of the group [nats]."""
        value, _, _ = gain(self.design, self.prior, big, small)
        return value - self.candidates.cost(group)
