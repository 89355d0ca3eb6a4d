"""Evidence that a torque channel is the torque of a joint, in a sign and a unit.

The torque of joint j is what the columns of `residual.check.columns` can give:

tau ~ N(Y_j pi_0, sigma^2 1 + A A^T),

times the odds that its friction takes power rather than gives it.

One decomposition of A^T A per joint gives the evidence of every channel, sign and
unit, for every sigma.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import eigh
from scipy.special import log_ndtr

from residual.check.columns import Columns, columns
from residual.check.motion import Motion
from residual.check.rules import CHECK
from residual.lazy import Lazy
from residual.recording import Array
from residual.robot.robot import Robot

# Logs in the order that they say are the rule, and need none of it.
optimize = Lazy("scipy.optimize")

# Noise and all that the model lacks, as a share of the channel's rms.
# A rough model is not said to be nearer than 5 %: what is left is no witness.
_SIGMAS = np.geomspace(0.05, 1.3, 8)


@dataclass(frozen=True, eq=False, slots=True)
class Scores:
    """Sums from which the evidence of each channel for each joint follows.

    Attributes:
        values: Eigenvalues of each joint's whitened Gram matrix. dof of (p,).
        channel: Channels in their bases. dof of (p, dof).
        model: The nominal torque in them. dof of (p,).
        power: Squares of the channels, summed. Shape (dof, dof), [joint, channel].
        varying: The same about the channel's mean. Shape (dof, dof).
        cross: Channel times nominal torque. Shape (dof, dof).
        own: Squares of the nominal torque, summed. Shape (dof,).
        rows: Independent rows of each joint. Shape (dof,).
        strongest: Largest mean square of a channel.
        brake: Power that friction takes, of coefficients of one, in the bases. (p,).
    """

    values: tuple[Array, ...]
    channel: tuple[Array, ...]
    model: tuple[Array, ...]
    power: Array
    varying: Array
    cross: Array
    own: Array
    rows: Array
    strongest: float
    brake: tuple[Array, ...]

    def fit(self, joint: int, channel: int, factor: float) -> float:
        """Return that evidence over the one of a constant [nats]."""
        n, power = self.rows[joint], self.varying[joint, channel]
        nothing = -0.5 * n * (np.log(power / max(n, 1) + 1e-300) + 1)
        return float(self.evidence(joint, channel, np.array([factor]))[0]) - nothing

    def strain(self, joint: int, channel: int, factor: float) -> float:
        """Return how far the robot file must bend to that torque, and still misses it.

        Half the square of its coefficients in deviations of their prior, and what is
        lost by a remainder of more than `CHECK.rough` of the torque [nats].
        """
        n, power = self.rows[joint], self.power[joint, channel]
        given = np.array([factor])
        best = int(np.argmax(self._table(joint, channel, given)[:, 0]))
        sigma, var = _SIGMAS[best], self._variance(joint, channel, given)[best, 0]
        c = factor * self.channel[joint][:, channel] - self.model[joint]
        bent = 0.5 * float(np.sum((c / (self.values[joint] + var)) ** 2))
        return bent + n * max(0.0, float(np.log(sigma / CHECK.rough))) if power else 0.0

    def evidence(self, joint: int, channel: int, factor: Array) -> Array:
        """Return log evidence that factor * channel is the torque of that joint.

        Args:
            joint: Joint from 0.
            channel: Torque channel from 0.
            factor: Signs times units. Shape (k,).

        Returns:
            Nats, up to a constant of the channel. Shape (k,).
        """
        return self._table(joint, channel, np.asarray(factor, dtype=float)).max(axis=0)

    def _variance(self, joint: int, channel: int, factor: Array) -> Array:
        """Square of noise and of all that the model lacks. Shape (sigmas, k)."""
        n = max(self.rows[joint], 1)
        var = (_SIGMAS[:, None] * factor) ** 2 * self.power[joint, channel] / n
        var += (CHECK.coupled * factor) ** 2 * self.strongest
        return var + CHECK.exact * self.own[joint] / n + 1e-300

    def _table(self, joint: int, channel: int, factor: Array) -> Array:
        """Evidence for each size of what the model lacks. Shape (sigmas, k)."""
        n, d = self.rows[joint], self.values[joint]
        power = self.power[joint, channel]
        square = factor**2 * power - 2 * factor * self.cross[joint, channel]
        square = square + self.own[joint]
        c = factor[:, None] * self.channel[joint][:, channel] - self.model[joint]
        var = self._variance(joint, channel, factor)
        wide = d + var[:, :, None]
        quad = (square - (c**2 / wide).sum(-1)) / var
        size = n * np.log(var) + np.log1p(d / var[:, :, None]).sum(-1)
        brake = self.brake[joint]
        power, spread = (brake * c / wide).sum(-1), var * (brake**2 / wide).sum(-1)
        brakes = log_ndtr(power / np.sqrt(np.maximum(spread, 1e-300))) + np.log(2)
        nats = brakes - 0.5 * (quad + size)
        return n * np.log(np.abs(factor)) + nats


def torque_scores(robot: Robot, motion: Motion) -> Scores:
    """Sum up a motion for all joints and channels."""
    parts = [_joint(motion, each) for each in columns(robot, motion)]
    values, channel, model, power, varying, cross, own, rows, brake = zip(
        *parts, strict=True
    )
    return Scores(
        values,
        channel,
        model,
        np.array(power),
        np.array(varying),
        np.array(cross),
        np.array(own),
        np.array(rows),
        float(np.mean(motion.tau**2, axis=0).max()),
        brake,
    )


def _joint(motion: Motion, own: Columns) -> tuple:
    weight, a = motion.spread, own.values
    tau, mean = motion.tau[own.rows], own.nominal
    values, vectors = eigh(weight * a.T @ a)
    turned = weight * (a @ vectors).T
    return (
        np.maximum(values, 0.0),
        turned @ tau,
        turned @ mean,
        weight * np.sum(tau**2, axis=0),
        weight * np.sum((tau - tau.mean(axis=0)) ** 2, axis=0)
        if len(tau)
        else 0 * tau.sum(axis=0),
        weight * mean @ tau,
        weight * float(mean @ mean),
        weight * len(tau),
        vectors.T @ own.brake,
    )


def best_order(value: Array) -> Array:
    """Assign a channel to every joint, so that the values are the most in all.

    Args:
        value: What each channel is worth to each joint. Shape (dof, dof).

    Returns:
        The channel of each joint. Shape (dof,).
    """
    if np.all(value.argmax(axis=1) == np.arange(len(value))):
        return np.arange(len(value))
    return optimize.linear_sum_assignment(value, maximize=True)[1]
