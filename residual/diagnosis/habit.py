"""What a baseline knows of an effect that its model has not: how much it had of it.

That an effect is a change must be shown against the baseline's own logs. What these
cannot rule out at its size may have been there before, and was not named for want of
motion that shows it.
"""

from dataclasses import dataclass

import numpy as np

from residual.recording import Array


@dataclass(frozen=True, eq=False, slots=True)
class Habit:
    """One candidate, as the logs of a baseline have it.

    Attributes:
        shape: Its shape there.
        excess: How many times more than noise each log has of it beside the others,
            less one.
        theta: Coefficients that the arm had, in expectation. Shape (k,).
        covariance: Of these. Shape (k, k); zero for an arm that is as its model says.
    """

    shape: tuple[float, ...]
    excess: float
    theta: Array
    covariance: Array

    @property
    def restless(self) -> float:
        """What evidence is worth where only the unrest is asked about."""
        return 1.0 if self.covariance.any() else 1 / (1 + self.excess)

    def share(self, theta: Array, information: Array, precision: Array) -> float:
        """Share of the evidence of an effect that is evidence of a change.

        Args:
            theta: Its coefficients by the new logs, without a prior. Shape (k,).
            information: What these logs know of them. Shape (k, k).
            precision: The prior's. Shape (k, k).
        """
        if not self.covariance.any():
            return self.restless
        known = np.linalg.solve(
            np.eye(len(theta)) + information @ self.covariance, information
        )
        every = _energy(information @ theta, information + precision)
        change = _energy(known @ (theta - self.theta), known + precision)
        ratio = float(np.clip(change / max(every, 1e-300), 0.0, 1.0))
        # What varies from log to log of the baseline varies so in the new ones, too.
        return ratio / (1 + self.excess)


def _energy(pull: Array, precision: Array) -> float:
    return float(pull @ np.linalg.solve(precision, pull))
