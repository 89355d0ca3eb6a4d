"""A Fourier motion as unknowns of a search: its cost, its limits, their slopes.

No difference over coefficients is needed. The regressor at one sample depends on q, qd
and qdd of that sample alone, so its 3 dof derivatives there give the slope by every
coefficient; they are taken by differences, since Pinocchio has none of the regressor.
"""

from dataclasses import dataclass

import numpy as np

from residual.recording import Array
from residual.robot.base_parameters import base_columns
from residual.robot.dynamics import inertial_parameters, regressor
from sim.engine.geometry import MARGIN, clearances
from sim.records import Drives
from sim.trajectories.curves import Series
from sim.trajectories.excitation import cost
from sim.trajectories.fourier import FREE, Arena, harmonics, sampled
from sim.trajectories.limits import declared_friction

_SAMPLES = 44  # of a period; the fastest harmonic has nine of them
_WEIGHT = 300.0  # of torque and clearance, which are penalties
_APART = 2.5 * MARGIN  # aimed at, since clearance is seen at few samples here
_INSIDE = 0.985  # of the limits, for the same reason
_STEP = 1e-6  # of the differences, in SI units
_SHARP = 60  # power that stands for the largest of the samples


@dataclass(frozen=True, eq=False, slots=True)
class Problem:
    """Cost and limits of a motion, by unknowns x.

    x holds the centre, then FREE coefficients, per joint, all in units of half of that
    joint's range. Shape ((1 + FREE) * dof,).
    """

    place: Arena
    columns: Array
    parameters: Array
    friction: Drives
    basis: tuple[Array, Array, Array]  # q, qd, qdd per coefficient, (samples, FREE)

    def series(self, x: Array) -> Series:
        """Return the motion of x."""
        centre, free = self._unpack(x)
        return Series(centre, *harmonics(free), self.place.period)

    def point(self, series: Series) -> Array:
        """Return the unknowns of a motion that is at rest at its ends."""
        limits = self.place.limits
        both = np.vstack([series.sine, series.cosine])
        free = np.linalg.lstsq(np.vstack(harmonics(np.eye(FREE))), both)[0]
        centre = (series.centre - limits.middle) / limits.half
        return np.vstack([centre, free / limits.half]).ravel()

    def cost(self, x: Array) -> tuple[float, Array]:
        """Return the cost of excitation, torque and clearance, and its slope."""
        q, qd, qdd = self._motion(x)
        value, slopes = self._excitation(q, qd, qdd)
        extra, slope = self._clearance(q)
        slopes[0] = slopes[0] + slope
        by_free = sum(b.T @ s for b, s in zip(self.basis, slopes, strict=True))
        gradient = np.vstack([slopes[0].sum(axis=0), by_free])
        return value + extra, (gradient * self.place.limits.half).ravel()

    def spare(self, x: Array) -> Array:
        """Return what is left of range, speed and acceleration. Shape (3 * dof,)."""
        return np.concatenate([_INSIDE - _largest(u)[0] for u in self._shares(x)])

    def spare_slopes(self, x: Array) -> Array:
        """Return the derivative of `spare` by x. Shape (3 * dof, x)."""
        limits = self.place.limits
        dof, joints = len(limits.half), np.arange(len(limits.half))
        bounds = (limits.half, limits.velocity, limits.acceleration)
        out = np.zeros((3, dof, 1 + FREE, dof))
        for i, share in enumerate(self._shares(x)):
            slope = _largest(share)[1] * limits.half / bounds[i]
            out[i, joints, 1:, joints] = -(self.basis[i].T @ slope).T
            if i == 0:
                out[i, joints, 0, joints] = -slope.sum(axis=0)
        return out.reshape(3 * dof, -1)

    def _unpack(self, x: Array) -> tuple[Array, Array]:
        x = x.reshape(1 + FREE, -1) * self.place.limits.half
        return self.place.limits.middle + x[0], x[1:]

    def _motion(self, x: Array) -> tuple[Array, Array, Array]:
        centre, free = self._unpack(x)
        q, qd, qdd = (b @ free for b in self.basis)
        return centre + q, qd, qdd

    def _shares(self, x: Array) -> tuple[Array, Array, Array]:
        limits, (q, qd, qdd) = self.place.limits, self._motion(x)
        return (
            (q - limits.middle) / limits.half,
            qd / limits.velocity,
            qdd / limits.acceleration,
        )

    def _excitation(self, q: Array, qd: Array, qdd: Array) -> tuple[float, list]:
        """Return the cost of excitation and torque, and its slopes by q, qd, qdd."""
        n, dof = q.shape
        rows = self._regressors(q, qd, qdd)
        value, slope = cost(rows[0][:, :, self.columns].reshape(n * dof, -1))
        by_row = np.zeros(rows.shape[1:])
        by_row[:, :, self.columns] = slope.reshape(n, dof, -1)
        own = self.friction
        torque = rows[0] @ self.parameters + own.rotor * qdd + own.viscous * qd
        bound = np.maximum(_INSIDE * self.place.limits.torque - own.coulomb, 1e-9)
        extra, by_torque = _penalty(np.abs(torque) / bound - 1.0)
        by_torque = by_torque * np.sign(torque) / bound
        by_row += by_torque[:, :, None] * self.parameters
        turned = (rows[1:] - rows[0]).reshape(3 * dof, n, -1)
        turned = np.einsum("snp,np->sn", turned, by_row.reshape(n, -1)) / _STEP
        slopes = list(turned.reshape(3, dof, n).transpose(0, 2, 1))
        slopes[1] = slopes[1] + own.viscous * by_torque
        slopes[2] = slopes[2] + own.rotor * by_torque
        return value + extra, slopes

    def _regressors(self, *motion: Array) -> Array:
        """Return regressors of the samples, then with each value a step further."""
        n, dof = motion[0].shape
        states = np.tile(np.stack(motion), (1, 1 + 3 * dof, 1))
        for i in range(3 * dof):
            states[i // dof, (1 + i) * n : (2 + i) * n, i % dof] += _STEP
        rows = regressor(self.place.robot.model, *states)
        return rows.reshape(1 + 3 * dof, n, dof, -1)

    def _clearance(self, q: Array) -> tuple[float, Array]:
        """Return the penalty of samples too near to the floor or the arm itself."""
        arm, slope = self.place.arm, np.zeros_like(q)
        missing = (_APART - clearances(arm, q)) / arm.radius
        value, by_missing = _penalty(missing)
        near = np.flatnonzero((missing > 0).any(axis=1))
        if len(near):
            for joint in range(q.shape[1]):
                moved = q[near]
                moved[:, joint] += _STEP
                change = (_APART - clearances(arm, moved)) / arm.radius - missing[near]
                slope[near, joint] = (by_missing[near] * change).sum(axis=1) / _STEP
        return value, slope


def problem(place: Arena) -> Problem:
    """Return the search for the best motion in an arena."""
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES * place.period
    unit = Series(np.zeros(FREE), *harmonics(np.eye(FREE)), place.period)
    model = place.robot.model
    return Problem(
        place,
        base_columns(model),
        inertial_parameters(model),
        declared_friction(place.robot),
        sampled(unit, t),
    )


def _penalty(missing: Array) -> tuple[float, Array]:
    """Return the cost of what is missing (above 0), and its slope. Shapes (n, m)."""
    missing = np.maximum(missing, 0.0)
    weight = _WEIGHT / len(missing)
    return weight * float((missing**2).sum()), 2 * weight * missing


def _largest(values: Array) -> tuple[Array, Array]:
    """Return the p-norm of each column, p = 60, and its slope. Shapes (n, dof).

    It stands for the largest magnitude, which it exceeds by little, and is smooth.
    """
    size = np.abs(values)
    top = size.max(axis=0) + 1e-12
    total = ((size / top) ** _SHARP).sum(axis=0)
    slope = (size / top) ** (_SHARP - 1) * total ** (1 / _SHARP - 1)
    return top * total ** (1 / _SHARP), slope * np.sign(values)
