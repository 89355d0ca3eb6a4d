"""What an effect is: data and one pure function from motion to torque columns.

A new effect is one new file in this folder with a module-level ``EFFECT``; the
registry is the folder listing.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from cachetools import LRUCache, cached

from residual.quantity import along
from residual.recording import Array
from residual.robot.dynamics import LazyRegressor, motion_key, with_inertial_parameters
from residual.robot.robot import Robot
from residual.signals.filters import low_pass

Property = Literal[
    "damping", "quadratic_damping", "friction", "armature", "stiffness", "constant"
]
BRISTLE, EARLIER = 3, 258  # numbers that each of the two has to keep in its memory


@dataclass(frozen=True, eq=False, slots=True)
class Portable:
    """What of an effect other programs can be told; nothing where all is empty.

    A formula is an expression of C. It may use of the joint it acts on ``q``, ``qd``,
    ``qdd``, ``sign``, ``rigid`` and ``tau`` (see ``State``), the session time ``t``,
    the coefficients ``a[i]``, the numbers of the shape ``s[i]``, and ``sin``, ``cos``,
    ``tanh``, ``exp``, ``pow``, ``fabs``, ``fmin``, ``fmax``, ``sgn``. With
    ``m``, the effect's own memory, there are ``bristle(m, q, way)`` and ``earlier(m, t,
    tau, by)``. Of a pair of joints the six names are arrays of two.

    Attributes:
        formula: Torque [N m], one expression per joint that the effect acts on; a
            single one stands for all.
        shift: By how much the angle of the joint is another than the encoder says
            [rad], and the first and second derivative of that.
        memory: How many numbers the formula keeps from sample to sample.
        joint: What each coefficient is as a property of a simulated joint: torque per
            "damping" qd, "quadratic_damping" qd |qd|, "friction" sign(qd), "armature"
            qdd, "stiffness" q, or "constant".
        bodies: (theta, joints, robot) -> inertial parameters that it adds (10 dof,).
        gravity: (theta, robot) -> acceleration that it adds to gravity [m/s^2] (3,).
        force: (theta,) -> force on the flange, in the base frame [N] (3,).
        possible: (theta, shape) -> whether the formula holds for these numbers.
        why_not: Why no formula can say it; empty where there is one.
    """

    formula: tuple[str, ...] = ()
    shift: tuple[str, str, str] | None = None
    memory: int = 0
    joint: tuple[Property, ...] = ()
    bodies: Callable[[Array, tuple[int, ...], Any], Array] | None = None
    gravity: Callable[[Array, Any], Array] | None = None
    force: Callable[[Array], Array] | None = None
    possible: Callable[[Array, tuple[float, ...]], bool] = lambda theta, shape: True
    why_not: str = ""


def formula(*rows: str, joint: tuple[Property, ...] = (), memory: int = 0) -> Portable:
    """An effect that its torque says, and what its coefficients are to a joint."""
    return Portable(formula=rows, joint=joint, memory=memory)


NOWHERE = Portable(why_not="its file does not say it")


Joints = tuple[int, ...]
Shape = tuple[float, ...]


class Placed(NamedTuple):
    """An effect on joints (from 0), with the shape that a search tries."""

    effect: "Effect"
    joints: Joints
    shape: Shape


Scope = Literal["local", "pair", "link", "flange", "global"]
Carried = Literal["", "body", "speed", "acceleration"]


@dataclass(frozen=True, eq=False, slots=True)
class State:
    """What an effect may look at on one log: motion and the model's own torque.

    Attributes:
        robot: The arm.
        rate: Sample rate [Hz].
        t: Session time [s]. Shape (n,).
        q, qd, qdd: Kinematics [rad, rad/s, rad/s^2]. Shape (n, dof).
        sign: Direction of motion, smoothed where the joint stands. Shape (n, dof).
        regressor: Inertial regressor, made when it is read. Shape (n, dof, 10 dof).
        rigid: Rigid-body torque of the current model [N m]. Shape (n, dof).
        tau_model: Torque of the current model [N m]. Shape (n, dof).
        inertial: Inertial parameters of the current model, loads included [SI]; None
            for those of the robot's own description. Shape (10 dof,).
        drive: Torque that the drives themselves take per speed [N m s/rad] and per
            acceleration [kg m^2]; None for none. Shape (2, dof).
    """

    robot: Robot
    rate: float
    t: Array
    q: Array
    qd: Array
    qdd: Array
    sign: Array
    regressor: Array | LazyRegressor
    rigid: Array
    tau_model: Array
    inertial: Array | None = None
    drive: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class Span:
    """How far one set of logs moves each joint: what decides which shapes to try.

    Attributes:
        speed: 95 % quantile of |qd| [rad/s]. Shape (dof,).
        travel: Range of q [rad]. Shape (dof,).
        duration: Session time covered, or 0 where the clock is not known [s].
        cutoff: Identification cut-off [Hz].
        torque: Largest size of the logged torque, as a 99.5 % quantile [N m]; None
            where it is not known. Shape (dof,).
        prismatic: Which joints slide; () for none.
    """

    speed: Array
    travel: Array
    duration: float
    cutoff: float
    torque: Array | None = None
    prismatic: tuple[bool, ...] = ()


@dataclass(frozen=True, eq=False, slots=True)
class Limits:
    """What an arm can do where an effect sits; of the whole arm the largest.

    Attributes:
        torque: Largest torque of the joint, by its limit or as it was logged [N m].
        lower, upper: Ends of its range [rad].
        speed: Speed that it was seen at, a 95 % quantile [rad/s].
        weight: Mass of the arm [kg].
        reach: Length of the arm when it is stretched [m].
        had: Coefficients of the same effect that the model has, as refitted; zero where
            it has none. Shape (k,).
    """

    torque: float
    lower: float
    upper: float
    speed: float
    weight: float
    reach: float
    had: Array


Columns = Callable[[State, Joints, Shape], Array]


@dataclass(frozen=True, slots=True)
class Refinement:
    """How the first number of a shape is searched between the grid points.

    Attributes:
        step: "ratio" (multiply) or "shift" (add).
        reach: Half-width of the search, as log-ratio or in units of the shape.
        lower, upper: Limits of the number.
        sliding: The half-width on a joint that slides; 0 for the same.
    """

    step: Literal["ratio", "shift"]
    reach: float
    lower: float = 1e-9
    upper: float = np.inf
    sliding: float = 0.0

    def half_width(self, joints: Joints, robot: Robot) -> float:
        """Return the reach on some joints (from 0)."""
        slides = any(robot.prismatic[j] for j in joints)
        return (slides and self.sliding) or self.reach


def _no_shape(span: Span, joint: int) -> tuple[Shape, ...]:
    return ((),)


def _nowhere(span: Span, joint: int) -> tuple[Shape, ...]:
    return ()


@dataclass(frozen=True, eq=False, slots=True)
class Effect:
    """One physical effect that a model may lack.

    Attributes:
        name: Its name, that of its file.
        sentence: What it is, in words, for a control engineer.
        parameters: Parameter keys with their SI units on a joint that turns, in order.
        sliding: Units on a joint that slides, of those that are not by
            `residual.quantity.along` what they are on one that turns.
        needs_turn: It needs an angle: no joint that slides has it.
        columns: Torque columns: (state, joints, shape) -> (n, rows, k), where the
            rows are the joints it acts on: its own, or all of them.
        equation: Its torque [N m] by its parameters, as a line of text; empty for what
            ``portable`` has. "d tau" is a change of the reported torque.
        noun: What a sentence calls it ("a spring"); empty for its name in words.
        place: Where a sentence puts it, by its ``{joints}`` or ``{links}`` in words.
        scope: Which joints it belongs to.
        values: (theta, shape, robot) -> one value per parameter key; usually the
            coefficients and then the shape.
        from_values: (values, robot) -> (theta, shape): the way back.
        shapes: Values of the nonlinear parameters to start from.
        refine: How the first nonlinear parameter is searched; None where linear.
        is_parameter: It says that a parameter the model has is wrong.
        in_every_model: No model is without that parameter, declared or not.
        usual_in_every_drive: Its place, from 1, in the list of what every drive has and
            a model is taken to have where nobody says otherwise; 0 for none.
        is_constant: Its torque is the same on every row.
        carries: What its coefficients are a part of, besides the torque of its columns:
            the inertial parameters of the last body ("body"), the drive's torque per
            "speed" or per "acceleration"; empty for nothing.
        repeats: It is one wave of many over the position, its coefficients cos and sin.
            A joint may have several, and many of them can draw any curve.
        needs_known_body: It changes a body: not blamed where these are hardly known.
        brakes: It is friction: it takes power from the motion of its joint.
        not_negative: Its coefficients cannot be negative in any real arm.
        of_one_variable: Its torque is a function of its ``variable`` and nothing else.
        needs_clock: It needs the order of the logs in time.
        uses_model: Its columns depend on the model's own torque.
        remembers: Its columns depend on more than the sample: on its neighbours, or on
            the motion before it.
        of_report: It distorts the report of the torque, not the torque: its columns
            are made of a torque that is without it.
        prior_sd: (robot,) -> prior of theta where the size is known from physics;
            None for the default, 30 % of torque.
        possible: (theta, shape, limits) -> whether an arm can have it so, by sign and
            size; what comes out otherwise (a gear that twists the wrong way) imitates
            something else. Every effect of the vocabulary has one of its own.
        reports: (key, values, stds) -> whether to report a parameter; None for always.
        combined: (theta, robot) -> what motion may determine where it does not tell the
            single parameters, by formula: value, unit. Linear in theta; None for none.
        usual: (states, joints) -> coefficients of an effect of size one, in the ways
            that it usually comes; None where the first alone or a plain vector says it.
        far_fetched: Of two that explain the same the one with less is named first.
        inexact: By how much, of its size, values differ that other authors' forms of
            it lead to where logs see only a part of its range: one standard deviation.
        if_refuted: What to ask the user where held-out logs refute it.
        family: Effects of one family on one joint exclude each other.
        rides_on: The effect that its torque is told on top of (`diagnosis.findings`).
        outermost: How many of the last joints it is not tried on.
        groupable: It is also tried on all joints at once.
        in_any_arm: (span, joint) -> shapes in which every arm in use has a little.
        least_seen: Shapes, SI, in which arms have it and logs show it less than in its
            usual one, as what lives nearer to standstill than rows count: the smallest
            size is the middle of theirs. None where its usual shape says it.
        variable: (state, joint) -> what the report draws it against, with label; None
            where no one variable explains it, as with all that has inertia: then what
            was measured of it is drawn against what it explains, joint by joint.
        portable: How it is said in other programs.
        frame: What its vectors are in, in words; ``{flange}`` is the URDF's name of it.
        told: (values) -> the same as people say them, value and unit by name, such as
            amplitude and angle; None where the parameters themselves do.
    """

    name: str
    sentence: str
    parameters: Mapping[str, str]
    columns: Columns
    equation: str = ""
    noun: str = ""
    place: str = "on {joints}"
    sliding: Mapping[str, str] = field(default_factory=dict)
    needs_turn: bool = False
    scope: Scope = "local"
    values: Callable[[Array, Shape, Robot], Array] = lambda theta, shape, robot: (
        np.array([*theta, *shape])
    )
    from_values: Callable[[Array, Robot], tuple[Array, Shape]] = lambda values, robot: (
        values,
        (),
    )
    shapes: Callable[[Span, int], Sequence[Shape]] = _no_shape
    refine: Refinement | None = None
    is_parameter: bool = False
    in_every_model: bool = False
    usual_in_every_drive: int = 0
    is_constant: bool = False
    carries: Carried = ""
    repeats: bool = False
    needs_known_body: bool = False
    brakes: bool = False
    not_negative: bool = False
    of_one_variable: bool = False
    needs_clock: bool = False
    uses_model: bool = False
    remembers: bool = False
    of_report: bool = False
    prior_sd: Callable[[Robot], Array] | None = None
    possible: Callable[[Array, Shape, Limits], bool] = lambda theta, shape, limits: True
    reports: Callable[[str, Array, Array], bool] | None = None
    combined: Callable[[Array, Robot], Mapping[str, tuple[float, str]]] | None = None
    usual: Callable[[Sequence[State], Joints], Sequence[Array]] | None = None
    far_fetched: float = 0.0
    inexact: float = 0.0
    if_refuted: str = ""
    family: str = ""
    rides_on: str = ""
    outermost: int = 0
    groupable: bool = False
    in_any_arm: Callable[[Span, int], Sequence[Shape]] = _nowhere
    least_seen: tuple[Shape, ...] = ()
    variable: Callable[[State, int], tuple[Array, str]] | None = lambda state, j: (
        against("qd", "qd{} [rad/s]")(state, j)
    )
    portable: Portable = NOWHERE
    frame: str = ""
    told: Callable[[Array], Mapping[str, tuple[float, str]]] | None = None

    @property
    def law(self) -> str:
        """Its equation, or the formula that other programs are told."""
        return self.equation or "; ".join(f"tau = {f}" for f in self.portable.formula)

    @property
    def of_link(self) -> bool:
        """Whether it says that a link of every model is another."""
        return self.in_every_model and self.needs_known_body

    def units(self, joints: Joints, robot: Robot) -> dict[str, str]:
        """Return the unit of each parameter on some joints (from 0) of an arm."""
        own = self.scope in ("local", "pair") and all(
            robot.prismatic[j] for j in joints
        )
        if not own:
            return dict(self.parameters)
        return {k: self.sliding.get(k, along(u)) for k, u in self.parameters.items()}

    def candidates(
        self, dof: int, prismatic: Sequence[bool] = ()
    ) -> tuple[Joints, ...]:
        """Joints (from 0) on which the effect may sit, for an arm of dof joints.

        Args:
            prismatic: Which of them slide; () for none.
        """
        slides = prismatic or (False,) * dof
        return tuple(
            joints
            for joints in self._places(dof)
            if not (self.needs_turn and any(slides[j] for j in joints))
            and (self.scope != "pair" or len({slides[j] for j in joints}) == 1)
        )

    def _places(self, dof: int) -> tuple[Joints, ...]:
        if self.scope == "local" or self.scope == "link":
            return tuple((j,) for j in range(dof - self.outermost))
        if self.scope == "flange":
            return ((dof - 1,),)
        if self.scope == "global":
            return ((),)
        wrist = range(max(0, dof - 3), dof)
        pairs = list(pairwise(wrist))
        return tuple([*pairs, (wrist[0], wrist[-1])] if len(wrist) > 2 else pairs)

    def rows(self, joints: Joints, dof: int) -> Joints:
        """Rows of the torque vector on which the columns act."""
        if self.scope in ("local", "pair"):
            return joints
        return tuple(range(dof))


def local(feature: Callable[[State, int, Shape], Sequence[Array]]) -> Columns:
    """Columns of a local effect from its features on one joint."""

    def columns(state: State, joints: Joints, shape: Shape) -> Array:
        (joint,) = joints
        return np.column_stack(feature(state, joint, shape))[:, None, :]

    return columns


def wave(sin: int, cos: int, unit: str) -> Callable[[Array], Mapping]:
    """Tell a wave over the position by its amplitude, and where it is largest.

    Args:
        sin, cos: Which of the values these are.
        unit: Of both.
    """

    def told(values: Array) -> Mapping[str, tuple[float, str]]:
        s, c = values[sin], values[cos]
        largest = float(np.rad2deg(np.arctan2(s, c)))
        return {
            "amplitude": (float(np.hypot(s, c)), unit),
            "largest at": (largest, "°"),
        }

    return told


def against(signal: str, label: str) -> Callable[[State, int], tuple[Array, str]]:
    """Draw over a signal of the joint, whose number goes into the label."""

    def variable(state: State, j: int) -> tuple[Array, str]:
        text = along(label) if state.robot.prismatic[j] else label
        return getattr(state, signal)[:, j], text.format(j + 1)

    return variable


against_position = against("q", "q{} [rad]")
against_load = against("rigid", "rigid-body torque {} [N m]")
against_torque = against("tau_model", "model torque {} [N m]")


def shaped(values: Array, robot: Robot) -> tuple[Array, Shape]:
    """One coefficient, then the shape: what most parameters of a shape come to."""
    return values[:1], tuple(values[1:])


# What no arm can be: the ``possible`` of several effects.
SLACK = 0.1  # of what the model has: by so much a change may overshoot it


def within_torque(theta: Array, shape: Shape, limits: Limits) -> bool:
    """Of either sign, and no larger than the torque of the joint."""
    return bool(np.linalg.norm(theta) <= limits.torque)


def stays_positive(theta: Array, shape: Shape, limits: Limits) -> bool:
    """With what the model has of it, not negative: an inertia, or a friction.

    A change may overshoot what the model has by a little, since both have an error.
    """
    had = limits.had if len(limits.had) == len(theta) else np.zeros(len(theta))
    total = had + theta
    return bool(np.all(np.where(had > 0, total > -SLACK * had, total > 0)))


def dissipates(theta: Array, shape: Shape, limits: Limits) -> bool:
    """Friction takes power; and no joint moves against more than its torque."""
    return stays_positive(theta, shape, limits) and within_torque(theta, shape, limits)


def dissipates_with_speed(theta: Array, shape: Shape, limits: Limits) -> bool:
    """The same of friction per speed, at the speed that the joint was seen at."""
    positive = stays_positive(theta, shape, limits)
    return positive and within_torque(theta * limits.speed, shape, limits)


# How the torque of all joints changes when one joint is not where it seems to be.
#
# Encoders that lie, gears that twist and play in them move a joint by a shift that may
# itself change with time:
#
#     d tau = dtau/dq_j shift + dtau/dqd_j shift' + dtau/dqdd_j shift''
#
# The derivatives are those of the recursive Newton-Euler algorithm (Carpentier and
# Mansard 2018, as Pinocchio has them), once per log.


# A shift made of the model's torque holds qdd, and its own second derivative the fourth
# of a noisy angle: only what is slow is told apart from noise.
SLOW = 5.0  # Hz

KEPT = 1 << 27  # bytes of derivatives that are kept: they are read many times


def _key(state: State) -> tuple:
    own = b"" if state.inertial is None else state.inertial.tobytes()
    return *motion_key(state.robot, state.q, state.qd, state.qdd), own


@cached(LRUCache(KEPT, getsizeof=lambda slopes: slopes.nbytes), key=_key)
def sensitivity(state: State) -> Array:
    """Derivatives of the rigid torque to q, qd and qdd. Shape (3, n, dof, dof).

    The last axis is the joint that moves, the one before it the row of torque.
    """
    model = model_of(state)
    data = model.createData()
    q, qd, qdd = map(np.ascontiguousarray, (state.q, state.qd, state.qdd))
    out = np.empty((3, len(q), model.nv, model.nv))
    for i in range(len(q)):
        out[:, i] = pin.computeRNEADerivatives(model, data, q[i], qd[i], qdd[i])
    return out


def model_of(state: State) -> pin.Model:
    """The rigid body of the current model, loads included."""
    if state.inertial is None:
        return state.robot.model
    return with_inertial_parameters(state.robot.model, state.inertial)


def moved(state: State, joint: int, shift: Array, rates: tuple[Array, Array]) -> Array:
    """Change of all torques when joint j (from 0) is shifted [rad]. Shape (n, dof).

    Rates are the first and second derivative of the shift [rad/s, rad/s^2].
    """
    parts = zip(sensitivity(state), (shift, *rates), strict=True)
    return sum(slope[:, :, joint] * x[:, None] for slope, x in parts)


def turned(state: State, joint: int, shift: Array, rates: tuple[Array, Array]) -> Array:
    """The same where the drive is shifted with the joint. Shape (n, dof)."""
    out = moved(state, joint, shift, rates)
    if state.drive is not None:
        viscous, rotor = state.drive[:, joint]
        out[:, joint] += viscous * rates[0] + rotor * rates[1]
    return out


def slow(state: State, values: Array) -> Array:
    """What of a signal is slow enough to be differentiated twice. Shape (n,)."""
    return low_pass(values, min(SLOW, 0.05 * state.rate), state.rate)


def rates(state: State, values: Array) -> tuple[Array, Array]:
    """First and second time derivative of a signal. Shapes (n,)."""
    first = np.gradient(values, 1 / state.rate)
    return first, np.gradient(first, 1 / state.rate)
