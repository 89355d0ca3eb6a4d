"""Possible bodies: the physically consistent parameters nearest to a fit.

A body's ten parameters belong to some distribution of positive mass if and only if its
pseudo-inertia is positive definite (Wensing, Kim, Slotine 2018, eq. 13):

J = [[tr(I) / 2 - I, h], [h', m]] > 0,    h = m c, I about the link frame

min  |U (x - x_0)|^2   over x with every J(x) in the cone

with U'U the information of the fit about its best x_0, prior included: undetermined
parameters move first, determined ones only as far as necessary. A convex problem, solved
by Newton's method on the logarithmic barrier (Boyd and Vandenberghe 2004, section 11.3).
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from residual.effects.base import EffectTrait
from residual.errors import InputError
from residual.model.model import Model, pair_coefficient_slices
from residual.recording import Array
from residual.robot.dynamics import PER_LINK
from residual.robot.robot import Robot

LEAST = 1e-4  # of the body's own scale: distance inside the cone
FLOOR_SIZE = 0.05  # m: least scale of a link, which may carry a tool
FLOOR_MASS = 0.005  # of the arm's mass, likewise
GAP = 1e-7  # of squared deviations: tolerance of the least distance
GROWTH = 20.0  # of the weight of the distance, from one centre to the next
STEPS = 60  # of Newton's method per centre; ten are typical
NEAR = 1e-6  # of the decrement squared: convergence to a centre
CALM = 0.06  # of the same: limit of quadratic convergence with full steps
ORDER = 4  # of a pseudo-inertia
# (row, column) of the tensor of each of the last six parameters.
_TENSOR = ((0, 0), (0, 1), (1, 1), (0, 2), (1, 2), (2, 2))


@dataclass(frozen=True, eq=False, slots=True)
class BodySums:
    """The bodies of a model as sums of its coefficients."""

    names: tuple[str, ...]  # in words, "link 3" or "the load"
    sums: Array  # ten parameters of each from ``Model.coefficients()``, (bodies, 10, s)
    # Root of the size of each pseudo-inertia: sqrt(m) (r, r, r, 1), (bodies, 4).
    scale: Array
    start: Array  # coefficients with possible bodies, (s,)
    not_negative: Array  # which coefficients cannot be negative, (k,)

    def compute_pseudo_inertias(self, coefficients: Array) -> Array:
        """Pseudo-inertias in units of their scale. Shape (bodies, 4, 4)."""
        return build_pseudo_inertias(self.sums @ coefficients) / _squares(self.scale)

    def list_impossible(self, coefficients: Array) -> tuple[str, ...]:
        """The impossible bodies of these coefficients."""
        least = np.linalg.eigvalsh(self.compute_pseudo_inertias(coefficients))[:, 0]
        bad = least < 0.5 * LEAST
        return tuple(n for n, b in zip(self.names, bad, strict=True) if b)


def build_body_sums(model: Model, friction: bool = False) -> BodySums:
    """Return the bodies of a model: its links with the bodies of terms, and its load.

    A load of negative mass was removed: its negative has to be a body.

    Args:
        friction: Whether to enforce coefficients that cannot be negative.
    """
    robot, c = model.robot, model.coefficients()
    links = np.zeros((PER_LINK * robot.dof, len(c)))
    size = len(model.inertial)
    links[:, :size] = np.eye(size)
    load, positive, placed = np.zeros((PER_LINK, len(c))), [], []
    for term, own in pair_coefficient_slices(model.terms, size):
        if term.effect.carries == "body":
            load[:, own] += np.eye(PER_LINK)
            placed.append(own)
        elif add := term.effect.portable.bodies:
            ways = np.eye(len(term.theta))
            added = [add(way, term.joints, robot) for way in ways]
            links[:, own] += np.transpose(added)
        if friction and EffectTrait.NOT_NEGATIVE in term.effect.traits:
            positive += range(own.start, own.stop)
    scale, start = compute_link_scales(robot), np.zeros(len(c))
    names = [f"link {i + 1}" for i in range(robot.dof)]
    sums = links.reshape(robot.dof, PER_LINK, -1)
    nominal = [body.toDynamicParameters() for body in list(robot.model.inertias)[1:]]
    for i, body in enumerate(nominal):
        unit = build_pseudo_inertias(body)[0] / _squares(scale[i])
        least = np.linalg.eigvalsh(unit)[0]
        own = slice(PER_LINK * i, PER_LINK * (i + 1))
        start[own] = body if least > 2 * LEAST else _ball(scale[i])
    if placed:
        sign = 1.0 if load[0] @ c > 0 else -1.0
        mass = FLOOR_MASS * sum(body[0] for body in nominal)
        own = np.sqrt(mass) * np.array([FLOOR_SIZE] * 3 + [1.0])
        names.append("the load" if sign > 0 else "the load that went")
        sums, scale = np.concatenate([sums, sign * load[None]]), np.vstack([scale, own])
        start[placed[0]] = sign * _ball(own)
    start[positive] = 1.0
    return BodySums(tuple(names), sums, scale, start, np.array(positive, int))


def _ball(scale: Array) -> Array:
    """A body with a given diagonal pseudo-inertia. Shape (10,)."""
    mass, turn = scale[3] ** 2, 2 * scale[0] ** 2
    return np.array([mass, 0, 0, 0, turn, 0, turn, 0, 0, turn])


def compute_link_scales(robot: Robot) -> Array:
    """Return the root of the size of each pseudo-inertia: sqrt(m) (r, 1). (dof, 4)."""
    out, bodies = [], list(robot.model.inertias)[1:]
    least = FLOOR_MASS * sum(body.mass for body in bodies)
    for body in bodies:
        values = np.array(body.toDynamicParameters())
        spread = values[[4, 6, 9]].sum() / 2 / max(body.mass, 1e-9)
        radius = max(np.sqrt(max(spread, 0.0)), FLOOR_SIZE)
        out.append(np.sqrt(max(body.mass, least)) * np.array([radius] * 3 + [1.0]))
    return np.array(out)


def build_pseudo_inertias(parameters: Array) -> Array:
    """Return J of every body. Shape (bodies, 4, 4) from (10 bodies,) or (bodies, 10).

    Linear in the parameters: m, h, and xx, xy, yy, xz, yz, zz.
    """
    each = np.reshape(parameters, (-1, PER_LINK))
    out = np.zeros((len(each), ORDER, ORDER))
    half = each[:, [4, 6, 9]].sum(axis=1) / 2
    for k, (row, column) in enumerate(_TENSOR, start=4):
        out[:, row, column] = out[:, column, row] = -each[:, k]
    out[:, range(3), range(3)] += half[:, None]
    out[:, :3, 3] = out[:, 3, :3] = each[:, 1:4]
    out[:, 3, 3] = each[:, 0]
    return out


def _squares(scale: Array) -> Array:
    return scale[..., :, None] * scale[..., None, :]


def find_nearest_possible(bodies: BodySums, fitted: Array, root: Array) -> Array:
    """Return the coefficients nearest to the best with possible bodies.

    Args:
        fitted: x_0, unchanged if its bodies are possible. Shape (s,).
        root: U, upper triangular root of the precision: |U (x - x_0)|^2 is a distance
            in squared standard deviations. Shape (s, s).

    Raises:
        InputError: If the method does not converge.
    """
    across = solve_triangular(root, np.eye(len(fitted)))
    cones = _Cones.of(bodies, fitted, across)
    if cones.inside(np.zeros(len(fitted))):
        return fitted
    e = root @ (bodies.start - fitted)
    weight, count = cones.count / (1 + e @ e), cones.count
    while True:
        e = cones.centre(e, weight)
        if count / weight < GAP * (1 + e @ e):
            break
        weight *= GROWTH
    out = fitted + across @ e
    if bad := bodies.list_impossible(out):
        raise InputError(
            f"No possible bodies were found near the fit: {', '.join(bad)} stayed "
            "impossible. Check units and signs of the logs, and the robot's masses."
        )
    return out


@dataclass(frozen=True, eq=False, slots=True)
class _Cones:
    """Positivity constraints, affine in the deviations e: matrices and numbers."""

    # Of the matrices, flat, less ``LEAST`` of the unit matrix, (bodies, 16, s),
    # (bodies, 16).
    ways: Array
    at: Array
    # Of the numbers, (k, s), (k,).
    rows: Array
    values: Array

    @classmethod
    def of(cls, bodies: BodySums, best: Array, across: Array) -> "_Cones":
        flat = (len(bodies.names), ORDER**2)
        units = build_pseudo_inertias(np.eye(PER_LINK)).reshape(PER_LINK, -1).T
        sums = units @ bodies.sums / _squares(bodies.scale).reshape(*flat, 1)
        at = bodies.compute_pseudo_inertias(best) - LEAST * np.eye(ORDER)
        k = bodies.not_negative
        return cls(sums @ across, at.reshape(flat), across[k], best[k])

    @property
    def count(self) -> float:
        """Parameter of the barrier: the orders of all cones."""
        return float(ORDER * len(self.at) + len(self.values))

    def both(self, e: Array) -> tuple[Array, Array]:
        """Matrices and numbers at e. Shapes (bodies, 4, 4), (k,)."""
        matrices = (self.at + self.ways @ e).reshape(-1, ORDER, ORDER)
        return matrices, self.values + self.rows @ e

    def inside(self, e: Array) -> bool:
        """Whether all are positive at e."""
        matrices, numbers = self.both(e)
        return bool(np.linalg.eigvalsh(matrices).min() > 0 and np.all(numbers > 0))

    def centre(self, e: Array, weight: float) -> Array:
        """Minimise weight |e|^2 - sum log det - sum log, from e inside. Shape (s,).

        Newton's step solves a least squares problem, which avoids normal equations:
        with J^-1 = W W' the barrier's Hessian is S'S, S = (W (x) W)' J', and its
        gradient -S' vec(1).
        """
        unit, flat = np.sqrt(2 * weight) * np.eye(len(e)), np.eye(ORDER).ravel()
        wish = np.concatenate([np.tile(flat, len(self.at)), np.ones(len(self.values))])
        for _ in range(STEPS):
            matrices, numbers = self.both(e)
            half = np.linalg.inv(np.linalg.cholesky(matrices))
            lift = np.einsum("bij,bkl->bikjl", half, half)
            lift = lift.reshape(len(half), ORDER**2, ORDER**2)
            slope = np.concatenate([*(lift @ self.ways), self.rows / numbers[:, None]])
            q, upper = np.linalg.qr(np.concatenate([unit, slope]))
            right = q.T @ np.concatenate([-np.sqrt(2 * weight) * e, wish])
            step = solve_triangular(upper, right)
            decrement = float(np.sum((upper @ step) ** 2))
            if decrement < NEAR:
                return e
            # Damping for a self-concordant function; rounding may need more.
            length = 1.0 if decrement < CALM else 1 / (1 + np.sqrt(decrement))
            while not self.inside(e + length * step):
                length /= 2
                if length < LEAST:
                    return e
            e = e + length * step
        return e


def compute_link_eigenvalues(model: Model) -> Array:
    """Return the least eigenvalue of each scaled pseudo-inertia of links. (dof,)."""
    scale = compute_link_scales(model.robot)
    pseudo = build_pseudo_inertias(model.inertial)
    return np.linalg.eigvalsh(pseudo / _squares(scale))[:, 0]
