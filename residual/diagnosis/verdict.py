"""The verdict of one set of logs: findings, errors, warnings and notes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from residual.check.result import LogCheck
from residual.diagnosis.detectable import minimum_detectable
from residual.diagnosis.doubts import DoubtResult, Withdrawal
from residual.diagnosis.findings import NamedEffect, public_joints
from residual.diagnosis.gate import GateResult
from residual.diagnosis.held_out import describe_gain, describe_unproven
from residual.diagnosis.neighbours import rivals
from residual.diagnosis.open_question import places_of
from residual.diagnosis.outcome import SearchOutcome
from residual.diagnosis.select import neighbor_priors
from residual.diagnosis.uncertainty import doubtful
from residual.diagnosis.unexplained import JointLeftover, LeftoverAnalysis, depends_on
from residual.diagnosis.values import compare_values
from residual.effects import registry
from residual.effects.base import Trait
from residual.errors import joints_listed
from residual.evidence.fit import Fit, PossibleModel
from residual.evidence.priors import PriorSpace, inertial_precision
from residual.evidence.thresholds import THRESHOLDS
from residual.model.compare import Errors
from residual.planning.promise import promised, settled_by
from residual.planning.question import Question
from residual.quantity import plain
from residual.recording import Array
from residual.robot.dynamics import inertial_parameters, regressor
from residual.verdict.result import (
    LOAD,
    MOTION,
    STILL,
    Alternative,
    Detectable,
    ErrorTables,
    Evidence,
    Finding,
    Frames,
    Parameter,
    Place,
    Unexplained,
    Verdict,
    with_model_values,
)


def conclude(
    standing: DoubtResult,
    named: Sequence[NamedEffect],
    background: Sequence[NamedEffect],
    bodies: PossibleModel,
    remains: LeftoverAnalysis,
    question: Question,
    errors: Mapping[str, Errors],
    tables: ErrorTables,
    check: LogCheck | None,
    logged: Sequence[str],
) -> Verdict:
    """Return the verdict, of plain values: what is not finite is None.

    Args:
        named: The findings to be listed, most torque first; none where a fault of the
            logs is certain.
        background: Those that any used arm has.
        bodies: The augmented model, and what of it no body could be.
        errors: Errors of each model on the held-out logs; `tables` has them as values.
        logged: Warnings on the logs, which come first.
    """
    outcome, validation = standing.outcome, standing.validation
    task, robot = outcome.task, outcome.logs.robot
    faulty = check is not None and bool(check.certain)
    contradicted = (*contradictions(outcome, validation.fit, errors), *bodies.doubts)
    doubtful = len(outcome.adequacy.doubted) or contradicted or faulty
    every = neighbor_priors(PriorSpace(task.design, outcome.nominal), task.prior)
    least = _clear_links(outcome, minimum_detectable(task, validation.fit, every))
    alternatives = tuple(
        Alternative(
            set=tuple(Place(g.effect.name, public_joints(g)) for g in rival.members),
            nats=plain(rival.nats),
            separated_by=LOAD if rival.twin else MOTION,
        )
        for rival in rivals(task, validation.fit, least)
    )

    def listing(some: Sequence[NamedEffect]) -> list[Finding]:
        return [_finding(f, i, standing) for i, f in enumerate(some, 1)]

    return Verdict(
        robot=robot.name,
        declared=tuple(outcome.nominal.names),
        verdict="effects" if named else "unknown" if doubtful else "none",
        effects=tuple(with_model_values(f, bodies) for f in listing(named)),
        minimum_detectable=() if faulty else tuple(least),
        unexplained=_unexplained(outcome, remains.joints),
        error=tables,
        nominal_scale=plain(task.prior.scale),
        next_experiment=None if faulty else promised(question),
        warnings=(
            *logged,
            *(check.sentences if check else ()),
            *warnings(outcome, standing.withdrawn, tables.same_run),
            *describe_unproven(outcome, errors["augmented"]),
            *remains.sentences,
        ),
        log_check=check,
        contradictions=contradicted,
        frames=Frames.of(robot),
        changes=compare_values(outcome, validation.fit),
        alternatives=settled_by(
            question, places_of(validation.fit.members), alternatives
        ),
        background=tuple(listing(background)),
        bodies=bodies.correction,
        suspected=() if faulty else tuple(listing(standing.suspected)),
        too_small=tuple(j + 1 for j in outcome.logs.too_small),
    )


def _clear_links(outcome: SearchOutcome, least: list[Detectable]) -> list[Detectable]:
    """Raise the detectable size of a link to four deviations of the URDF's error."""
    prior, model = doubtful(outcome), outcome.logs.robot.model
    bodies = inertial_parameters(model)
    pull = inertial_precision(outcome.logs.robot) @ np.diag(bodies)
    with np.errstate(divide="ignore"):  # of a link without mass nothing is known
        rough = prior.scale / np.sqrt((bodies @ pull).reshape(-1, 10).sum(axis=1))
    out = []
    for d in least:
        if registry()[d.name].of_link and d.value is not None:
            floor = THRESHOLDS.link_deviations * float(rough[d.joints[0] - 1])
            d = replace(d, value=max(d.value, floor))
        out.append(d)
    return out


def _finding(named: NamedEffect, order: int, standing: DoubtResult) -> Finding:
    gains = {**standing.gains, **dict(standing.validation.kept)}
    gain = float(np.mean([gains[t] for t in named.tested]))
    splits = [standing.splits[t] for t in named.tested]
    parameters = {}
    for key, (values, stds, unit, clear) in named.parameters.items():
        row, std = tuple(plain(values)), tuple(plain(stds))
        if len(named.tested) == 1:
            row, std = row[0], std[0]
        parameters[key] = Parameter(row, std, unit, clear)
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
            by="fit" if any(t.by == "fit" for t in named.tested) else "plausibility",
            held_out=describe_gain(gain),
            held_out_gain=plain(gain),
            splits=min(splits, key=lambda s: s.found),
        ),
    )


def _unexplained(
    outcome: SearchOutcome, leftovers: Sequence[JointLeftover]
) -> Unexplained:
    a, design, logs = outcome.adequacy, outcome.task.design, outcome.logs
    power = design.rows * design.rms**2
    weight = power / power.sum()
    kinds = [one.kind for one in leftovers if one.kind]
    alike = len(set(logs.robot.prismatic)) == 1
    per_joint = a.structured.copy()
    per_joint[list(logs.too_small)] = np.nan
    return Unexplained(
        joints=tuple(int(j) + 1 for j in a.doubted),
        fraction=plain(np.sqrt(weight @ a.structured**2)) if alike else None,
        noise_floor=plain(np.sqrt(weight @ a.noise**2)) if alike else None,
        depends_on=depends_on(leftovers),
        kind=max(sorted(set(kinds)), key=kinds.count) if kinds else None,
        per_joint=tuple(plain(per_joint)),
        noise_model="autocorrelation",
    )


PLACES = 20  # positions at which the inertia is looked at


# What no arm can be: a refit whose friction drives, or whose inertia is negative.
#
# Both are sums over the motion that are linear in the coefficients, so their standard
# deviation follows from the fit's covariance: nothing is called impossible by chance.


def contradictions(
    outcome: SearchOutcome, fitted: Fit, errors: dict[str, Errors]
) -> tuple[str, ...]:
    """Return in sentences what of a fit no arm can be; empty where nothing is."""
    if not outcome.task.design.fold_rows.any():
        return (STILL,)
    friction, inertia = (
        _driving_friction(outcome, fitted),
        _negative_inertia(outcome, fitted),
    )
    out = []
    if friction:
        out.append(
            f"the fitted friction of {joints_listed(friction)} drives the arm: check "
            "the sign of the torque"
        )
    if inertia:
        out.append(
            f"the fitted inertia of {joints_listed(inertia)} is negative: check signs, "
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


def _driving_friction(outcome: SearchOutcome, fitted: Fit) -> list[int]:
    """Joints (from 1) on which the fitted friction drives the motion."""
    design, covariance = outcome.task.design, fitted.covariance()
    theta, out = _absolute_coefficients(outcome, fitted), []
    brakes = _select_slots(outcome, fitted, lambda e, on: Trait.FRICTION in e.traits)
    speeds = design.stacked([t.qd[:: t.step] for t in outcome.logs.sketch])
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


def _negative_inertia(outcome: SearchOutcome, fitted: Fit) -> list[int]:
    """Joints (from 1) whose fitted inertia is negative on average."""
    design, covariance = outcome.task.design, fitted.covariance()
    theta, model = _absolute_coefficients(outcome, fitted), outcome.logs.robot.model
    q = np.concatenate([t.q for t in outcome.logs.tracks])
    q = q[:: max(1, len(q) // PLACES)]
    zero, out = np.zeros_like(q), []
    resting = regressor(model, q, zero, zero)
    for j in range(design.dof):
        push = zero.copy()
        push[:, j] = 1.0
        rows = regressor(model, q, zero, push)[:, j] - resting[:, j]
        rotors = _select_slots(
            outcome,
            fitted,
            lambda e, on, j=j: e.carries == "acceleration" and on == (j,),
        )
        along = rotors.astype(float)
        along[: rows.shape[1]] = rows.mean(axis=0)
        inertia, sd = along @ theta, np.sqrt(max(along @ covariance @ along, 0.0))
        if inertia < -THRESHOLDS.impossible_deviations * sd and inertia < 0:
            out.append(j + 1)
    return out


def _absolute_coefficients(outcome: SearchOutcome, fitted: Fit) -> Array:
    """The fit's coefficients, nominal values added. Shape (m,)."""
    theta = fitted.theta.copy()
    base = outcome.nominal.model.coefficients()
    theta[: len(base)] += base
    return theta


def _select_slots(outcome: SearchOutcome, fitted: Fit, selects: Callable) -> Array:
    """Mask of the coefficients of the selected effects. Shape (m,)."""
    model = outcome.nominal.model
    marks = [np.zeros(len(model.inertial), dtype=bool)]
    for part in (*model.terms, *fitted.members):
        count = len(part.theta) if hasattr(part, "theta") else len(part.ids)
        marks.append(np.full(count, bool(selects(part.effect, part.joints))))
    return np.concatenate(marks)


def warnings(
    outcome: SearchOutcome, withdrawn: Sequence[Withdrawal], same_run: bool
) -> list[str]:
    """Return what qualifies the answer: a weak proof, a rough model, names withdrawn.

    Args:
        withdrawn: Names that did not stand.
        same_run: Whether the held-out logs are a part of a fit log.
    """
    out = []
    if same_run:
        out.append(
            "no --holdout given: the last quarter of the longest log was held out; "
            "the proof is weak: it is the same run"
        )
    scale = outcome.task.prior.scale
    if scale > THRESHOLDS.rough_scale:
        off = "100 % or more" if scale >= 1 else f"about {100 * scale:.0f} %"
        out.append(
            f"the inertias of the nominal model are off by {off}: too rough to name a "
            "wrong body of the arm; give --baseline"
        )
    out += [describe_withdrawal(w.tested, w.why) for w in withdrawn]
    return list(dict.fromkeys(out))  # two ripples of a joint make one sentence


def describe_withdrawal(tested: GateResult, why: str) -> str:
    """A warning about a name that did not stand: 'ripple on joint 3: why'."""
    joints = [j + 1 for j in tested.group.joints]
    place = f" on {joints_listed(joints)}" if joints else ""
    return f"{tested.group.effect.name}{place}: {why}"


def signal_notes(outcome: SearchOutcome) -> tuple[str, ...]:
    """Return what was understood of the signals: filter and rows."""
    logs = outcome.logs
    rows = outcome.task.design.rows
    every = sum(int(t.inner.sum()) for t in logs.tracks)
    notes = [
        f"identification filter {min(t.cutoff for t in logs.tracks):g} Hz, zero phase, "
        "on torque and regressor alike; "
        f"{logs.filters.edge:g} s dropped at both ends",
        "moving rows used per joint: "
        + ", ".join(f"{100 * r / max(every, 1):.0f} %" for r in rows),
    ]
    if logs.clock is None:
        notes.append("the order of the logs in time is not known: warm-up not tested")
    return tuple(notes)
