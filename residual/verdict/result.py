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

Number = float | None  # None where it is not known


@dataclass(frozen=True, slots=True)
class Dependence:
    """What the remainder of one joint varies with.

    Attributes:
        joint: Whose remainder, from 1.
        on: "q", "qd", "qdd", "tau", "t" or "frequency".
        of: Whose q, qd, qdd or tau, from 1.
        form: "curve", "by direction", "sum" or "difference".
        share: Of the squared remainder beyond noise.
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
    """What remains after everything that was named.

    Attributes:
        joints: Joints from 1 on which more than noise remains.
        fraction, noise_floor: Of the torque, that nothing explains; that is noise.
        depends_on: What the remainder of these joints varies with.
        kind: "repeatable", "time-driven", or None.
        per_joint: Fraction of every joint.
        noise_model: Where the noise level is from.
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
    """A change of all friction, held against the baseline's.

    Attributes:
        factor: Friction now over that of the baseline.
        std: Its standard deviation.
        joints: Joints from 1 whose friction moved that way beyond two deviations.
        clock: "recording time", where baseline and logs share one; else "order".
    """

    factor: Number
    std: Number
    joints: tuple[int, ...]
    clock: str


@dataclass(frozen=True, slots=True)
class Edit:
    """Errors on logs of the arm without an effect, after it was taken out [%].

    Attributes:
        name, joints: The effect and where, joints from 1.
        error: Of the augmented model without it.
        kept: Of the same model with it, on the same logs.
        least_squares: Of dense least squares with its parameters set back
            (`reset_effect_parameters`);
            None where it has none to set back.
        reference: Of the best there is: the true parameters where they are known, the
            baseline's own model where they are not.
    """

    name: str
    joints: tuple[int, ...]
    error: Number
    kept: Number
    least_squares: Number
    reference: Number


@dataclass(frozen=True, slots=True)
class Change:
    """One value of the nominal model beside the same as the logs have it.

    Attributes:
        name: The declared effect; "inertial" for what the motion tells of the body.
        joints: Joints from 1; of the body the link that leads.
        parameter: Key of the effect's parameter; of the body the sum that it is.
        nominal: As given; with a baseline, as that has it.
        identified: As these logs have it, what was named included.
        std: Standard deviation of the difference.
        unit: SI unit.
        sigma: The difference in standard deviations.
        beyond: Whether it is beyond chance and by more than 5 %.
        explained: Whether that is said by a finding already.
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
    """An effect and the joints that it sits on.

    Attributes:
        name: Its name.
        joints: Joints from 1; empty for the whole arm.
    """

    name: str
    joints: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Alternative:
    """A set as good as the named one.

    Attributes:
        set: Its effects, one joint each where they are local.
        nats: Its evidence less the price of its names, over that of the named set.
        separated_by: "motion" where another motion would tell; "load" where the two are
            bodies that move alike: weigh the load, or log the arm without it; "nothing"
            where the two are one torque on every motion, at the size that was found.
    """

    set: tuple[Place, ...]
    nats: Number
    separated_by: str


@dataclass(frozen=True, slots=True)
class Frames:
    """What the URDF calls the joints, and the frame at the flange.

    Attributes:
        joints: Joint 1 first.
        flange: --tip, else the last link before locked joints: vectors of a load are in
            its axes.
    """

    joints: tuple[str, ...]
    flange: str


STAGES = ("nominal", "identified", "augmented", "plsr")
PLAIN = "least_squares"  # the reference that anyone has at hand, and no model of ours

Value = Number | tuple[Number, ...]  # one per joint where a finding is on several
PerJoint = Mapping[str, tuple[Number, ...] | None]  # by model; None as a whole


@dataclass(frozen=True, slots=True, repr=False)
class Parameter:
    """One physical parameter of a finding.

    Attributes:
        value: The value; where the effect means that a known one is wrong, the change.
        std: Its standard deviation.
        unit: SI unit.
        determined: Whether the motion determines it; else it is what was expected of it
            beforehand, and only ``combinations`` of it are known.
    """

    value: Value
    std: Value
    unit: str
    determined: bool = True

    @property
    def pairs(self) -> tuple[tuple[Number, Number], ...]:
        """Value and standard deviation, of each joint where there are several."""
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
    """How often a name came back when the search was done again.

    Attributes:
        found: Parts left out after which it was found again.
        of: Parts left out in all that left something of it to find.
    """

    found: int
    of: int


@dataclass(frozen=True, slots=True)
class Evidence:
    """Why a finding is believed.

    Attributes:
        nats: Logarithm of how much likelier the logs are with it.
        by: "fit" or "plausibility".
        held_out: "confirmed" or "neutral".
        held_out_gain: Part of the held-out error that it removes.
        splits: How often it was found again without a part of the data; None where
            the logs are too short for that.
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
        probability: That it is right, by what came of names like it on arms whose
            truth is known, and that it is of its class (itself and its equivalents).
        order: Place in the list, from 1.
        equivalent: What these logs cannot tell from it; of several joints each with
            those on which they cannot.
        parameters: By key.
        combinations: What the motion determines in place of parameters that it does
            not, by formula.
        evidence: Why it is believed.
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
    """The size of an effect of which half would have been found in these logs.

    Attributes:
        name, joints: The effect and where, joints from 1.
        value, unit: The size; None where it is more than any arm has.
        confusable: What these logs would not tell from it at three times that size.
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
        metric, cutoff_hz: Their formula; of the identification filter.
        logs: What was held out.
        same_run: Whether it is a part of a fit log.
        held_out, filtered, moving: Of every joint: as logged, both sides filtered, the
            same where that joint moves.
        overall, overall_filtered, overall_moving: All joints in one norm: as logged,
            filtered, where they move.
        worse: Joints from 1 that the findings make worse beyond chance, where they
            move.
        position: Of models that go by themselves under the goals of the held-out logs;
            None where torque was measured.
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
    """The answer, as docs/verdict.md has it.

    Attributes:
        robot: Name of the robot.
        declared: Effects that the nominal model had.
        verdict: "effects", "none" or "unknown".
        effects: What is missing, most important first.
        minimum_detectable: Sizes that would have been found.
        unexplained: What remains.
        error: The proof.
        nominal_scale: Scale of the prior of the rigid parameters; None with a baseline.
        next_experiment: Motion that would tell equivalents apart, or None.
        warnings: Sentences that qualify the answer.
        frames: What joints and flange are called in the URDF.
        log_check: What is wrong with the logs; None where they were not checked.
        contradictions: What of the fit no arm can be, in sentences: then nothing found
            is no answer, and the verdict is "unknown".
        drift: Friction of all joints against the baseline's; None where it stayed.
        background: What any arm has a little of, folded: no reason to look.
        changes: Every value that the model was given beside what the logs make of it.
        alternatives: Sets of effects that these logs cannot tell from ``effects``.
        edit: What is left of each effect, taken out again; None without a baseline.
        bodies: What of the free fit no body can be, and what the nearest possible one
            costs; None where every body can exist.
        suspected: Names less sure than those of ``effects``, and in no model.
        too_small: Joints from 1 whose torque is little more than its step or noise:
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
            if sure:  # no data give certainty
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


# The next experiment: rivals that it separates, and how surely.

NOTHING = Place("nothing", ())
TOGETHER = " + "  # between the names of a rival of several effects
SURE = 0.8  # chance from which a motion is called enough


def describe_settling_time(seconds: float, after: float | None, chance: float) -> str:
    """Return how soon and how surely a motion settles its question, in words."""
    chance_text = format_probability(chance)
    end = f"{format_number(seconds)} s with a chance of {chance_text}"
    if after is None:
        return f"settled after {end}"
    return f"settled after {after:.1f} s with a chance of {format_probability(SURE)}, after {end}"


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Diagnosis:
    """What a diagnosis hands to its caller: the verdict, the models and the curves.

    Attributes:
        verdict: The answer.
        models: By name: "nominal", "identified", "augmented", and "plsr" where tables
            were fitted to what remains.
        proofs: One per held-out log.
        clouds: Several per finding, at most one per joint.
        notes: What was understood of the signals (rates, filters, delays, masks).
        residual_clouds: One per unexplained joint: its residual over the variable that
            it depends on most (over time where there is none).
        sentences: One plain sentence per finding, in the order of the findings.
        adoptable: Model to adopt: the augmented one, or the fit of both epochs.
        question: What these logs leave open (`OpenQuestion`), for
            `modelgap next`; None of a comparison.
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
        """Return the unit of what drives a joint (from 1), a torque or a force."""
        for model in self.models.values():
            body = model if hasattr(model, "robot") else model.model
            return "N" if body.robot.prismatic[joint - 1] else "N m"
        return "N m"

    def __repr__(self) -> str:
        return f"Diagnosis({self.verdict})"
