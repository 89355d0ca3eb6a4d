"""Rigid-body dynamics over whole recordings, joints and flange, and base parameters.

Pinocchio does the work of one sample; here are the loops. Its order of the inertial
parameters of a link is m, mx, my, mz, Ixx, Ixy, Iyy, Ixz, Iyz, Izz, about the link
frame.

Many directions of the 10 dof inertial parameters do not affect the torque: the regressor
has dependent columns. The independent ones, with the parts of the others expressed by
them, give the base parameters (Gautier 1990: numerical calculation by QR; G2017 eq. 6):

Y pi = Y_b theta_b,    theta_b = K pi,    Y_b = Y[:, columns],    K[:, columns] = 1
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from threading import Lock

import numpy as np
import pinocchio as pin
from cachetools import LRUCache, cached
from scipy.linalg import qr

from residual.recording import Array
from residual.robot.files import find_prismatic_joints
from residual.robot.robot import Robot
from residual.robot.urdf import ENDLESS

PER_LINK = 10
# A mass of exactly zero has no centre; this one changes no torque by more than 1e-5 N m.
_LEAST_MASS = 1e-6
AT_ONCE = 1 << 11  # rows of a regressor
LARGEST = 1 << 26  # bytes of a cached one: 40 000 rows for six joints
KEPT = 1 << 27  # bytes of all of them: thirteen minutes for six joints


def _over(shape: tuple[int, ...], solve: Callable, model: pin.Model, *motion) -> Array:
    """Return Pinocchio's result for each sample. (n, *shape)."""
    rows = [np.ascontiguousarray(x, dtype=float) for x in motion]
    data, out = model.createData(), np.empty((len(rows[0]), *shape))
    for i, sample in enumerate(zip(*rows, strict=True)):
        # Pinocchio gives a matrix of one column as a vector.
        out[i] = np.reshape(solve(model, data, *sample), shape)
    return out


def compute_inverse_dynamics(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the joint torques of the rigid body [N m]. Shape (n, dof).

    tau = M(q) qdd + C(q, qd) qd + g(q)    (paper eq. 3 without F)
    """
    return _over((model.nv,), pin.rnea, model, q, qd, qdd)


def compute_inertial_regressor(model: pin.Model, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the inertial regressor: inverse_dynamics = regressor @ parameters.

    In SI units, of the same motion. Shape (n, dof, 10 * dof).
    """
    shape = (model.nv, PER_LINK * model.nv)
    return _over(shape, pin.computeJointTorqueRegressor, model, q, qd, qdd)


def compute_robot_regressor(robot: Robot, q: Array, qd: Array, qdd: Array) -> Array:
    """Return the regressor without the weight that the drives do not carry."""
    out = compute_inertial_regressor(robot.model, q, qd, qdd)
    if (carried := robot.carried) is not None:
        still = np.zeros_like(q)
        weight = compute_inertial_regressor(robot.model, q, still, still)
        bodies = weight.reshape(*q.shape, robot.dof, PER_LINK)[..., :4]
        held = np.einsum("njbk,bkl->njbl", bodies, carried.shares)
        held *= carried.missing[:, None, None]
        out.reshape(*q.shape, robot.dof, PER_LINK)[..., :4] -= held
    return out


def compute_mass_matrix(model: pin.Model, q: Array) -> Array:
    """Return M(q) [kg m^2]. Shape (n, dof, dof)."""
    # Pinocchio fills only the upper half.
    upper = np.triu(_over((model.nv, model.nv), pin.crba, model, q))
    return upper + np.triu(upper, 1).transpose(0, 2, 1)


def compute_gravity_torque(model: pin.Model, q: Array, direction: Array) -> Array:
    """Return the torques that hold the arm in a field of gravity [N m]. (n, dof).

    Linear in the direction, in the base frame [m/s^2]; model.gravity.linear gives the
    g(q) of the model itself.
    """
    tilted = pin.Model(model)
    tilted.gravity.linear = np.asarray(direction, dtype=float)
    return _over((model.nv,), pin.computeGeneralizedGravity, tilted, q)


def compute_weight_torques(model: pin.Model, q: Array) -> Array:
    """Return the torques that hold the arm in fields of 1 m/s^2. Shape (n, dof, 3).

    Along x, y and z of the base; as `compute_gravity_torque`, which is linear in them.
    """
    mass = sum(body.mass for body in list(model.inertias)[1:])
    jacobian = _over((3, model.nv), pin.jacobianCenterOfMass, model, q)
    return -mass * jacobian.transpose(0, 2, 1)


def compute_flange_jacobian(model: pin.Model, q: Array) -> Array:
    """Return the Jacobian of the flange, the last frame of the arm. Shape (n, 6, dof).

    Rows are linear [m] then angular velocity of the flange per joint speed, along the
    axes of the base frame.
    """
    where = find_flange_frame(model), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

    def jacobian(*sample) -> Array:
        return pin.computeFrameJacobian(*sample, *where)

    return _over((6, model.nv), jacobian, model, q)


def find_flange_frame(model: pin.Model) -> int:
    """Return the index of the flange: the last frame that the last joint moves.

    `load_robot` appends one if links behind locked joints, or behind --tip, follow.
    """
    frames = [i for i, f in enumerate(model.frames) if f.parentJoint == model.nv]
    return frames[-1]


def find_flange_placement(model: pin.Model) -> pin.SE3:
    """Return the placement of the flange in the frame of the last joint."""
    return model.frames[find_flange_frame(model)].placement


def find_flange_axis(model: pin.Model) -> Array:
    """Return the axis of the last joint in the flange frame, pointing away. (3,).

    Away is the side of the flange seen from the last joint, else of its link's mass.
    """
    last = model.njoints - 1
    axis = find_joint_axis(model, last)
    flange = find_flange_placement(model)
    for direction in (flange.translation, model.inertias[last].lever):
        along = float(direction @ axis)
        if abs(along) > 1e-6:
            axis = np.sign(along) * axis
            break
    return flange.rotation.T @ axis


def find_joint_axis(model: pin.Model, joint: int) -> Array:
    """Return the axis that a joint turns about or slides along, in its frame. (3,)."""
    data, zero = model.createData(), pin.neutral(model)
    jacobian = np.reshape(pin.computeJointJacobian(model, data, zero, joint), (6, -1))
    column = jacobian[:, joint - 1]
    return column[3:] if column[3:].any() else column[:3]


def compute_last_joint_distance(model: pin.Model) -> float:
    """Return the length of the path from the base over all joints to the last one [m].

    A sliding joint adds its travel.
    """
    end = np.maximum(np.abs(model.lowerPositionLimit), np.abs(model.upperPositionLimit))
    slides = np.array(find_prismatic_joints(model), dtype=bool) & (end < float(ENDLESS))
    way = sum(np.linalg.norm(p.translation) for p in model.jointPlacements)
    return float(way + end[slides].sum())


def compute_reach(model: pin.Model) -> float:
    """Return the length of the path from the base over all joints to the flange [m].

    For an arm of one joint without a flange it is the lever of its mass.
    """
    way = compute_last_joint_distance(model)
    way += float(np.linalg.norm(find_flange_placement(model).translation))
    return way or float(np.linalg.norm(model.inertias[model.nv].lever))


def read_inertial_parameters(model: pin.Model) -> Array:
    """Return the ten parameters of every moving body, in SI units. (10 * dof,)."""
    bodies = list(model.inertias)[1:]
    return np.concatenate([body.toDynamicParameters() for body in bodies])


def replace_inertial_parameters(model: pin.Model, parameters: Array) -> pin.Model:
    """Return a copy of the model with other inertial parameters.

    Ten per moving body, in SI units. Impossible values (negative mass or inertia) are
    accepted.
    """
    changed = pin.Model(model)
    for i, body in enumerate(np.reshape(parameters, (-1, PER_LINK)), start=1):
        body = np.array(body, dtype=float)
        if abs(body[0]) < _LEAST_MASS:
            body[0] = _LEAST_MASS
        changed.inertias[i] = pin.Inertia.FromDynamicParameters(body)
    return changed


@dataclass(frozen=True, eq=False, slots=True)
class KinematicChain:
    """Kinematics of a serial arm of joints that turn or slide."""

    rotation: Array  # frame of each joint in the one before, at angle zero, (dof, 3, 3)
    place: Array  # its origin in the one before [m], (dof, 3)
    axis: Array  # unit vector that it turns about or slides along, its frame, (dof, 3)
    slides: Array  # whether it slides, (dof,)
    flange: Array  # origin of the flange in the frame of the last joint [m], (3,)
    flange_rotation: Array  # its axes in that frame, (3, 3)

    def compute_joint_origins(self, q: Array) -> Array:
        """Return the origins of base, joints and flange in the base frame [m].

        For all postures (n, dof) at once; one axis after the other, by Rodrigues' formula.
        Shape (n, dof + 2, 3).
        """
        n, dof = q.shape
        out, turned = np.zeros((n, dof + 2, 3)), np.broadcast_to(np.eye(3), (n, 3, 3))
        for j in range(dof):
            out[:, j + 1] = out[:, j] + turned @ self.place[j]
            if self.slides[j]:
                along = self.rotation[j] @ self.axis[j]
                out[:, j + 1] += q[:, j, None] * (turned @ along)
                turned = turned @ self.rotation[j]
                continue
            about = np.cross(self.axis[j], np.eye(3)).T  # v -> axis x v
            angle = q[:, j, None, None]
            turn = np.eye(3) + np.sin(angle) * about
            turn = turn + (1 - np.cos(angle)) * (about @ about)
            turned = turned @ (self.rotation[j] @ turn)
        out[:, -1] = out[:, -2] + turned @ self.flange
        return out


def build_kinematic_chain(model: pin.Model) -> KinematicChain:
    """Return the kinematics of a Pinocchio model."""
    axes = [find_joint_axis(model, i) for i in range(1, model.njoints)]
    placements = list(model.jointPlacements)[1:]
    flange = find_flange_placement(model)
    return KinematicChain(
        np.array([p.rotation for p in placements]),
        np.array([p.translation for p in placements]),
        np.array(axes),
        np.array(find_prismatic_joints(model)),
        np.array(flange.translation),
        np.array(flange.rotation),
    )


@dataclass(frozen=True, eq=False, slots=True)
class LazyRegressor:
    """An inertial regressor computed on demand.

    It has 360 numbers a row for six joints. The last ones are cached, since many
    functions use the same motion, link by link: no link loads a joint beyond it, so that
    210 are enough. If one is too large for the cache, only the requested part is
    computed.
    """

    robot: Robot  # the arm; without `carried` all of its weight counts
    motion: tuple[Array, Array, Array]  # q, qd and qdd [rad, rad/s, rad/s^2], (n, dof)

    def __array__(self, dtype=None, copy=None) -> Array:
        n, dof = self.motion[0].shape
        out = np.zeros((n, dof, PER_LINK * dof))
        for i, block in enumerate(self.links()):
            out[:, : i + 1, PER_LINK * i : PER_LINK * (i + 1)] = block
        return out

    def __getitem__(self, key) -> Array:
        """A part of it: rows, or columns of all rows as [:, :, columns]."""
        if isinstance(key, slice):
            motion = (x[key] for x in self.motion)
            return compute_robot_regressor(self.robot, *motion)
        dof = self.motion[0].shape[1]
        if isinstance(key[2], slice):
            first, stop, step = key[2].indices(PER_LINK * dof)
            i, start = divmod(first, PER_LINK)
            if step == 1 and stop <= PER_LINK * (i + 1):
                out = np.zeros((*self.motion[0].shape, PER_LINK))
                out[:, : i + 1] = self.links()[i]
                return out[key[0], key[1], start : start + stop - first]
        return np.asarray(self)[key]

    def __matmul__(self, parameters: Array) -> Array:
        """Torque of these inertial parameters [N m]. Shape (n, dof).

        If it is not cached, by the recursive algorithm, in a third of the time.
        """
        if not self._small and self.robot.carried is None:
            body = replace_inertial_parameters(self.robot.model, parameters)
            return compute_inverse_dynamics(body, *self.motion)
        out = np.zeros(self.motion[0].shape)
        for i, block in enumerate(self.links()):
            part = parameters[PER_LINK * i : PER_LINK * (i + 1)]
            out[:, : i + 1] += (block.reshape(-1, PER_LINK) @ part).reshape(-1, i + 1)
        return out

    def links(self) -> tuple[Array, ...]:
        """Columns of each link on the joints that carry it. Shapes (n, i + 1, 10)."""
        return _kept_links(self) if self._small else self._by_link()

    @property
    def _small(self) -> bool:
        """Whether all of it is small enough for the cache."""
        n, dof = self.motion[0].shape
        return 8 * PER_LINK * n * dof * (dof + 1) // 2 <= LARGEST

    def _by_link(self) -> tuple[Array, ...]:
        n, dof = self.motion[0].shape
        out = tuple(np.empty((n, i + 1, PER_LINK)) for i in range(dof))
        for start in range(0, n, AT_ONCE):
            rows = slice(start, start + AT_ONCE)
            dense = self[rows]
            for i, block in enumerate(out):
                part = slice(PER_LINK * i, PER_LINK * (i + 1))
                block[rows] = dense[:, : i + 1, part]
        return out


def build_motion_key(robot: Robot, *motion: Array) -> tuple:
    """Return the cache key of a motion: its values."""
    return robot, *(x.tobytes() for x in motion)


@cached(
    LRUCache(KEPT, getsizeof=lambda blocks: sum(x.nbytes for x in blocks)),
    key=lambda lazy: build_motion_key(lazy.robot, *lazy.motion),
    lock=Lock(),
)
def _kept_links(lazy: LazyRegressor) -> tuple[Array, ...]:
    return lazy._by_link()


def split_regressor_by_link(regressor: Array | LazyRegressor, dof: int) -> Iterator[Array]:
    """Columns of each link on the joints that carry it. Shapes (n, i + 1, 10)."""
    if isinstance(regressor, LazyRegressor):
        yield from regressor.links()
    else:
        for i in range(dof):
            yield regressor[:, : i + 1, PER_LINK * i : PER_LINK * (i + 1)]


STATES = 200  # random states for choosing independent columns
_TOLERANCE = 1e-8
# Of the largest pivot: the last true one of an arm is above 0.1, and rounded angles in a
# URDF (1.5708) give false ones near 1e-4, which no motion could excite.
_INDEPENDENT = 1e-3
_SILENT = 1e-4  # of the largest column: limit of the effect of rounded angles
_ROUNDING = 1e-6  # of a column's length: remainder due to rounded angles of a URDF
_NOTHING = 1e-12  # of a column's length: a smaller share counts as zero
_WORST = 1e3  # condition number up to which readable columns are used
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
class StandardParameter:
    """One parameter of the full, redundant description."""

    name: str  # in words: "mass of link 3", "coulomb level of joint 2"
    unit: str  # SI unit, empty if unknown
    joint: int  # its joint, from 1


@dataclass(frozen=True, eq=False, slots=True)
class BaseParameters:
    """Base parameters and their composition of the standard ones."""

    standard: tuple[StandardParameter, ...]  # the s standard parameters, in order
    columns: Array  # standard parameters that lead a base parameter, increasing, (b,)
    mapping: Array  # K, base from standard parameters; 1 at the leading one, (b, s)
    # Smallest nonzero over largest zero singular value of the column-normalised
    # regressor: far above 1 if the rank is certain.
    gap: float

    def __post_init__(self) -> None:
        for array in (self.columns, self.mapping):
            array.setflags(write=False)

    def __len__(self) -> int:
        return len(self.columns)

    @property
    def leading(self) -> tuple[StandardParameter, ...]:
        """The leading standard parameter of each base parameter."""
        return tuple(self.standard[c] for c in self.columns)

    def words(self, i: int) -> str:
        """Base parameter i as a sum: "J2: mass of link 2 + 0.36 x ..."."""
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

    def expand_to_standard(self, theta: Array, nominal: Array, covariance: Array) -> Array:
        """Standard parameters with given base parameters, nearest to the nominal.

        pi = pi_0 + S K' (K S K')^-1 (theta_b - K pi_0): of all with the same torque, the
        most likely ones under the covariance S of nominal values. (s,).
        """
        across = self.mapping @ covariance
        inner = across @ self.mapping.T
        size = np.sqrt(np.diag(inner))
        gap = (theta - self.mapping @ nominal) / size
        weight = np.linalg.solve(inner / np.outer(size, size), gap)
        return nominal + (across.T / size) @ weight


def find_independent_columns(model: pin.Model) -> Array:
    """Return linearly independent columns of the regressor.

    QR with column pivoting over random states, columns normalized to length one; the
    other columns are combinations of these.

    Returns:
        Indices into the 10 * dof inertial parameters, increasing. Shape (b,).
    """
    factors = qr(_scaled(_draw_rows(model), _SILENT), mode="r", pivoting=True)
    pivots, order = np.abs(np.diag(np.asarray(factors[0]))), np.asarray(factors[-1])
    return np.sort(order[: int((pivots > _INDEPENDENT * pivots[0]).sum())])


def draw_random_states(model: pin.Model) -> Array:
    """Return q, qd and qdd of random states. Shape (3, STATES, dof).

    Linear dependence of the columns is a property of the arm: any states show it.
    """
    return np.random.default_rng(0).uniform(-3, 3, (3, STATES, model.nv))


def _draw_rows(model: pin.Model) -> Array:
    """Return the rows of the inertial regressor on those states. (STATES dof, 10 dof)."""
    rows = compute_inertial_regressor(model, *draw_random_states(model))
    return rows.reshape(STATES * model.nv, -1)


def list_inertial_parameters(dof: int) -> tuple[StandardParameter, ...]:
    """Return the inertial parameters of every link, in Pinocchio's order."""
    return tuple(
        StandardParameter(f"{name} of link {link}", unit, link)
        for link in range(1, dof + 1)
        for name, unit in _KINDS
    )


def compute_base_parameters(model: pin.Model) -> BaseParameters:
    """Return the base parameters of the rigid body.

    The rank follows from the singular values, and columns are chosen in a readable
    order: inertias, then moments, then masses, each from the base on. A URDF with rounded
    angles (1.5708 for a right angle) has columns that differ by rounding only; they count
    as one.
    """
    rows = _draw_rows(model)
    links = range(model.nv)
    order = [PER_LINK * link + kind for kind in _ORDER for link in links]
    columns = np.sort(extend_independent_columns(rows, np.zeros(0, dtype=int), order))
    scaled = _scaled(rows)
    values = np.linalg.svd(scaled, compute_uv=False)
    rank = int((values > _ROUNDING * values[0]).sum())
    if len(columns) != rank or np.linalg.cond(scaled[:, columns]) >= _WORST:
        # Columns in a fixed order may be nearly dependent; pivoting avoids that.
        pivoted = np.asarray(qr(scaled, mode="r", pivoting=True)[-1])
        columns = np.sort(pivoted[:rank])
    return reduce_to_base_parameters(rows, columns, list_inertial_parameters(model.nv))


def reduce_to_base_parameters(
    rows: Array, independent: Array, standard: Sequence[StandardParameter]
) -> BaseParameters:
    """Express all columns of a regressor by the independent ones.

    Rows are on varied states, the chosen columns independent.
    Shapes (rows, s), (b,).
    """
    size = np.linalg.norm(rows, axis=0)
    scaled = _scaled(rows)
    kept, _, _, _ = np.linalg.lstsq(scaled[:, independent], scaled, rcond=None)
    kept[np.abs(kept) < _NOTHING] = 0.0
    kept[:, independent] = np.eye(len(independent))
    mapping = kept * size / size[independent, None]
    values, rank = np.linalg.svd(scaled, compute_uv=False), len(independent)
    gap = float("inf")
    if rank < len(values):
        gap = float(values[rank - 1] / max(values[rank], 1e-300))
    return BaseParameters(tuple(standard), np.array(independent), mapping, gap)


def extend_independent_columns(rows: Array, independent: Array, candidates: Sequence[int]) -> Array:
    """Extend independent columns by candidates that are not combinations of them.

    Rows are of the regressor on varied states; then the chosen columns, and those to try,
    in order. Shapes (rows, s), (b,) to (b + more,).
    """
    size = np.linalg.norm(rows, axis=0)
    basis = np.linalg.qr(rows[:, independent] / size[independent])[0]
    kept = list(independent)
    for k in candidates:
        if size[k] <= _TOLERANCE * size.max():
            continue
        new = rows[:, k] / size[k]
        for _ in range(2):  # a second pass removes rounding
            new = new - basis @ (basis.T @ new)
        length = np.linalg.norm(new)
        if length > _ROUNDING:
            kept.append(k)
            basis = np.column_stack([basis, new / length])
    return np.array(kept, dtype=int)


def _scaled(rows: Array, least: float = _TOLERANCE) -> Array:
    """Return columns normalized to length one; very short ones become 0."""
    size = np.linalg.norm(rows, axis=0)
    return rows / np.where(size > least * size.max(), size, np.inf)
