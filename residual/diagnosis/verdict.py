"""The verdict of one set of logs: findings, errors, warnings and notes."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from residual.diagnosis.detectable import minimum_detectable
from residual.diagnosis.doubts import Withdrawn
from residual.diagnosis.findings import Named, public_joints
from residual.diagnosis.gate import Tested
from residual.diagnosis.held_out import Splits, Verdicts, judgement
from residual.diagnosis.neighbours import rivals
from residual.diagnosis.outcome import Examined
from residual.diagnosis.select import neighbours
from residual.diagnosis.uncertainty import doubtful
from residual.diagnosis.unexplained import Leftover, depends_on
from residual.diagnosis.values import changes
from residual.effects import registry
from residual.effects.base import Trait
from residual.errors import joints_listed, listed
from residual.evidence.embodied import Embodied
from residual.evidence.fit import Fit
from residual.evidence.priors import Space, inertial_precision
from residual.evidence.rules import RULES
from residual.model.compare import Errors
from residual.model.model import Model
from residual.model.nominal import (
    Logs,
)
from residual.quantity import plain
from residual.recording import Array, Recording
from residual.robot.dynamics import inertial_parameters, regressor
from residual.signals.filters import low_pass, power_density
from residual.signals.splitting import in_pieces, let_go
from residual.signals.track import sample_rate
from residual.verdict.document import from_json, to_json  # noqa: F401
from residual.verdict.result import (
    LOAD,
    MOTION,
    PLAIN,
    STAGES,
    STILL,
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
    as_embodied,
    error_tables,
)


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


def _row(values: Sequence[float]) -> tuple[Number, ...]:
    return tuple(plain(np.asarray(values)))


PLACES = 20  # positions at which the inertia is looked at


# What no arm can be: a refit whose friction drives, or whose inertia is negative.
#
# Both are sums over the motion that are linear in the coefficients, so their standard
# deviation follows from the fit's covariance: nothing is called impossible by chance.


def contradictions(
    examined: Examined, fitted: Fit, errors: dict[str, Errors]
) -> tuple[str, ...]:
    """Return in sentences what of a fit no arm can be; empty where nothing is."""
    if not examined.task.design.fold_rows.any():
        return (STILL,)
    friction, inertia = _driving(examined, fitted), _negative(examined, fitted)
    out = []
    if friction:
        one = len(friction) == 1
        out.append(
            f"the friction that was fitted on {joints_listed(friction)} drives the arm "
            f"instead of braking it, which no friction does: is the sign of "
            f"{'this torque' if one else 'these torques'} right?"
        )
    if inertia:
        out.append(
            f"the inertia that was fitted on {joints_listed(inertia)} is negative, "
            "which no body has: are signs, units and the order of the joints right?"
        )
    before, after = (errors[k].overall("moving") for k in ("nominal", "identified"))
    if after > RULES.far_worse * before:
        out.append(
            "the refit predicts held-out motion worse than the model as it was given "
            f"({before:.1f} to {after:.1f} % while moving): these logs do not "
            "determine it"
        )
    return tuple(out)


def _driving(examined: Examined, fitted: Fit) -> list[int]:
    """Joints (from 1) on which the fitted friction feeds the motion."""
    design, covariance = examined.task.design, fitted.covariance()
    theta, out = _whole(examined, fitted), []
    brakes = _marked(examined, fitted, lambda e, on: Trait.FRICTION in e.traits)
    speeds = design.stacked([t.qd[:: t.step] for t in examined.logs.sketch])
    for j, speed in enumerate(speeds):
        place, have = design.present(j, fitted.ids)
        mine = brakes[have]
        along = np.zeros(len(theta))
        along[have[mine]] = design.columns(j, place[mine]).T @ speed
        power, sd = along @ theta, np.sqrt(max(along @ covariance @ along, 0.0))
        moved = np.abs(speed) @ np.abs(design.tau[j])
        if power < -RULES.beyond * sd and power < -RULES.least_power * moved:
            out.append(j + 1)
    return out


def _negative(examined: Examined, fitted: Fit) -> list[int]:
    """Joints (from 1) whose own inertia came out negative over the logged places."""
    design, covariance = examined.task.design, fitted.covariance()
    theta, model = _whole(examined, fitted), examined.logs.robot.model
    q = np.concatenate([t.q for t in examined.logs.tracks])
    q = q[:: max(1, len(q) // PLACES)]
    still, out = np.zeros_like(q), []
    resting = regressor(model, q, still, still)
    for j in range(design.dof):
        push = still.copy()
        push[:, j] = 1.0
        rows = regressor(model, q, still, push)[:, j] - resting[:, j]
        rotors = _marked(
            examined,
            fitted,
            lambda e, on, j=j: e.carries == "acceleration" and on == (j,),
        )
        along = rotors.astype(float)
        along[: rows.shape[1]] = rows.mean(axis=0)
        own, sd = along @ theta, np.sqrt(max(along @ covariance @ along, 0.0))
        if own < -RULES.beyond * sd and own < 0:
            out.append(j + 1)
    return out


def _whole(examined: Examined, fitted: Fit) -> Array:
    """Coefficients themselves, where a fit has their distance from the nominal."""
    theta = fitted.theta.copy()
    base = examined.nominal.model.coefficients()
    theta[: len(base)] += base
    return theta


def _marked(examined: Examined, fitted: Fit, wanted: Callable) -> Array:
    """Which of a fit's coefficients belong to effects that are wanted. (m,), bool."""
    model = examined.nominal.model
    marks = [np.zeros(len(model.inertial), dtype=bool)]
    for part in (*model.terms, *fitted.members):
        count = len(part.theta) if hasattr(part, "theta") else len(part.ids)
        marks.append(np.full(count, bool(wanted(part.effect, part.joints))))
    return np.concatenate(marks)


QUIET = (
    0.02  # high-band density, as a share of the middle band, that white noise never has
)
SHIFTS = 0.002 * np.arange(-15, 16)  # s


def filtered_at_source(recordings: Sequence[Recording]) -> str | None:
    """Say so if the torque channel carries no noise near its Nyquist frequency.

    White measurement noise has a flat spectrum. Where the density in the top fifth of
    the band is under 2 % of that between 20 % and 40 % of it on most joints, a
    low-pass at the source has taken it away.
    """
    shares, rates = [], []
    for recording in in_pieces(recordings):
        rate = sample_rate(recording.t)
        length = min(512, len(recording.t))
        f, density = power_density(recording.tau, length)
        top, middle = f > 0.4, (f > 0.1) & (f < 0.2)
        shares.append(
            density[top].mean(axis=0) / (density[middle].mean(axis=0) + 1e-30)
        )
        rates.append(rate)
        let_go(recording)
    share = np.median(np.array(shares), axis=0)
    dead = np.all([np.ptp(r.tau, axis=0) == 0 for r in recordings], axis=0)
    share[dead] = 1.0
    quiet = [j + 1 for j in np.flatnonzero(share < QUIET)]
    if len(quiet) <= len(share) / 2:
        return None
    return (
        f"torque looks low-pass filtered at the source on joints {listed(quiet)}: its "
        f"noise density near {0.45 * min(rates):.0f} Hz is under {100 * QUIET:.0f} % "
        "of that in mid band, so noise and detectable sizes are understated"
    )


def delayed_at_source(model: Model, logs: Logs) -> str | None:
    """Say so if the torque fits the model better when shifted in time.

    The shift is the one that correlates measured and predicted torque best on the fit
    logs, by joint; half of the joints or more must agree within a third.
    """
    miss = np.zeros((len(SHIFTS), model.robot.dof))
    for track in logs.sketch:
        torque = low_pass(model.torque_on(track), track.cutoff, track.rate)
        rows = track.t[:: track.step]
        for i, shift in enumerate(SHIFTS):
            moved = [np.interp(rows - shift, track.t, column) for column in torque.T]
            gap = (track.tau - np.column_stack(moved)) * track.moving
            miss[i] += (gap**2).sum(axis=0)
    # A joint that stands has no say: its sums are zero at every shift.
    shifts = [_vertex(SHIFTS, column) for column in miss.T if column.max() > 0]
    if not shifts:
        return None
    delay = float(np.median(shifts))
    agree = np.mean(np.abs(np.array(shifts) - delay) < max(abs(delay) / 3, 1e-3))
    if abs(delay) < RULES.least_delay or agree < 0.5:
        return None
    return (
        f"torque seems {'late' if delay > 0 else 'early'} against position by "
        f"{1000 * abs(delay):.0f} ms; findings that follow speed or acceleration "
        "may be part of it"
    )


def _vertex(x: np.ndarray, y: np.ndarray) -> float:
    """Minimum of samples, refined by a parabola."""
    i = int(np.clip(np.argmin(y), 1, len(y) - 2))
    curve = y[i - 1] - 2 * y[i] + y[i + 1]
    shift = 0.5 * (y[i - 1] - y[i + 1]) / curve if curve > 0 else 0.0
    return float(x[i] + np.clip(shift, -1, 1) * (x[1] - x[0]))


def warnings(
    examined: Examined, withdrawn: Sequence[Withdrawn], same_run: bool
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
            "the proof is weak, since it is the same run"
        )
    scale = examined.task.prior.scale
    if scale > RULES.rough:
        off = "100 % or more" if scale >= 1 else f"about {100 * scale:.0f} %"
        out.append(
            f"the inertias of the nominal model are off by {off}: too rough to blame a "
            "single body of the arm; give --baseline"
        )
    out += [complaint(w.tested, w.why) for w in withdrawn]
    return list(dict.fromkeys(out))  # two ripples of a joint make one sentence


def complaint(tested: Tested, why: str) -> str:
    """A warning about a name that did not stand: 'ripple on joint 3: why'."""
    joints = [j + 1 for j in tested.group.joints]
    place = f" on {joints_listed(joints)}" if joints else ""
    return f"{tested.group.effect.name}{place}: {why}"


def signal_notes(
    examined: Examined, fit: Sequence[Recording], augmented: Model
) -> tuple[str, ...]:
    """Return what was understood of the signals: filter, rows, faults of logging."""
    logs = examined.logs
    rows = examined.task.design.rows
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
    more = (filtered_at_source(fit), delayed_at_source(augmented, logs))
    return (*notes, *(s for s in more if s))
