"""What an effect is: data and one pure function from motion to torque columns.

A new effect is one new file in this folder with a module-level ``EFFECT``; the
registry is the folder listing. What an arm can do, and the usual conditions on the
size and sign of an effect, stand here too.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import Flag, auto
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from residual.quantity import convert_to_sliding_unit
from residual.recording import Array

if TYPE_CHECKING:  # both load Pinocchio, which the words of an effect do not need
    from residual.robot.dynamics import LazyRegressor
    from residual.robot.robot import Robot

Shape = tuple[float, ...]


@dataclass(frozen=True, eq=False, slots=True)
class JointLimits:
    """What an arm can do where an effect sits; of the whole arm the largest.

    Attributes:
        torque: Largest torque of the joint, by its limit or as it was logged [N m].
        lower, upper: Ends of its range [rad].
        speed: Speed that it was seen at, a 95 % quantile [rad/s].
        weight: Mass of the arm [kg].
        reach: Length of the arm when it is stretched [m].
        nominal_coefficients: Of the same effect in the model, as refitted; zero where
            it has none. Shape (k,).
        load_mass_seen: Whether the mass of a load moves a torque by itself; of an arm
            of one joint only its moments do.
    """

    torque: float
    lower: float
    upper: float
    speed: float
    weight: float
    reach: float
    nominal_coefficients: Array
    load_mass_seen: bool = True


SLACK = 0.1  # of what the model has: by so much a change may overshoot it


def stays_within_torque(theta: Array, shape: Shape, limits: JointLimits) -> bool:
    """Of either sign, and no larger than the torque of the joint."""
    return bool(np.linalg.norm(theta) <= limits.torque)


def stays_positive(theta: Array, shape: Shape, limits: JointLimits) -> bool:
    """With what the model has of it, not negative: an inertia, or a friction.

    A change may overshoot what the model has by a little, since both have an error.
    """
    had = limits.nominal_coefficients
    had = had if len(had) == len(theta) else np.zeros(len(theta))
    total = had + theta
    return bool(np.all(np.where(had > 0, total > -SLACK * had, total > 0)))


def dissipates(theta: Array, shape: Shape, limits: JointLimits) -> bool:
    """Friction takes power; and no joint moves against more than its torque."""
    positive = stays_positive(theta, shape, limits)
    return positive and stays_within_torque(theta, shape, limits)


def dissipates_with_speed(theta: Array, shape: Shape, limits: JointLimits) -> bool:
    """The same of friction per speed, at the speed that the joint was seen at."""
    positive = stays_positive(theta, shape, limits)
    return positive and stays_within_torque(theta * limits.speed, shape, limits)


Property = Literal["damping", "quadratic_damping", "friction", "armature", "stiffness", "constant"]
BRISTLE, EARLIER = 3, 258  # numbers that each of the two has to keep in its memory


@dataclass(frozen=True, eq=False, slots=True)
class ExportedLaw:
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
        obstacle: Why no formula can say it; empty where there is one.
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
    """An effect on joints (from 0), with the shape that a search tries."""

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
    """How far one set of logs moves each joint: what decides which shapes to try.

    Attributes:
        speed: 95 % quantile of |qd| [rad/s]. Shape (dof,).
        travel: Range of q [rad]. Shape (dof,).
        duration: Session time covered, or 0 where the clock is not known [s].
        cutoff: Identification cut-off [Hz].
        torque: Largest size of the logged torque, as a 99.5 % quantile [N m]; None
            where it is not known. Shape (dof,).
        prismatic: Which joints slide; () for none.
        switched: Joints whose drive is off in a part of the logs; () for none.
        one_drive: Torque is that of one and the same drive, not measured.
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
    """Draw over a signal of the joint, whose number goes into the label."""

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

    def compute_half_width(self, joints: Joints, robot: "Robot") -> float:
        """Return the reach on some joints (from 0)."""
        slides = any(robot.prismatic[j] for j in joints)
        return (slides and self.sliding) or self.reach


class EffectTrait(Flag):
    """What the search, the report and the exporters must know of an effect."""

    NONE = 0
    NEEDS_TURN = auto()  # it needs an angle: no prismatic joint has it
    PARAMETER = auto()  # it says that a parameter of the model is wrong
    IN_EVERY_MODEL = auto()  # every model has that parameter, declared or not
    CONSTANT = auto()  # its torque is the same on every row
    # One wave of many over the position, its coefficients cos and sin. A joint may have
    # several, and many of them can fit any curve.
    PERIODIC = auto()
    BODY = auto()  # it changes a body: barred where the bodies are hardly known
    FRICTION = auto()  # it takes power from the motion of its joint
    NOT_NEGATIVE = auto()  # its coefficients are not negative in any real arm
    ONE_VARIABLE = auto()  # its torque is a function of its ``variable`` alone
    NEEDS_CLOCK = auto()  # it needs the order of the logs in time
    USES_MODEL = auto()  # its columns depend on the model's torque
    MEMORY = auto()  # its columns depend on neighbouring samples or earlier motion
    # It distorts the report of the torque, not the torque: its columns are computed
    # from a torque without it.
    REPORT = auto()
    POWERED = auto()  # it is there while the drive is on: its formula is of that time
    GROUPABLE = auto()  # it is also tried on all joints at once
    # Logs of one drive do not split what has this: a motor constant is in them all.
    MOTOR = auto()
    CHAIN = auto()  # the chain of a drive has it: where one is stated it is no effect


@dataclass(frozen=True, eq=False, slots=True)
class Effect:
    """One physical effect that a model may lack.

    A file of an effect sets the first eight fields; the rest have defaults.

    Attributes:
        name: Its name, that of its file.
        noun: What a sentence calls it ("a spring"); empty for its name in words.
        sentence: One sentence for a control engineer.
        equation: Its torque [N m] by its parameters, as a line of text; empty for the
            formula of ``portable``. "d tau" is a change of the reported torque.
        parameters: Parameter keys with their SI units on a revolute joint, in order.
        columns: Torque columns: (state, joints, shape) -> (n, rows, k), where the
            rows are the joints it acts on: its own, or all of them.
        variable: (state, joint) -> what the report plots it against, with label; None
            where no one variable explains it, as with all that has inertia.
        portable: The same for other programs.
        traits: See `EffectTrait`.
        scope: Which joints it belongs to.
        sliding: Units on a prismatic joint that
            `residual.quantity.convert_to_sliding_unit` does not give.
        place: Where a sentence puts it, by its ``{joints}`` or ``{links}`` in words.
        values: (theta, shape, robot) -> one value per parameter key.
        from_values: (values, robot) -> (theta, shape): the inverse of ``values``.
        shapes: Values of the nonlinear parameters to start from.
        refine: How the first nonlinear parameter is searched; None where linear.
        drive_order: Its place, from 1, in the list of what every drive has and
            a model is taken to have by default; 0 for none.
        carries: What its coefficients are a part of, besides the torque of its columns:
            the inertial parameters of the last body ("body"), the drive's torque per
            "speed" or per "acceleration"; empty for nothing.
        prior_sd: (robot,) -> prior of theta where the size is known from physics;
            None for the default, 30 % of torque.
        possible: (theta, shape, limits) -> whether an arm can have it so, by sign and
            size (`residual.effects.base`).
        reports: (key, values, stds) -> whether to report a parameter; None for always.
        combined: (theta, robot) -> by formula, what motion may determine where it does
            not determine the parameters: value, unit. Linear in theta.
        unit_directions: (states, joints) -> coefficients of an effect of size one, in
            its usual directions; None where the first alone or a plain vector says it.
        far_fetched: Of two that explain the same the one with less is named first.
        inexact: One standard deviation, as a share of its size, of what other authors'
            forms of it give where logs see only a part of its range.
        family: Effects of one family on one joint exclude each other.
        outermost: How many of the last joints it is not tried on.
        rides_on: The effect that its torque is reported on top of.
        in_any_arm: (span, joint) -> shapes of which every arm in use has a little.
        least_seen: Shapes, SI, in which logs show it less than in its usual one: the
            smallest detectable size is the median of theirs.
        frame: The frame of its vectors, in words; ``{flange}`` is its name in the URDF.
        display: (values) -> value and unit by name as a report shows them, such as
            amplitude and angle; None for the parameters themselves.
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
        """Its equation, or the formula that other programs are told."""
        return self.equation or "; ".join(f"tau = {f}" for f in self.portable.formula)

    @property
    def replaces_link(self) -> bool:
        """Whether it says that a link of every model is another."""
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


# What a feature may use (`ExportedLaw`), as NumPy and a `State` have it.
_SIGNALS = {name: name for name in ("q", "qd", "qdd", "sign", "rigid")}
_SIGNALS["tau"] = "tau_model"
_FUNCTIONS = {name: getattr(np, name) for name in ("sin", "cos", "tanh", "exp", "fabs")}
_FUNCTIONS |= {"pow": pow, "fmin": np.minimum, "fmax": np.maximum}
_FUNCTIONS |= {"sgn": np.sign, "__builtins__": {}}


def build_local_law(*features: str, joint: tuple[Property, ...] = ()) -> dict[str, Any]:
    """Columns of a local effect and its formula, from the features that both are of.

    Args:
        features: An expression of C for each coefficient, as in `ExportedLaw`.
        joint: What the coefficients are to a simulated joint.

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
        for k, code in enumerate(codes):  # of the effects' own files
            out[:, 0, k] = eval(code, _FUNCTIONS, names)
        return out

    terms = (f"a[{k}]" + f" * {feature}" * (feature != "1") for k, feature in enumerate(features))
    return {"columns": columns, "portable": ExportedLaw((" + ".join(terms),), joint=joint)}


def describe_wave(sin: int, cos: int, unit: str) -> Callable[[Array], Mapping]:
    """Tell a wave over the position by its amplitude, and where it is largest.

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
    """One coefficient, then the shape: what most parameters of a shape come to."""
    return values[:1], tuple(values[1:])
