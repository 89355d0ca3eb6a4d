"""Base parameters: what a motion of the arm can tell about its inertia at all.

The 10 dof inertial parameters of an arm move no torque by themselves in many
directions: the regressor has dependent columns. Those that are kept, each with what it
takes over of the others, are the base parameters (Gautier 1990: numerical calculation
by QR; G2017 eq. 6):

Y pi = Y_b theta_b,    theta_b = K pi,    Y_b = Y[:, columns],    K[:, columns] = 1
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import qr

from residual.recording import Array
from residual.robot.dynamics import PER_LINK, regressor

STATES = 200  # random states that decide which columns are independent
_TOLERANCE = 1e-8
# Of the largest pivot: the last true one of an arm is above 0.1, and angles that a URDF
# rounds (1.5708) make false ones near 1e-4, which no motion could excite.
_INDEPENDENT = 1e-3
_SILENT = 1e-4  # of the largest column: no more than rounded angles make
_ROUNDING = 1e-6  # of a column's length: what rounded angles of a URDF may leave
_NOTHING = 1e-12  # of a column's length: a share smaller than this is none
_WORST = 1e3  # condition number up to which readable columns will do
# Inertias on the diagonal, products, moments, mass.
_ORDER = (4, 6, 9, 5, 7, 8, 1, 2, 3, 0)
_KINDS = (
    ("mass", "kg"),
    ("moment mx", "kg m"),
    ("moment my", "kg m"),
    ("moment mz", "kg m"),
    ("inertia Ixx", "kg m^2"),
    ("inertia Ixy", "kg m^2"),
    ("inertia Iyy", "kg m^2"),
    ("inertia Ixz", "kg m^2"),
    ("inertia Iyz", "kg m^2"),
    ("inertia Izz", "kg m^2"),
)


@dataclass(frozen=True, slots=True)
class Standard:
    """One parameter of the full, redundant description."""

    name: str  # in words: "mass of link 3", "coulomb level of joint 2"
    unit: str  # SI unit, empty where it is not known
    joint: int  # joint it belongs to, from 1


@dataclass(frozen=True, eq=False, slots=True)
class BaseParameters:
    """Base parameters and how they are made of the standard ones."""

    standard: tuple[Standard, ...]  # the s standard parameters, in order
    columns: Array  # standard parameters that lead a base parameter, increasing, (b,)
    mapping: Array  # k, base from standard parameters; 1 at the leading one, (b, s)
    # Smallest singular value that counts over the largest that does not, of the column-
    # normalised regressor: far above 1 where the rank is certain.
    gap: float

    def __post_init__(self) -> None:
        for array in (self.columns, self.mapping):
            array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.columns)

    @property
    def leading(self) -> tuple[Standard, ...]:
        """The leading standard parameter of each base parameter."""
        return tuple(self.standard[c] for c in self.columns)

    def words(self, i: int) -> str:
        """Base parameter i as the sum it is: "J2: mass of link 2 + 0.36 x ..."."""
        lead = self.columns[i]
        text = f"J{self.standard[lead].joint}: {self.standard[lead].name}"
        size = np.abs(self.mapping[i])
        # A smaller share is rounding of the URDF.
        for k in np.flatnonzero(size > _ROUNDING * max(size.max(), 1.0)):
            if k == lead:
                continue
            share = self.mapping[i, k]
            sign = "-" if share < 0 else "+"
            factor = "" if abs(abs(share) - 1) < 1e-9 else f"{abs(share):.4g} x "
            text += f" {sign} {factor}{self.standard[k].name}"
        return text

    def embed(self, theta: Array, nominal: Array, covariance: Array) -> Array:
        """Standard parameters that have these base parameters, nearest to the nominal.

        pi = pi_0 + S K' (K S K')^-1 (theta_b - K pi_0): of all that move the same
        torque, those that the covariance S of nominal values makes most likely. (s,).
        """
        across = self.mapping @ covariance
        inner = across @ self.mapping.T
        size = np.sqrt(np.diag(inner))
        gap = (theta - self.mapping @ nominal) / size
        return nominal + (across.T / size) @ np.linalg.solve(
            inner / np.outer(size, size), gap
        )


def base_columns(model: pin.Model) -> Array:
    """Return the columns of the regressor that no other columns add up to.

    QR with column pivoting over random states, columns at length one; what the other
    columns would have told goes to these.

    Returns:
        Indices into the 10 * dof inertial parameters, increasing. Shape (b,).
    """
    rows = regressor(model, *random_states(model)).reshape(STATES * model.nv, -1)
    factors = qr(_scaled(rows, _SILENT), mode="r", pivoting=True)
    pivots, order = np.abs(np.diag(np.asarray(factors[0]))), np.asarray(factors[-1])
    return np.sort(order[: int((pivots > _INDEPENDENT * pivots[0]).sum())])


def random_states(model: pin.Model) -> Array:
    """Return q, qd and qdd of the states that decide. Shape (3, STATES, dof).

    Which columns depend on which is a property of the arm: any states tell it.
    """
    return np.random.default_rng(0).uniform(-3, 3, (3, STATES, model.nv))


def standard_inertial(dof: int) -> tuple[Standard, ...]:
    """Return the inertial parameters of every link, in Pinocchio's order."""
    return tuple(
        Standard(f"{name} of link {link}", unit, link)
        for link in range(1, dof + 1)
        for name, unit in _KINDS
    )


def base_parameters(model: pin.Model) -> BaseParameters:
    """Return the base parameters of the rigid body.

    The rank is read from the singular values, and columns are kept in an order that
    people can follow: inertias, then moments, then masses, each from the base on. A
    URDF whose angles were rounded (1.5708 for a right angle) has columns that differ
    by rounding alone; they count as one.
    """
    rows = regressor(model, *random_states(model)).reshape(STATES * model.nv, -1)
    links = range(model.nv)
    order = [PER_LINK * link + kind for kind in _ORDER for link in links]
    columns = np.sort(further_columns(rows, np.zeros(0, dtype=int), order))
    scaled = _scaled(rows)
    values = np.linalg.svd(scaled, compute_uv=False)
    rank = int((values > _ROUNDING * values[0]).sum())
    if len(columns) != rank or np.linalg.cond(scaled[:, columns]) >= _WORST:
        # Columns in a fixed order may lean on one another; pivoting never lets them.
        pivoted = np.asarray(qr(scaled, mode="r", pivoting=True)[-1])
        columns = np.sort(pivoted[:rank])
    return express(rows, columns, standard_inertial(model.nv))


def express(
    rows: Array, columns: Array, standard: Sequence[Standard]
) -> BaseParameters:
    """Write all columns of a regressor as sums of those that are kept.

    Rows are on states of every kind, the columns independent of one another.
    Shapes (rows, s), (b,).
    """
    size = np.linalg.norm(rows, axis=0)
    scaled = _scaled(rows)
    kept, _, _, _ = np.linalg.lstsq(scaled[:, columns], scaled, rcond=None)
    kept[np.abs(kept) < _NOTHING] = 0.0
    kept[:, columns] = np.eye(len(columns))
    mapping = kept * size / size[columns, None]
    values, rank = np.linalg.svd(scaled, compute_uv=False), len(columns)
    gap = float("inf")
    if rank < len(values):
        gap = float(values[rank - 1] / max(values[rank], 1e-300))
    return BaseParameters(tuple(standard), np.array(columns), mapping, gap)


def further_columns(rows: Array, columns: Array, candidates: Sequence[int]) -> Array:
    """Return those kept, and the candidates that are no sum of them, one by one.

    Rows are of the regressor on states of every kind, columns kept already, and those
    to try, in order. Shapes (rows, s), (b,) to (b + more,).
    """
    size = np.linalg.norm(rows, axis=0)
    basis = np.linalg.qr(rows[:, columns] / size[columns])[0]
    kept = list(columns)
    for k in candidates:
        if size[k] <= _TOLERANCE * size.max():
            continue
        new = rows[:, k] / size[k]
        for _ in range(2):  # once more takes away what rounding left
            new = new - basis @ (basis.T @ new)
        length = np.linalg.norm(new)
        if length > _ROUNDING:
            kept.append(k)
            basis = np.column_stack([basis, new / length])
    return np.array(kept, dtype=int)


def _scaled(rows: Array, least: float = _TOLERANCE) -> Array:
    """Return columns at length one; shorter ones than a share of the longest at 0."""
    size = np.linalg.norm(rows, axis=0)
    return rows / np.where(size > least * size.max(), size, np.inf)
