"""From what was found to the verdict: findings, errors and what is left, as one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from residual.diagnosis.angle_noise import doubtful
from residual.diagnosis.changes import changes
from residual.diagnosis.detectable import minimum_detectable, neighbours
from residual.diagnosis.examine import Examined
from residual.diagnosis.findings import Named, public_joints
from residual.diagnosis.gate import Tested
from residual.diagnosis.held_out import Splits, Verdicts, judgement
from residual.diagnosis.neighbours import rivals
from residual.diagnosis.result import (
    LOAD,
    MOTION,
    PLAIN,
    STAGES,
    Alternative,
    Detectable,
    ErrorTables,
    Evidence,
    Finding,
    Frames,
    Number,
    Parameter,
    Place,
    Unexplained,
    Verdict,
)
from residual.diagnosis.unexplained import Leftover, depends_on
from residual.effects import registry
from residual.evidence.embodied import Embodied
from residual.evidence.priors import Space, inertial_precision
from residual.evidence.rules import RULES
from residual.model.compare import Errors
from residual.quantity import plain
from residual.recording import Array
from residual.robot.dynamics import inertial_parameters

METRIC = "100*||tau-tau_hat||/||tau||"


@dataclass(frozen=True, eq=False, slots=True)
class Case:
    """All that a verdict is made of."""

    examined: Examined  # what the fit logs say
    named: Sequence[Named]  # the findings to be listed, most torque first
    judged: Verdicts  # what the held-out logs say of each tested member
    errors: Mapping[str, Errors]  # errors of each model on the held-out logs
    held_out: Sequence[str]  # labels of the held-out logs
    same_run: bool  # whether they are a part of a fit log
    left: Sequence[Leftover]  # what is known of each unexplained joint
    warnings: Sequence[str]  # sentences
    splits: Mapping[Tested, Splits]  # how often each tested member was found again
    bodies: Embodied  # the augmented model, and what of it no body could be
    contradictions: Sequence[str] = ()  # what of the fit no arm can be, in sentences
    # Joints from 1 that the findings make worse beyond chance.
    worse: Sequence[int] = ()
    folded: Sequence[Named] = ()  # those that any used arm has
    suspected: Sequence[Named] = ()  # those that are not sure enough to be listed
    gains: Mapping[Tested, float] = field(default_factory=dict)  # of these, held out


def conclude(case: Case) -> Verdict:
    """Return the verdict, of plain values: what is not finite is None."""
    examined = case.examined
    task = examined.task
    every = neighbours(Space(task.design, examined.nominal), task.prior)
    doubtful = len(examined.adequacy.doubted) or case.contradictions
    nothing = "unknown" if doubtful else "none"
    least = minimum_detectable(task, case.judged.fit, every)
    least = _clear_links(examined, least)
    return Verdict(
        robot=examined.logs.robot.name,
        declared=tuple(examined.nominal.names),
        verdict="effects" if case.named else nothing,
        effects=tuple(
            as_embodied(_finding(f, i, case), case.bodies)
            for i, f in enumerate(case.named, 1)
        ),
        minimum_detectable=tuple(least),
        unexplained=_unexplained(case),
        error=_errors(case),
        nominal_scale=plain(examined.task.prior.scale),
        next_experiment=None,
        warnings=tuple(case.warnings),
        contradictions=tuple(case.contradictions),
        frames=Frames.of(examined.logs.robot),
        changes=changes(examined, case.judged.fit),
        alternatives=_alternatives(case, least),
        background=tuple(_finding(f, i, case) for i, f in enumerate(case.folded, 1)),
        bodies=case.bodies.moved,
        suspected=tuple(_finding(f, i, case) for i, f in enumerate(case.suspected, 1)),
        too_small=tuple(j + 1 for j in examined.logs.too_small),
    )


def _clear_links(examined: Examined, least: list[Detectable]) -> list[Detectable]:
    """Of a link at least what its description may be off by, four times."""
    prior = doubtful(examined)
    bodies = inertial_parameters(examined.logs.robot.model)
    pull = inertial_precision(examined.logs.robot) @ np.diag(bodies)
    with np.errstate(divide="ignore"):  # of a link without mass nothing is known
        rough = prior.scale / np.sqrt((bodies @ pull).reshape(-1, 10).sum(axis=1))
    return [
        replace(
            d, value=max(d.value, RULES.sure_of_link * float(rough[d.joints[0] - 1]))
        )
        if registry()[d.name].of_link and d.value is not None
        else d
        for d in least
    ]


def _alternatives(case: Case, least: Sequence[Detectable]) -> tuple[Alternative, ...]:
    found = rivals(case.examined.task, case.judged.fit, least)
    return tuple(
        Alternative(
            set=tuple(Place(g.effect.name, public_joints(g)) for g in one.members),
            nats=plain(one.nats),
            separated_by=LOAD if one.twin else MOTION,
        )
        for one in found
    )


def _finding(named: Named, order: int, case: Case) -> Finding:
    single = len(named.tested) == 1
    gains = {**case.gains, **dict(case.judged.kept)}
    gain = float(np.mean([gains[t] for t in named.tested]))
    fits = [t for t in named.tested if t.by == "fit"]
    parameters = {
        key: Parameter(
            *(v[0] if single else v for v in (_row(value), _row(std))), unit, clear
        )
        for key, (value, std, unit, clear) in named.parameters.items()
    }
    return Finding(
        name=named.effect.name,
        joints=named.joints,
        probability=plain(named.probability),
        order=order,
        equivalent=tuple(Place(*other) for other in named.equivalent),
        parameters=parameters,
        combinations={
            key: Parameter(plain(value), plain(std), unit)
            for key, (value, std, unit) in named.combined.items()
        },
        evidence=Evidence(
            nats=plain(named.nats),
            by="fit" if fits else "plausibility",
            held_out=judgement(gain),
            held_out_gain=plain(gain),
            splits=min((case.splits[t] for t in named.tested), key=lambda s: s.found),
        ),
    )


def as_embodied(found: Finding, made: Embodied) -> Finding:
    """A finding with the values of the model, where no body could be as fitted freely.

    The deviations stay: the true body is one that can be, and the nearest of those is
    no farther from it than the fit was.
    """
    effect, joints = registry()[found.name], tuple(j - 1 for j in found.joints)
    if made.moved is None or effect.portable.bodies is None:
        return found
    terms = made.model.terms  # what was found stands behind what the model had
    place = found.name, joints
    (*_, own) = (t for t in terms if (t.effect.name, t.joints) == place)
    robot = made.model.robot
    values = effect.values(own.theta, own.shape, robot)
    known = dict(zip(effect.parameters, values, strict=True))
    if effect.combined is not None:
        sums = effect.combined(own.theta, robot)
        known |= {key: value for key, (value, _) in sums.items()}

    def moved(told: Mapping[str, Parameter]) -> dict[str, Parameter]:
        return {k: replace(p, value=plain(known[k])) for k, p in told.items()}

    return replace(
        found,
        parameters=moved(found.parameters),
        combinations=moved(found.combinations),
    )


def _unexplained(case: Case) -> Unexplained:
    a, design = case.examined.adequacy, case.examined.task.design
    power = design.rows * design.rms**2
    weight = power / power.sum()
    kinds = [one.kind for one in case.left if one.kind]
    alike = len(set(case.examined.logs.robot.prismatic)) == 1
    return Unexplained(
        joints=tuple(int(j) + 1 for j in a.doubted),
        fraction=plain(np.sqrt(weight @ a.structured**2)) if alike else None,
        noise_floor=plain(np.sqrt(weight @ a.noise**2)) if alike else None,
        depends_on=depends_on(case.left),
        kind=max(sorted(set(kinds)), key=kinds.count) if kinds else None,
        per_joint=_row(_but(a.structured, case.examined.logs.too_small)),
        noise_model="autocorrelation",
    )


def _but(values: Array, joints: Sequence[int]) -> Array:
    """Values of the joints, NaN on some (from 0)."""
    out = values.copy()
    out[list(joints)] = np.nan
    return out


def _errors(case: Case) -> ErrorTables:
    return error_tables(
        {name: case.errors.get(name) for name in (*STAGES, PLAIN)},
        min(t.cutoff for t in case.examined.logs.tracks),
        case.held_out,
        case.same_run,
        case.worse,
    )


def error_tables(
    errors: Mapping[str, Errors | None],
    cutoff: float,
    logs: Sequence[str],
    same_run: bool = False,
    worse: Sequence[int] = (),
) -> ErrorTables:
    """Return the errors of several models as plain values [%].

    Args:
        errors: By name of the model; None for a model that is not there.
        cutoff: Of the identification filter [Hz].
        worse: Joints from 1 that the findings make worse beyond chance.
    """

    def overall(kind: str) -> dict:
        return {
            s: plain(e.overall(kind)) if e and e.alike else None
            for s, e in errors.items()
        }

    def per_joint(kind: str) -> dict:
        return {s: _per_joint(e, kind) for s, e in errors.items()}

    return ErrorTables(
        metric=METRIC,
        cutoff_hz=cutoff,
        logs=tuple(logs),
        same_run=same_run,
        held_out=per_joint("raw"),
        filtered=per_joint("filtered"),
        moving=per_joint("moving"),
        overall=overall("raw"),
        overall_filtered=overall("filtered"),
        overall_moving=overall("moving"),
        worse=tuple(worse),
    )


def _per_joint(errors: Errors | None, kind: str) -> tuple[Number, ...] | None:
    """Errors of every joint; None where there are none, or no such model."""
    values = None if errors is None else errors.per_joint(kind)
    return None if values is None or np.isnan(values).all() else _row(values)


def _row(values: Sequence[float]) -> tuple[Number, ...]:
    return tuple(plain(np.asarray(values)))
