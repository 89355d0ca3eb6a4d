"""The record of an effect: data and one pure function from motion to torque columns.

A new effect is one new file in this folder with a module-level ``EFFECT``; the
registry is the folder listing. The limits of an arm, and common conditions on the size
and sign of an effect, are here too.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Flag, auto
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from residual.quantity import convert_to_sliding_unit
from residual.recording import Array

if TYPE_CHECKING:  # both load Pinocchio, which the texts of an effect do not need
    from residual.robot.dynamics import LazyRegressor
    from residual.robot.robot import Robot

Shape = tuple[float, ...]


@dataclass(frozen=True, eq=False, slots=True)
class JointLimits:
    """Limits of the arm at the joints of an effect; for the whole arm the largest.

    Attributes:
        torque: Largest torque of the joint, by its limit or as it was logged [N m].
        lower, upper: Ends of its range [rad].
        speed: 95 % quantile of its logged speed [rad/s].
        weight: Mass of the arm [kg].
        reach: Length of the arm when it is stretched [m].
        nominal_coefficients: Coefficients of the same effect in the model, as refitted;
            zero without it. Shape (k,).
        load_mass_seen: Whether the mass of a load affects a torque by itself; for an
            arm of one joint only its moments do.
    """

    torque: float
    lower: float
    upper: float
    speed: float
    weight: float
    reach: float
    nominal_coefficients: Array
    load_mass_seen: bool = True


SLACK = 0.1  # of the model's value: allowed overshoot of a change


def stays_within_torque(theta: Array, shape: Shape, limits: JointLimits) -> bool:
    """Either sign, up to the torque of the joint."""
    return bool(np.linalg.norm(theta) <= limits.torque)


def stays_positive(theta: Array, shape: Shape, limits: JointLimits) -> bool:
    """Not negative in sum with the model's value: an inertia, or a friction.

    A change may slightly overshoot the model's value, since both have errors.
    """
    had = limits.nominal_coefficients
    had = had if len(had) == len(theta) else np.zeros(len(theta))
    total = had + theta
    return bool(np.all(np.where(had > 0, total > -SLACK * had, total > 0)))


def dissipates(theta: Array, shape: Shape, limits: JointLimits) -> bool:
    """Friction dissipates power, and does not exceed the torque of the joint."""
    positive = stays_positive(theta, shape, limits)
    return positive and stays_within_torque(theta, shape, limits)


def dissipates_with_speed(theta: Array, shape: Shape, limits: JointLimits) -> bool:
    """The same for friction per speed, at the logged speed of the joint."""
    positive = stays_positive(theta, shape, limits)
    return positive and stays_within_torque(theta * limits.speed, shape, limits)


Property = Literal["damping", "quadratic_damping", "friction", "armature", "stiffness", "constant"]
BRISTLE, EARLIER = 3, 258  # numbers that each of the two keeps in its memory


@dataclass(frozen=True, eq=False, slots=True)
class ExportedLaw:
    """The law of an effect for other programs; empty if it cannot be exported.

    A formula is an expression of C. It may use of the joint it acts on ``q``, ``qd``,
    ``qdd``, ``sign``, ``rigid`` and ``tau`` (see ``State``), the session time ``t``,
    the coefficients ``a[i]``, the numbers of the shape ``s[i]``, and ``sin``, ``cos``,
    ``tanh``, ``exp``, ``pow``, ``fabs``, ``fmin``, ``fmax``, ``sgn``. With
    ``m``, the effect's own memory, there are ``bristle(m, q, way)`` and ``earlier(m, t,
    tau, by)``. Of a pair of joints the six names are arrays of two.

    Attributes:
        formula: Torque [N m], one expression per joint that the effect acts on; a
            single one stands for all.
        shift: Joint angle minus encoder reading [rad], and its first and second
            derivative.
        memory: Number of values that the formula keeps between samples.
        joint: Property of a simulated joint for each coefficient: torque per
            "damping" qd, "quadratic_damping" qd |qd|, "friction" sign(qd), "armature"
            qdd, "stiffness" q, or "constant".
        bodies: (theta, joints, robot) -> inertial parameters that it adds (10 dof,).
        gravity: (theta, robot) -> acceleration that it adds to gravity [m/s^2] (3,).
        force: (theta,) -> force on the flange, in the base frame [N] (3,).
        possible: (theta, shape) -> whether the formula holds for these values.
        obstacle: Why there is no formula; empty if there is one.
    """

    formula: tuple[str, ...] = ()
    shift: tuple[str, str, str] | None = None
    memory: int = 0
    joint: tuple[Property, ...] = ()
    bodies: Callable[[Array, tuple[int, ...], Any], Array] | None = None
    gravity: Callable[[Array, Any], Array] | None = None
    force: Callable[[Array], Array] | None = None
    possible: Callable[[Array, tuple[float, ...]], bool] = lambda theta, shape: True
    obstacle: str = ""


NOWHERE = ExportedLaw(obstacle="its file does not say it")


Joints = tuple[int, ...]


class PlacedEffect(NamedTuple):
    """An effect on joints (from 0), with a shape."""

    effect: "Effect"
    joints: Joints
    shape: Shape

    def regressor(self, state: "State") -> Array:
        """Its columns on all joints. Shape (n, dof, k)."""
        columns = self.effect.columns(state, self.joints, self.shape)
        out = np.zeros((*state.q.shape, columns.shape[2]))
        out[:, list(self.effect.rows(self.joints, out.shape[1]))] = columns
        return out


Scope = Literal["local", "pair", "link", "flange", "global"]
Carried = Literal["", "body", "speed", "acceleration"]


@dataclass(frozen=True, eq=False, slots=True)
class State:
    """The inputs of an effect on one log: motion and the model's torque.

    Attributes:
        robot: The arm.
        rate: Sample rate [Hz].
        t: Session time [s]. Shape (n,).
        q, qd, qdd: Kinematics [rad, rad/s, rad/s^2]. Shape (n, dof).
        sign: Direction of motion, smoothed where the joint stands. Shape (n, dof).
        regressor: Inertial regressor, computed on first use. Shape (n, dof, 10 dof).
        rigid: Rigid-body torque of the current model [N m]. Shape (n, dof).
        tau_model: Torque of the current model [N m]. Shape (n, dof).
        inertial: Inertial parameters of the current model, loads included [SI]; None
            for those of the robot's description. Shape (10 dof,).
        drive: Torque of the drives per speed [N m s/rad] and per acceleration
            [kg m^2]; None for none. Shape (2, dof).
        enabled: Share of a drive that is on; None for on. Shape (n, dof).
    """

    robot: "Robot"
    rate: float
    t: Array
    q: Array
    qd: Array
    qdd: Array
    sign: Array
    regressor: "Array | LazyRegressor"
    rigid: Array
    tau_model: Array
    inertial: Array | None = None
    drive: Array | None = None
    enabled: Array | None = None


@dataclass(frozen=True, eq=False, slots=True)
class MotionSpan:
    """The motion of each joint in a set of logs, which determines the shapes to try.

    Attributes:
        speed: 95 % quantile of |qd| [rad/s]. Shape (dof,).
        travel: Range of q [rad]. Shape (dof,).
        duration: Session time covered, or 0 if the clock is unknown [s].
        cutoff: Identification cut-off [Hz].
        torque: Largest size of the logged torque, as a 99.5 % quantile [N m]; None
            if unknown. Shape (dof,).
        prismatic: Which joints slide; () for none.
        switched: Joints whose drive is off in a part of the logs; () for none.
        one_drive: Torque is computed from a single drive model, not measured.
    """

    speed: Array
    travel: Array
    duration: float
    cutoff: float
    torque: Array | None = None
    prismatic: tuple[bool, ...] = ()
    switched: tuple[bool, ...] = ()
    one_drive: bool = False


Columns = Callable[[State, Joints, Shape], Array]


def plot_over_signal(signal: str, label: str) -> Callable[[State, int], tuple[Array, str]]:
    """Plot over a signal of the joint, whose number is part of the label."""

    def variable(state: State, j: int) -> tuple[Array, str]:
        text = convert_to_sliding_unit(label) if state.robot.prismatic[j] else label
        return getattr(state, signal)[:, j], text.format(j + 1)

    return variable


against_speed = plot_over_signal("qd", "qd{} [rad/s]")
against_position = plot_over_signal("q", "q{} [rad]")
against_load = plot_over_signal("rigid", "rigid-body torque {} [N m]")
against_torque = plot_over_signal("tau_model", "model torque {} [N m]")


@dataclass(frozen=True, slots=True)
class ShapeRefinement:
    """The search of the first number of a shape between the grid points.

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

    def compute_half_width(self, joints: Joints, robot: "Robot") -> float:
        """Return the reach on some joints (from 0)."""
        slides = any(robot.prismatic[j] for j in joints)
        return (slides and self.sliding) or self.reach


class EffectTrait(Flag):
    """Traits of an effect for the search, the report and the exporters."""

    NONE = 0
    NEEDS_TURN = auto()  # it needs an angle: no prismatic joint has it
    PARAMETER = auto()  # it means that a parameter of the model is wrong
    IN_EVERY_MODEL = auto()  # every model has that parameter, declared or not
    CONSTANT = auto()  # its torque is the same on every row
    # One wave of many over the position, its coefficients cos and sin. A joint may have
    # several, and many of them can fit any curve.
    PERIODIC = auto()
    BODY = auto()  # it changes a body: excluded if the bodies are too uncertain
    FRICTION = auto()  # it dissipates power of its joint
    NOT_NEGATIVE = auto()  # its coefficients are not negative in any real arm
    ONE_VARIABLE = auto()  # its torque is a function of its ``variable`` alone
    NEEDS_CLOCK = auto()  # it needs the order of the logs in time
    USES_MODEL = auto()  # its columns depend on the model's torque
    MEMORY = auto()  # its columns depend on neighbouring samples or earlier motion
    # It distorts the report of the torque, not the torque: its columns are computed
    # from a torque without it.
    REPORT = auto()
    POWERED = auto()  # it exists only while the drive is on, as does its formula
    GROUPABLE = auto()  # it is also tried on all joints at once
    # Logs of one drive cannot separate such effects: all contain a motor constant.
    MOTOR = auto()
    CHAIN = auto()  # part of the chain of a drive: no effect if the chain is given


@dataclass(frozen=True, eq=False, slots=True)
class Effect:
    """One physical effect that a model may lack.

    A file of an effect sets the first eight fields; the rest have defaults.

    Attributes:
        name: Its name, that of its file.
        noun: Its noun in sentences ("a spring"); empty for its name in words.
        sentence: One sentence for a control engineer.
        equation: Its torque [N m] by its parameters, as a line of text; empty for the
            formula of ``portable``. "d tau" is a change of the reported torque.
        parameters: Parameter keys with their SI units on a revolute joint, in order.
        columns: Torque columns: (state, joints, shape) -> (n, rows, k), where the
            rows are the joints it acts on: its own, or all of them.
        variable: (state, joint) -> the horizontal axis of plots, with label; None if no
            single variable explains it, as for inertia.
        portable: The law for other programs.
        traits: See `EffectTrait`.
        scope: The joints that it may be on.
        sliding: Units on a prismatic joint that
            `residual.quantity.convert_to_sliding_unit` does not give.
        place: Its place in sentences, with ``{joints}`` or ``{links}`` in words.
        values: (theta, shape, robot) -> one value per parameter key.
        from_values: (values, robot) -> (theta, shape): the inverse of ``values``.
        shapes: Values of the nonlinear parameters to start from.
        refine: Search of the first nonlinear parameter; None if linear.
        drive_order: Its place, from 1, in the list of default effects of every drive; 0
            for none.
        carries: What its coefficients add to, besides the torque of its columns:
            the inertial parameters of the last body ("body"), the drive's torque per
            "speed" or per "acceleration"; empty for nothing.
        prior_sd: (robot,) -> prior of theta if physics determines the size;
            None for the default, 30 % of torque.
        possible: (theta, shape, limits) -> whether sign and size are possible
            (`residual.effects.base`).
        reports: (key, values, stds) -> whether to report a parameter; None for always.
        combined: (theta, robot) -> by formula, combinations that motion may determine
            if it does not determine the parameters: value, unit. Linear in theta.
        unit_directions: (states, joints) -> coefficients of an effect of size one, in
            typical directions; None for the first coefficient or any unit vector.
        far_fetched: Rank of implausibility; of two equal explanations the lower wins.
        inexact: One standard deviation, as a share of its size, between the forms of
            different authors if logs cover only a part of its range.
        family: Effects of one family on one joint exclude each other.
        outermost: Number of last joints that are excluded.
        rides_on: The effect on top of which its torque is reported.
        in_any_arm: (span, joint) -> shapes that every arm in use has in small size.
        least_seen: Shapes, SI, that logs show less than its typical one: the
            smallest detectable size is the median of theirs.
        frame: The frame of its vectors, in words; ``{flange}`` is its name in the URDF.
        display: (values) -> reported value and unit by name, such as amplitude and
            angle; None for the parameters themselves.
    """

    name: str
    sentence: str
    parameters: Mapping[str, str]
    columns: Columns
    noun: str = ""
    equation: str = ""
    variable: Callable[[State, int], tuple[Array, str]] | None = against_speed
    portable: ExportedLaw = NOWHERE
    traits: EffectTrait = EffectTrait.NONE
    scope: Scope = "local"
    sliding: Mapping[str, str] = field(default_factory=dict)
    place: str = "on {joints}"
    values: Callable[[Array, Shape, "Robot"], Array] = lambda theta, shape, robot: np.array(
        [*theta, *shape]
    )
    from_values: Callable[[Array, "Robot"], tuple[Array, Shape]] = lambda values, robot: (
        values,
        (),
    )
    shapes: Callable[[MotionSpan, int], Sequence[Shape]] = lambda span, joint: ((),)
    refine: ShapeRefinement | None = None
    drive_order: int = 0
    carries: Carried = ""
    prior_sd: Callable[["Robot"], Array] | None = None
    possible: Callable[[Array, Shape, JointLimits], bool] = lambda theta, shape, limits: True
    reports: Callable[[str, Array, Array], bool] | None = None
    combined: Callable[[Array, "Robot"], Mapping[str, tuple[float, str]]] | None = None
    unit_directions: Callable[[Sequence[State], Joints], Sequence[Array]] | None = None
    far_fetched: float = 0.0
    inexact: float = 0.0
    family: str = ""
    outermost: int = 0
    rides_on: str = ""
    in_any_arm: Callable[[MotionSpan, int], Sequence[Shape]] = lambda span, joint: ()
    least_seen: tuple[Shape, ...] = ()
    frame: str = ""
    display: Callable[[Array], Mapping[str, tuple[float, str]]] | None = None

    @property
    def law(self) -> str:
        """Its equation, or else its exported formula."""
        return self.equation or "; ".join(f"tau = {f}" for f in self.portable.formula)

    @property
    def replaces_link(self) -> bool:
        """Whether it replaces a link that every model has."""
        return EffectTrait.IN_EVERY_MODEL | EffectTrait.BODY in self.traits

    def units(self, joints: Joints, robot: "Robot") -> dict[str, str]:
        """Return the unit of each parameter on some joints (from 0) of an arm."""
        own = self.scope in ("local", "pair") and all(robot.prismatic[j] for j in joints)
        if not own:
            return dict(self.parameters)
        return {
            k: self.sliding.get(k, convert_to_sliding_unit(u)) for k, u in self.parameters.items()
        }

    def candidates(self, dof: int, prismatic: Sequence[bool] = ()) -> tuple[Joints, ...]:
        """Joints (from 0) on which the effect may sit, for an arm of dof joints.

        Args:
            prismatic: Which of them slide; () for none.
        """
        slides = prismatic or (False,) * dof
        return tuple(
            joints
            for joints in self._places(dof)
            if not (EffectTrait.NEEDS_TURN in self.traits and any(slides[j] for j in joints))
            and (self.scope != "pair" or len({slides[j] for j in joints}) == 1)
        )

    def _places(self, dof: int) -> tuple[Joints, ...]:
        if self.scope in ("local", "link"):
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


def build_joint_columns(feature: Callable[[State, int, Shape], Sequence[Array]]) -> Columns:
    """Columns of a local effect from its features on one joint."""

    def columns(state: State, joints: Joints, shape: Shape) -> Array:
        (joint,) = joints
        return np.column_stack(feature(state, joint, shape))[:, None, :]

    return columns


# Names that a feature may use (`ExportedLaw`), in terms of NumPy and a `State`.
_SIGNALS = {name: name for name in ("q", "qd", "qdd", "sign", "rigid")}
_SIGNALS["tau"] = "tau_model"
_FUNCTIONS = {name: getattr(np, name) for name in ("sin", "cos", "tanh", "exp", "fabs")}
_FUNCTIONS |= {"pow": pow, "fmin": np.minimum, "fmax": np.maximum}
_FUNCTIONS |= {"sgn": np.sign, "__builtins__": {}}


def build_local_law(*features: str, joint: tuple[Property, ...] = ()) -> dict[str, Any]:
    """Build columns and formula of a local effect from the same features.

    Args:
        features: An expression of C for each coefficient, as in `ExportedLaw`.
        joint: Properties of a simulated joint for the coefficients.

    Returns:
        The fields ``columns`` and ``portable`` of an `Effect`.
    """
    codes = [compile(feature, feature, "eval") for feature in features]
    signals = {name for code in codes for name in code.co_names} & _SIGNALS.keys()

    def columns(state: State, joints: Joints, shape: Shape) -> Array:
        (j,) = joints
        names = {name: getattr(state, _SIGNALS[name])[:, j] for name in signals}
        names |= {"t": state.t, "s": shape}
        out = np.empty((len(state.t), 1, len(codes)))
        for k, code in enumerate(codes):  # from the files of effects
            out[:, 0, k] = eval(code, _FUNCTIONS, names)
        return out

    terms = (f"a[{k}]" + f" * {feature}" * (feature != "1") for k, feature in enumerate(features))
    return {"columns": columns, "portable": ExportedLaw((" + ".join(terms),), joint=joint)}


def describe_wave(sin: int, cos: int, unit: str) -> Callable[[Array], Mapping]:
    """Describe a wave over the position by its amplitude and the place of its maximum.

    Args:
        sin, cos: Which of the values these are.
        unit: Of both.
    """

    def display(values: Array) -> Mapping[str, tuple[float, str]]:
        s, c = values[sin], values[cos]
        angle = float(np.rad2deg(np.arctan2(s, c)))
        return {"amplitude": (float(np.hypot(s, c)), unit), "largest at": (angle, "°")}

    return display


def append_shape(values: Array, robot: "Robot") -> tuple[Array, Shape]:
    """Return one coefficient, then the shape: the parameters of most shaped effects."""
    return values[:1], tuple(values[1:])
