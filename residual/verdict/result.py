"""The verdict, as records of plain values: reading one loads no model."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from residual.check.result import LogCheck
from residual.errors import format_joint_numbers
from residual.model.records import BodyCorrection, PositionErrors
from residual.quantity import (
    format_number,
    format_percent,
    format_probability,
    format_uncertain_value,
)

if TYPE_CHECKING:
    from residual.model.compare import FindingScatter, LogPrediction
    from residual.model.lookup import CorrectedModel
    from residual.model.model import Model

METRIC = "100*||tau-tau_hat||/||tau||"
STILL = "the logs show no motion, so the arm cannot be diagnosed"
EXPLAINED = "explained torque [N m]"

Number = float | None  # None if unknown


@dataclass(frozen=True, slots=True)
class Dependence:
    """A dependence of the residual of one joint.

    Attributes:
        joint: Joint of the residual, from 1.
        on: "q", "qd", "qdd", "tau", "t" or "frequency".
        of: Joints of q, qd, qdd or tau, from 1.
        form: "curve", "by direction", "sum" or "difference".
        share: Of the squared residual beyond noise.
        frequency: Of a line [Hz], else None.
    """

    joint: int
    on: str
    of: tuple[int, ...]
    form: str
    share: Number
    frequency: Number


@dataclass(frozen=True, slots=True)
class Unexplained:
    """The unexplained torque after the findings.

    Attributes:
        joints: Joints from 1 with a residual above noise.
        fraction, noise_floor: Unexplained share of the torque; share of noise.
        depends_on: Dependences of the residual of these joints.
        kind: "repeatable", "time-driven", or None.
        per_joint: Fraction of every joint.
        noise_model: Source of the noise level.
    """

    joints: tuple[int, ...]
    fraction: Number
    noise_floor: Number
    depends_on: tuple[Dependence, ...]
    kind: str | None
    per_joint: tuple[Number, ...]
    noise_model: str | None


@dataclass(frozen=True, slots=True)
class Drift:
    """A change of all friction relative to the baseline.

    Attributes:
        factor: Friction now over that of the baseline.
        std: Its standard deviation.
        joints: Joints from 1 whose friction changed that way beyond two deviations.
        clock: "recording time" if baseline and logs share one; else "order".
    """

    factor: Number
    std: Number
    joints: tuple[int, ...]
    clock: str


@dataclass(frozen=True, slots=True)
class Edit:
    """Errors on logs of the arm without an effect, after its removal [%].

    Attributes:
        name, joints: The effect and where, joints from 1.
        error: Of the augmented model without it.
        kept: Of the same model with it, on the same logs.
        least_squares: Of dense least squares with its parameters reset
            (`reset_effect_parameters`);
            None if it has none.
        reference: Of the best model: the true parameters if known, else the baseline's
            own model.
    """

    name: str
    joints: tuple[int, ...]
    error: Number
    kept: Number
    least_squares: Number
    reference: Number


@dataclass(frozen=True, slots=True)
class Change:
    """One value of the nominal model, compared with the logs.

    Attributes:
        name: The declared effect; "inertial" for base parameters of the bodies.
        joints: Joints from 1; for a base parameter its leading link.
        parameter: Key of the effect's parameter; for a base parameter its sum.
        nominal: The given value; with a baseline, that of the baseline.
        identified: The value from these logs, findings included.
        std: Standard deviation of the difference.
        unit: SI unit.
        sigma: The difference in standard deviations.
        beyond: Whether it is beyond chance and by more than 5 %.
        explained: Whether a finding already accounts for it.
    """

    name: str
    joints: tuple[int, ...]
    parameter: str
    nominal: Number
    identified: Number
    std: Number
    unit: str
    sigma: Number
    beyond: bool
    explained: bool = False


MOTION, LOAD, UNTOLD = "motion", "load", "nothing"


@dataclass(frozen=True, slots=True)
class Place:
    """An effect and its joints.

    Attributes:
        name: Its name.
        joints: Joints from 1; empty for the whole arm.
    """

    name: str
    joints: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Alternative:
    """A set of effects as good as the named one.

    Attributes:
        set: Its effects, one joint each where they are local.
        nats: Its evidence less the price of its names, over that of the named set.
        separated_by: "motion" if another motion would separate them; "load" if the two
            are bodies that move alike: weigh the load, or log the arm without it;
            "nothing" if they have the same torque on every motion, at that size.
    """

    set: tuple[Place, ...]
    nats: Number
    separated_by: str


@dataclass(frozen=True, slots=True)
class Frames:
    """URDF names of the joints, and of the frame at the flange.

    Attributes:
        joints: Joint 1 first.
        flange: --tip, else the last link before locked joints; vectors of a load are in
            its axes.
    """

    joints: tuple[str, ...]
    flange: str


STAGES = ("nominal", "identified", "augmented", "plsr")
PLAIN = "least_squares"  # the common reference, not a model of ours

Value = Number | tuple[Number, ...]  # one per joint if a finding is on several
PerJoint = Mapping[str, tuple[Number, ...] | None]  # by model; None for all


@dataclass(frozen=True, slots=True, repr=False)
class Parameter:
    """One physical parameter of a finding.

    Attributes:
        value: The value; if the effect means a wrong value, the change.
        std: Its standard deviation.
        unit: SI unit.
        determined: Whether the motion determines it; else it is the prior value, and
            only ``combinations`` of it are known.
    """

    value: Value
    std: Value
    unit: str
    determined: bool = True

    @property
    def pairs(self) -> tuple[tuple[Number, Number], ...]:
        """Value and standard deviation, per joint if there are several."""
        if not isinstance(self.value, tuple):
            return ((self.value, self.std),)
        stds = self.std
        if not isinstance(stds, tuple):
            stds = (stds,) * len(self.value)
        return tuple(zip(self.value, stds, strict=True))

    def __str__(self) -> str:
        return ", ".join(format_uncertain_value(v, s, self.unit) for v, s in self.pairs)

    def __repr__(self) -> str:
        return f"Parameter({self})"


@dataclass(frozen=True, slots=True)
class Splits:
    """Number of repeated searches that found a name again.

    Attributes:
        found: Left-out parts after which it was found again.
        of: Left-out parts after which it was detectable.
    """

    found: int
    of: int


@dataclass(frozen=True, slots=True)
class Evidence:
    """The evidence for a finding.

    Attributes:
        nats: Log Bayes factor with and without it.
        by: "fit" or "plausibility".
        held_out: "confirmed" or "neutral".
        held_out_gain: Share of the held-out error that it removes.
        splits: Repeated searches without a part of the data; None if the logs are too
            short.
    """

    nats: Number
    by: str | None
    held_out: str | None
    held_out_gain: Number
    splits: Splits | None = None


@dataclass(frozen=True, slots=True, repr=False)
class Finding:
    """One effect that the model lacks.

    Attributes:
        name: Its name.
        joints: Joints from 1; empty for the whole arm.
        probability: That it or an equivalent is right, calibrated on arms with known
            truth.
        order: Rank in the list, from 1.
        equivalent: Effects that these logs cannot separate from it, each with their
            joints if there are several.
        parameters: By key.
        combinations: Determined combinations in place of undetermined parameters, by
            formula.
        evidence: Its evidence.
    """

    name: str
    joints: tuple[int, ...]
    probability: Number
    order: int
    equivalent: tuple[Place, ...]
    parameters: Mapping[str, Parameter]
    combinations: Mapping[str, Parameter] = field(default_factory=dict)
    evidence: Evidence = field(kw_only=True)

    @property
    def where(self) -> str:
        """Name and joints: 'payload on joint 6'."""
        return self.name + _joints_phrase(self.joints)

    def __repr__(self) -> str:
        known = ", ".join(f"{k} {v}" for k, v in self.parameters.items())
        return f"Finding({self.where}: {known})" if known else f"Finding({self.where})"


@dataclass(frozen=True, slots=True)
class Detectable:
    """The size of an effect that these logs show in half of all cases.

    Attributes:
        name, joints: The effect and where, joints from 1.
        value, unit: The size; None if it is more than any arm has.
        confusable: Effects that these logs would not separate from it at three times
            that size.
    """

    name: str
    joints: tuple[int, ...]
    value: Number
    unit: str
    confusable: tuple[Place, ...] = ()


@dataclass(frozen=True, slots=True)
class ErrorTables:
    """Errors of the models on held-out logs [%], by name of the model.

    Attributes:
        metric, cutoff_hz: Their formula; cut-off of the identification filter.
        logs: The held-out logs.
        same_run: Whether they are part of a fit log.
        held_out, filtered, moving: Of every joint: as logged, both sides filtered, the
            same while that joint moves.
        overall, overall_filtered, overall_moving: All joints in one norm: as logged,
            filtered, while they move.
        worse: Joints from 1 that the findings make worse beyond chance, in motion.
        position: Of models in free simulation under the goals of the held-out logs; None
            if torque was measured.
    """

    metric: str
    cutoff_hz: Number
    logs: tuple[str, ...]
    same_run: bool
    held_out: PerJoint
    filtered: PerJoint
    moving: PerJoint
    overall: Mapping[str, Number]
    overall_filtered: Mapping[str, Number]
    overall_moving: Mapping[str, Number]
    worse: tuple[int, ...]
    position: PositionErrors | None = None


@dataclass(frozen=True, slots=True)
class Verdict:
    """The verdict (docs/verdict.md).

    Attributes:
        robot: Name of the robot.
        declared: Effects that the nominal model had.
        verdict: "effects", "none" or "unknown".
        effects: Missing effects, most important first.
        minimum_detectable: Smallest detectable sizes.
        unexplained: The unexplained torque.
        error: Errors on held-out logs.
        nominal_scale: Scale of the prior of the rigid parameters; None with a baseline.
        next_experiment: Motion that would separate equivalents, or None.
        warnings: Sentences that qualify the answer.
        frames: URDF names of joints and flange.
        log_check: Faults of the logs; None if they were not checked.
        contradictions: Physically impossible results of the fit, in sentences: then
            "none" is not justified, and the verdict is "unknown".
        drift: Friction of all joints against the baseline's; None if unchanged.
        background: Small effects of any used arm, folded.
        changes: Every nominal value, compared with the logs.
        alternatives: Sets of effects that these logs cannot separate from ``effects``.
        edit: The edit test of each effect; None without a baseline.
        bodies: Impossible bodies of the free fit, and the cost of the nearest possible
            ones; None if every body is possible.
        suspected: Names less certain than those of ``effects``, in no model.
        too_small: Joints from 1 whose torque is hardly above its quantization or noise:
            they have no error.
    """

    robot: str
    declared: tuple[str, ...]
    verdict: Literal["effects", "none", "unknown"]
    effects: tuple[Finding, ...]
    minimum_detectable: tuple[Detectable, ...]
    unexplained: Unexplained
    error: ErrorTables
    nominal_scale: Number
    next_experiment: Mapping | None
    warnings: tuple[str, ...]
    log_check: LogCheck | None = None
    contradictions: tuple[str, ...] = ()
    drift: Drift | None = None
    background: tuple[Finding, ...] = ()
    changes: tuple[Change, ...] = ()
    alternatives: tuple[Alternative, ...] = ()
    edit: tuple[Edit, ...] | None = None
    bodies: BodyCorrection | None = None
    frames: Frames = field(kw_only=True)
    suspected: tuple[Finding, ...] = ()
    too_small: tuple[int, ...] = ()

    @property
    def trusted(self) -> bool:
        """Whether no fault of the logs is certain."""
        return self.log_check is None or not self.log_check.certain

    @property
    def dof(self) -> int:
        """Number of joints."""
        return len(self.unexplained.per_joint)

    def __str__(self) -> str:
        errors = self.error.overall_moving
        before, after = (format_percent(errors[k]) for k in ("identified", "augmented"))
        said = "nothing found" if self.verdict == "none" else "something without a name"
        if self.effects:
            sure = [f.probability for f in self.effects if f.probability is not None]
            words = [f.where for f in self.effects]
            if sure:  # never certain
                odds = "> 0.99" if min(sure) > 0.99 else f"= {min(sure):.2f}"
                words.append(f"probability {odds}")
            said = ", ".join(words)
        elif self.verdict == "unknown":
            said += _joints_phrase(self.unexplained.joints)
        held_out = f"{before} -> {after}" if self.effects else before
        said += "" if self.trusted else " (faulty logs)"
        return f"{self.robot}: {said}; held-out {held_out}"


def _joints_phrase(joints: tuple[int, ...]) -> str:
    return f" on {format_joint_numbers(joints)}" if joints else ""


# The next experiment: its rivals, and its chance.

NOTHING = Place("nothing", ())
TOGETHER = " + "  # between the names of a rival with several effects
SURE = 0.8  # chance that counts as settling


def describe_settling_time(seconds: float, after: float | None, chance: float) -> str:
    """Return the settling time and chance of a motion, in words."""
    chance_text = format_probability(chance)
    end = f"{format_number(seconds)} s with a chance of {chance_text}"
    if after is None:
        return f"settled after {end}"
    return f"settled after {after:.1f} s with a chance of {format_probability(SURE)}, after {end}"


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Diagnosis:
    """The result of a diagnosis: the verdict, the models and the curves.

    Attributes:
        verdict: The verdict.
        models: By name: "nominal", "identified", "augmented", and "plsr" where tables
            were fitted to the residual.
        proofs: One per held-out log.
        clouds: Several per finding, at most one per joint.
        notes: Notes on the signals (rates, filters, delays, masks).
        residual_clouds: One per unexplained joint: its residual over the variable that
            it depends on most, else over time.
        sentences: One plain sentence per finding, in the order of the findings.
        adoptable: Model to adopt: the augmented one, or the fit of both epochs.
        question: The open question of these logs (`OpenQuestion`), for
            `modelgap next`; None for a comparison.
    """

    verdict: Verdict
    models: Mapping[str, "Model | CorrectedModel"] = field(default_factory=dict)
    proofs: tuple["LogPrediction", ...] = ()
    clouds: tuple["FindingScatter", ...] = ()
    notes: tuple[str, ...] = ()
    residual_clouds: tuple["FindingScatter", ...] = ()
    sentences: tuple[str, ...] = ()
    adoptable: "Model | None" = None
    question: object | None = None

    @property
    def effects(self) -> tuple[Finding, ...]:
        """What is missing, most important first."""
        return self.verdict.effects

    @property
    def errors(self) -> ErrorTables:
        """Errors on the held-out logs [%]."""
        return self.verdict.error

    @property
    def unexplained(self) -> Unexplained:
        """What remains."""
        return self.verdict.unexplained

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentences that qualify the answer."""
        return self.verdict.warnings

    def torque_unit(self, joint: int) -> str:
        """Return the unit of torque or force of a joint (from 1)."""
        for model in self.models.values():
            body = model if hasattr(model, "robot") else model.model
            return "N" if body.robot.prismatic[joint - 1] else "N m"
        return "N m"

    def __repr__(self) -> str:
        return f"Diagnosis({self.verdict})"
