"""The verdict of one set of logs: findings, errors, warnings and notes."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import ndtri

from residual.check.result import LogCheck
from residual.diagnosis.detectable import find_detectable_sizes
from residual.diagnosis.findings import (
    NamedEffect,
    covariance_between_logs,
    joint_numbers,
    rougher_body_prior,
    values_jacobian,
)
from residual.diagnosis.held_out import Proof, classify_gain, describe_unproven_joints
from residual.diagnosis.open_question import list_places
from residual.diagnosis.outcome import Outcome
from residual.diagnosis.rivals import RivalSet
from residual.diagnosis.unexplained import JointRemainder, UnexplainedAnalysis, list_dependences
from residual.effects import load_effects
from residual.effects.base import Effect, EffectTrait, MotionSpan
from residual.errors import format_joint_numbers
from residual.evidence.fit import (
    Fit,
    PossibleModel,
    add_nominal_values,
    invert_scaled,
    select_coefficients,
)
from residual.evidence.priors import compute_inertial_precision, compute_inertial_sd
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import ErrorSums
from residual.model.model import Term, pair_coefficient_slices
from residual.model.nominal import FitLogs
from residual.planning.next_experiment import (
    OpenQuestion,
    mark_inseparable_alternatives,
    predict_best_motion,
)
from residual.quantity import convert_to_plain_values
from residual.recording import Array, Recording
from residual.robot.dynamics import (
    compute_base_parameters,
    compute_inertial_regressor,
    read_inertial_parameters,
)
from residual.signals.track import DRIVEN_EDGE
from residual.verdict.diagnosis import add_motor_class, name_frames, replace_by_model_values
from residual.verdict.result import (
    LOAD,
    MOTION,
    STILL,
    Alternative,
    Change,
    Detectable,
    ErrorTables,
    Evidence,
    Finding,
    Parameter,
    Place,
    Unexplained,
    Verdict,
)


def build_verdict(
    proof: Proof,
    named: Sequence[NamedEffect],
    background: Sequence[NamedEffect],
    suspected: Sequence[NamedEffect],
    bodies: PossibleModel,
    unexplained: UnexplainedAnalysis,
    question: OpenQuestion,
    rivals: Sequence[RivalSet],
    errors: Mapping[str, ErrorSums],
    tables: ErrorTables,
    check: LogCheck | None,
    notes: Sequence[str],
) -> Verdict:
    """Return the verdict as plain values; values that are not finite are None.

    Args:
        named: The findings to be listed, most torque first.
        background: Those that any used arm has.
        suspected: Less certain or refuted names, in no model.
        bodies: The augmented model, and its impossible bodies before correction.
        rivals: Sets that the logs cannot separate from the named one.
        errors: Errors of each model on the held-out logs; `tables` has them as values.
        notes: Warnings on the logs, which come first.
    """
    outcome = proof.outcome
    search, robot = outcome.selection.search, outcome.logs.robot
    unlikely = outcome.impossible or bodies
    contradicted = (*describe_contradictions(outcome, outcome.fit, errors), *unlikely.doubts)
    doubtful = len(outcome.adequacy.doubted) or contradicted
    least = _clear_links(outcome, find_detectable_sizes(search, outcome.fit))

    def listing(some: Sequence[NamedEffect]) -> list[Finding]:
        span = outcome.logs.span
        return [build_finding(f, i, proof, span) for i, f in enumerate(some, 1)]

    return Verdict(
        robot=robot.name,
        declared=tuple(outcome.nominal.names),
        verdict="effects" if named else "unknown" if doubtful else "none",
        effects=tuple(replace_by_model_values(f, bodies) for f in listing(named)),
        minimum_detectable=tuple(least),
        unexplained=_unexplained(outcome, unexplained.joints),
        error=tables,
        nominal_scale=convert_to_plain_values(outcome.selection.scale),
        next_experiment=predict_best_motion(question),
        warnings=(
            *notes,
            *(check.sentences if check else ()),
            *collect_warnings(proof, tables.same_run, outcome.selection.scale),
            *describe_unproven_joints(outcome, errors["augmented"]),
            *unexplained.sentences,
        ),
        log_check=check,
        contradictions=contradicted,
        frames=name_frames(robot),
        changes=compare_nominal_values(outcome, outcome.fit),
        alternatives=mark_inseparable_alternatives(
            question, list_places(outcome.fit.members), list_alternatives(rivals)
        ),
        background=tuple(listing(background)),
        bodies=unlikely.correction,
        suspected=tuple(listing(suspected)),
        too_small=tuple(j + 1 for j in outcome.logs.too_small),
    )


def list_alternatives(rivals: Sequence[RivalSet]) -> tuple[Alternative, ...]:
    """Sets that the logs cannot separate from the named one, as plain values."""
    return tuple(
        Alternative(
            set=tuple(Place(g.effect.name, joint_numbers(g)) for g in rival.members),
            nats=convert_to_plain_values(rival.nats),
            separated_by=LOAD if rival.twin else MOTION,
        )
        for rival in rivals
        if rival.members  # the probability covers whether there is a name at all
    )


def _clear_links(outcome: Outcome, least: list[Detectable]) -> list[Detectable]:
    """Raise the detectable size of a link to four deviations of the URDF's error."""
    prior, model = rougher_body_prior(outcome), outcome.logs.robot.model
    bodies = read_inertial_parameters(model)
    pull = compute_inertial_precision(outcome.logs.robot) @ np.diag(bodies)
    with np.errstate(divide="ignore"):  # a link without mass has no detectable size
        rough = prior.scale / np.sqrt((bodies @ pull).reshape(-1, 10).sum(axis=1))
    out = []
    for d in least:
        if load_effects()[d.name].replaces_link and d.value is not None:
            floor = THRESHOLDS.link_deviations * float(rough[d.joints[0] - 1])
            d = replace(d, value=max(d.value, floor))
        out.append(d)
    return out


def build_finding(named: NamedEffect, order: int, proof: Proof, span: MotionSpan) -> Finding:
    """Return a finding in the form of the verdict."""
    gains = [proof.gains[m] for m in named.tested if m in proof.gains]
    gain = float(np.mean(gains)) if gains else None
    splits = [m.splits for m in named.tested]
    parameters = {}
    for key, (values, stds, unit, clear) in named.parameters.items():
        row, std = (tuple(convert_to_plain_values(values)), tuple(convert_to_plain_values(stds)))
        if len(named.tested) == 1:
            row, std = row[0], std[0]
        parameters[key] = Parameter(row, std, unit, clear)
    return Finding(
        name=named.effect.name,
        joints=named.joints,
        probability=convert_to_plain_values(named.probability),
        order=order,
        equivalent=add_motor_class(
            Place(named.effect.name, named.joints),
            [Place(*other) for other in named.equivalent],
            span,
        ),
        parameters=parameters,
        combinations={
            key: Parameter(convert_to_plain_values(value), convert_to_plain_values(std), unit)
            for key, (value, std, unit) in named.combined.items()
        },
        evidence=Evidence(
            nats=convert_to_plain_values(named.nats),
            by="fit" if any(t.by == "fit" for t in named.tested) else "plausibility",
            held_out="neutral" if gain is None else classify_gain(gain),
            held_out_gain=None if gain is None else convert_to_plain_values(gain),
            splits=min(splits, key=lambda s: s.found),
        ),
    )


def _unexplained(outcome: Outcome, leftovers: Sequence[JointRemainder]) -> Unexplained:
    a, design, logs = outcome.adequacy, outcome.design, outcome.logs
    power = design.rows * design.rms**2
    weight = power / power.sum()
    kinds = [one.kind for one in leftovers if one.kind]
    alike = len(set(logs.robot.prismatic)) == 1
    per_joint = a.structured_share.copy()
    per_joint[list(logs.too_small)] = np.nan
    return Unexplained(
        joints=tuple(int(j) + 1 for j in a.doubted),
        fraction=convert_to_plain_values(np.sqrt(weight @ a.structured_share**2))
        if alike
        else None,
        noise_floor=convert_to_plain_values(np.sqrt(weight @ a.noise**2)) if alike else None,
        depends_on=list_dependences(leftovers),
        kind=max(sorted(set(kinds)), key=kinds.count) if kinds else None,
        per_joint=tuple(convert_to_plain_values(per_joint)),
        noise_model="autocorrelation",
    )


USED_WHOLE = 0.95  # share of the duration of the logs: all except the ends
PLACES = 20  # positions at which the inertia is evaluated


# Impossible refits: friction that drives, or negative inertia.
#
# Both are sums over the motion, linear in the coefficients, so their standard deviation
# follows from the fit's covariance, and only significant ones are reported.


def describe_contradictions(
    outcome: Outcome, fitted: Fit, errors: dict[str, ErrorSums]
) -> tuple[str, ...]:
    """Return the physical contradictions of a fit, a sentence each."""
    if not outcome.design.fold_rows.any():
        return (STILL,)
    friction, inertia = (_driving_friction(outcome, fitted), _negative_inertia(outcome, fitted))
    out = []
    if friction:
        out.append(
            f"the fitted friction of {format_joint_numbers(friction)} drives the "
            f"arm: check "
            "the sign of the torque"
        )
    if inertia:
        out.append(
            f"the fitted inertia of {format_joint_numbers(inertia)} is negative: "
            f"check signs, "
            "units and the order of the joints"
        )
    before, after = (errors[k].overall("moving") for k in ("nominal", "identified"))
    if after > THRESHOLDS.refit_error_ratio * before:
        out.append(
            "the refit predicts held-out motion worse than the nominal model "
            f"({after:.1f} % against {before:.1f} % while moving): these logs do not "
            "determine its parameters"
        )
    return tuple(out)


def _driving_friction(outcome: Outcome, fitted: Fit) -> list[int]:
    """Joints (from 1) on which the fitted friction drives the motion."""
    design, covariance = outcome.design, fitted.covariance()
    theta, out = add_nominal_values(outcome.nominal.model, fitted), []
    brakes = select_coefficients(
        outcome.nominal.model, fitted, lambda e, on: EffectTrait.FRICTION in e.traits
    )
    speeds = design.stacked([t.qd[:: t.step] for t in outcome.logs.tracks])
    for j, speed in enumerate(speeds):
        place, have = design.present(j, fitted.ids)
        friction = brakes[have]
        along = np.zeros(len(theta))
        along[have[friction]] = design.columns(j, place[friction]).T @ speed
        power, sd = along @ theta, np.sqrt(max(along @ covariance @ along, 0.0))
        moved = np.abs(speed) @ np.abs(design.tau[j])
        if (
            power < -THRESHOLDS.impossible_deviations * sd
            and power < -THRESHOLDS.min_driving_power * moved
        ):
            out.append(j + 1)
    return out


def _negative_inertia(outcome: Outcome, fitted: Fit) -> list[int]:
    """Joints (from 1) whose fitted inertia is negative on average."""
    design, covariance = outcome.design, fitted.covariance()
    theta, model = (add_nominal_values(outcome.nominal.model, fitted), outcome.logs.robot.model)
    q = np.concatenate([t.q for t in outcome.logs.tracks])
    q = q[:: max(1, len(q) // PLACES)]
    zero, out = np.zeros_like(q), []
    resting = compute_inertial_regressor(model, q, zero, zero)
    for j in range(design.dof):
        push = zero.copy()
        push[:, j] = 1.0
        rows = compute_inertial_regressor(model, q, zero, push)[:, j] - resting[:, j]
        rotors = select_coefficients(
            outcome.nominal.model,
            fitted,
            lambda e, on, j=j: e.carries == "acceleration" and on == (j,),
        )
        along = rotors.astype(float)
        along[: rows.shape[1]] = rows.mean(axis=0)
        inertia, sd = along @ theta, np.sqrt(max(along @ covariance @ along, 0.0))
        if inertia < -THRESHOLDS.impossible_deviations * sd and inertia < 0:
            out.append(j + 1)
    return out


def collect_warnings(proof: Proof, same_run: bool, scale: float = 0.0) -> list[str]:
    """Return warnings on the verdict: a weak test, a rough model, refuted names.

    Args:
        same_run: Whether the held-out logs are part of a fit log.
        scale: Relative error of the given bodies, if the search estimated it.
    """
    out = []
    if same_run:
        out.append(
            "no --holdout given: the last quarter of the longest log was held out; "
            "the proof is weak: it is the same run"
        )
    if scale > THRESHOLDS.rough_scale:
        off = "100 % or more" if scale >= 1 else f"about {100 * scale:.0f} %"
        out.append(
            f"the inertias of the nominal model are off by {off}: too rough to name a "
            "wrong body of the arm; give --baseline"
        )
    for member in proof.refuted:
        joints = [j + 1 for j in member.group.joints]
        place = f" on {format_joint_numbers(joints)}" if joints else ""
        rise = -100 * proof.gains[member]
        out.append(
            f"{member.group.effect.name}{place}: refuted by the held-out logs (error "
            f"there {rise:.1f} % higher with it); suspected, and in no model"
        )
    return list(dict.fromkeys(out))


def describe_used_part(logs: FitLogs, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the used share of long logs; empty if all is used."""
    used, logged = sum(t.seconds for t in logs.tracks), sum(r.duration for r in recordings)
    if used > USED_WHOLE * logged:
        return ()
    return (f"long logs: {used:.0f} of {logged:.0f} s, evenly spread, are used",)


def describe_signals(outcome: Outcome) -> tuple[str, ...]:
    """Return notes on the signals: filter and rows."""
    logs = outcome.logs
    rows = outcome.design.rows
    every = sum(int(t.valid.sum()) for t in logs.tracks)
    edge = DRIVEN_EDGE if logs.span.one_drive else logs.filters.edge
    notes = [
        f"identification filter {min(t.cutoff for t in logs.tracks):g} Hz, zero phase, "
        "on torque and regressor alike; "
        f"{edge:g} s dropped at both ends",
        "moving rows used per joint: "
        + ", ".join(f"{100 * r / max(every, 1):.0f} %" for r in rows),
    ]
    if logs.clock is None:
        notes.append("the order of the logs in time is not known: warm-up not tested")
    return tuple(notes)


# The nominal values compared with the logs.
#
# Each value is estimated without its own prior, while the others keep the accuracy found
# for their kind: the result is the information of the logs alone. With V0 and V1 its
# covariance before and after, and m1 its mean,
#
#     information = V1^-1 - V0^-1,    mean = information^-1 V1^-1 m1.


LOOSE = 1e-4  # of the prior's information: kept to avoid infinite values
BODY = "inertial"


@dataclass(frozen=True, eq=False, slots=True)
class _Values:
    """Values that are compared together: those of one joint, or one of the body."""

    # (name, joints from 1, parameter, unit) of each.
    names: tuple[tuple[str, tuple[int, ...], str, str], ...]
    nominal: Array  # their nominal values, (k,)
    size: Array  # reference of the 5 %, (k,)
    slope: Array  # their derivative to the coefficients of the nominal model, (k, p)
    # The same for all coefficients of the fit, related findings included, (k, m).
    added: Array


def compare_nominal_values(outcome: Outcome, fitted: Fit) -> tuple[Change, ...]:
    """Return every nominal value, with the value from the logs."""
    groups = [*_drive_values(outcome, fitted), *_body_values(outcome, fitted)]
    count = sum(len(a.names) for a in groups)
    if not count:
        return ()
    sure = -float(ndtri(THRESHOLDS.value_change_chance / count / 2))
    state = _Covariances.of(outcome, fitted)
    return tuple(c for a in groups for c in _value_changes(state, a, sure))


@dataclass(frozen=True, eq=False, slots=True)
class _Covariances:
    """Covariances before and after the logs, and between logs. Each (m, m)."""

    theta: Array
    before: Array
    after: Array
    between: Array

    @classmethod
    def of(cls, outcome: Outcome, fitted: Fit) -> "_Covariances":
        design = outcome.design
        before = np.zeros((len(fitted.ids), len(fitted.ids)))
        p = len(design.nominal)
        before[:p, :p] = invert_scaled(outcome.prior.precision)
        for g in fitted.members:
            at = fitted.slots(g)
            before[np.ix_(at, at)] = invert_scaled(g.precision)
        return cls(
            fitted.theta, before, fitted.covariance(), covariance_between_logs(design, fitted)
        )


def _value_changes(state: _Covariances, values: _Values, sure: float) -> Iterator[Change]:
    a, p = values.added, values.slope.shape[1]
    after = invert_scaled(a @ state.after @ a.T)
    prior = a @ state.before @ a.T
    information = _positive_information(after - invert_scaled(prior), prior)
    covariance = np.linalg.inv(information)
    gap = covariance @ (after @ (a @ state.theta))
    # Disagreeing logs shift a value with a prior less than a free one.
    freed = covariance @ after
    variance = np.diag(covariance + freed @ (a @ state.between @ a.T) @ freed.T)
    refit_gap = values.slope @ state.theta[:p]  # the share of the gap that no finding explains
    for i, (name, joints, parameter, unit) in enumerate(values.names):
        sd = float(np.sqrt(variance[i]))
        least = max(THRESHOLDS.min_value_change * values.size[i], sure * sd)
        yield Change(
            name=name,
            joints=joints,
            parameter=parameter,
            nominal=convert_to_plain_values(values.nominal[i]),
            identified=convert_to_plain_values(values.nominal[i] + gap[i]),
            std=convert_to_plain_values(sd),
            unit=unit,
            sigma=convert_to_plain_values(gap[i] / sd),
            beyond=bool(abs(gap[i]) > least),
            explained=bool(a[i, p:].any() and abs(refit_gap[i]) < least),
        )


def _drive_values(outcome: Outcome, fitted: Fit) -> list[_Values]:
    """Declared values, grouped by joints."""
    nominal = outcome.nominal
    terms, given = zip(*nominal.declared, strict=True) if nominal.declared else ((), ())
    placed = pair_coefficient_slices(terms, len(nominal.model.inertial))
    together: dict[tuple, list] = {}
    for (term, own), width in zip(placed, given, strict=True):
        if width is not None:
            together.setdefault(term.joints, []).append((term, own))
    robot = outcome.logs.robot
    return [_joint_values(robot, fitted, terms) for terms in together.values()]


def _joint_values(robot, fitted: Fit, terms: list[tuple[Term, slice]]) -> _Values:
    names, nominal, rows, count = [], [], [], len(fitted.ids)
    for term, slots in terms:
        effect = term.effect
        values = np.asarray(effect.values(term.theta, term.shape, robot), dtype=float)
        jacobian = values_jacobian(effect, term.theta, term.shape, robot)
        finding_slots = _findings_of(fitted, effect, term)
        for i, (key, unit) in enumerate(effect.units(term.joints, robot).items()):
            if not jacobian[i].any():
                continue  # of the shape, which is not refitted
            row = np.zeros(count)
            row[slots] = jacobian[i]
            for more in finding_slots:
                row[more] = jacobian[i]
            joints = tuple(j + 1 for j in term.joints)
            names.append((effect.name, joints, key, unit))
            nominal.append(values[i])
            rows.append(row)
    added = np.array(rows)
    slope = _without_findings(added, fitted)
    nominal = np.array(nominal)
    return _Values(tuple(names), nominal, np.abs(nominal), slope, added)


def _findings_of(fitted: Fit, effect: Effect, term: Term) -> list[Array]:
    return [
        fitted.slots(g)
        for g in fitted.members
        if g.effect.name == effect.name and g.joints == term.joints and g.shape == term.shape
    ]


def _body_values(outcome: Outcome, fitted: Fit) -> list[_Values]:
    """Identifiable base parameters of the arm's bodies, one by one."""
    robot = outcome.logs.robot
    base = compute_base_parameters(robot.model)
    inertial = outcome.nominal.model.inertial
    size = np.sqrt(base.mapping**2 @ compute_inertial_sd(robot) ** 2)
    added = np.zeros((len(base), len(fitted.ids)))
    added[:, : len(inertial)] = base.mapping
    for g in fitted.members:
        if (bodies := g.effect.portable.bodies) is not None and not g.parts:
            ways = [bodies(u, g.joints, robot) for u in np.eye(len(g.ids))]
            added[:, fitted.slots(g)] = base.mapping @ np.array(ways).T
    slope = _without_findings(added, fitted)
    nominal = base.mapping @ inertial
    return [
        _Values(
            ((BODY, (one.joint,), base.words(i), one.unit),),
            nominal[i : i + 1],
            np.maximum(np.abs(nominal[i : i + 1]), size[i]),
            slope[i : i + 1],
            added[i : i + 1],
        )
        for i, one in enumerate(base.leading)
    ]


def _without_findings(added: Array, fitted: Fit) -> Array:
    members = sum(len(g.ids) for g in fitted.members)
    return added[:, : len(fitted.ids) - members]


def _positive_information(information: Array, prior: Array) -> Array:
    """Information of the logs, floored at a ten thousandth of the prior's."""
    size = np.sqrt(np.diag(prior))
    values, vectors = np.linalg.eigh(information * np.outer(size, size))
    kept = (vectors * np.maximum(values, LOOSE)) @ vectors.T
    return kept / np.outer(size, size)
