"""The gate: a name must lower the error of left-out logs, and be more than a curve."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.search import SearchTask, required_nats, spares_model
from residual.effects.base import EffectTrait
from residual.evidence.design import CandidateColumns, Design
from residual.evidence.fit import (
    Fit,
    FitEquations,
    compute_evidence_gain,
    is_fit_possible,
)
from residual.evidence.thresholds import THRESHOLDS
from residual.model.model import Model
from residual.recording import Array
from residual.signals.track import Track

BINS, FEWEST = 16, 8  # of a curve; rows of a bin and log that count
STATIC = "static"  # the family of torques that depend on nothing but the position


@dataclass(frozen=True, eq=False, slots=True)
class GateResult:
    """One member of the chosen set after the gate."""

    group: CandidateColumns  # the effect, joints and shape
    nats: float  # evidence that it carries in the whole set
    by: str | None  # "fit" or "plausibility"; None where it fails
    joint: int  # the joint (from 0) on which it matters most
    fall: float  # fall of the left-out error there, as a share of torque rms
    share: float  # part of that joint's left-out error which it removes
    # The joint (from 0) whose left-out error falls most. Without the name the
    # parameters bend, and that may show elsewhere.
    shown_joint: int


def cross_validation_errors(task: SearchTask, fitted: Fit) -> Array:
    """Squared error of each fold, predicted from the others. Shape (folds, dof)."""
    return system_cross_validation_errors(
        task, fitted, FitEquations.of(task.design, task.prior, fitted.members)
    )


def system_cross_validation_errors(
    task: SearchTask, fitted: Fit, system: FitEquations
) -> Array:
    """The same, of the normal equations of a fit. Shape (folds, dof)."""
    design, out = task.design, []
    weight = fitted.weight(design.rows)
    for fold in system.folds(design):
        theta, _ = replace(
            system, gram=system.gram - fold.gram, cross=system.cross - fold.cross
        ).solve(weight)
        out.append(fold.squared_error(theta))
    return np.array(out)


def judge_members_by_gate(task: SearchTask, fitted: Fit) -> list[GateResult]:
    """Test every member of a set: left-out error, else plausibility."""
    full = cross_validation_errors(task, fitted)
    return [_gate_member(task, fitted, group, full) for group in fitted.members]


def passes_gate(task: SearchTask, fitted: Fit, group: CandidateColumns) -> bool:
    """Whether one member of a set passes."""
    return (
        _gate_member(task, fitted, group, cross_validation_errors(task, fitted)).by
        is not None
    )


def _gate_member(
    task: SearchTask, fitted: Fit, group: CandidateColumns, with_errors: Array
) -> GateResult:
    design, rules = task.design, task.rules
    rest = [g for g in fitted.members if g is not group]
    # Settled on its own noise, as a user would refit without the name: held to the
    # larger model's noise it would bend its parameters beyond belief instead.
    without = task.settle(task.fit(rest, fitted, rounds=4))
    nats, big, small = compute_evidence_gain(design, task.prior, fitted, without)
    without_errors = cross_validation_errors(task, without)
    power = np.maximum(design.tau_power.sum(axis=0), 1e-30)
    fall = (without_errors - with_errors).sum(axis=0) / power
    relative = np.sign(fall) * np.sqrt(abs(fall))
    share = 1 - with_errors.sum(axis=0) / np.maximum(without_errors.sum(axis=0), 1e-30)
    improved = np.mean(
        (without_errors > with_errors)[_acting(design, fitted, group)], axis=0
    )
    acts = [j for j in range(design.dof) if len(design.present(j, group.ids)[0])]
    joint = acts[int(np.argmax(fall[acts]))]
    by = None
    if nats < required_nats(task, fitted.members, group) or not is_fit_possible(
        design, fitted, group
    ):
        pass
    elif np.any(
        rules.lower(relative, share) & (improved >= THRESHOLDS.min_improved_folds)
    ):
        by = "fit"
    elif spares_model(task, group, nats, big, small):
        by = "plausibility"
    at_joint = float(relative[joint]), float(share[joint])
    return GateResult(group, nats, by, joint, *at_joint, int(np.argmax(fall)))


def _acting(design: Design, fitted: Fit, group: CandidateColumns) -> Array:
    """Folds in which a member does anything; the others have no say. Shape (folds,).

    A sensor that saturates does so in those logs alone that ask for so much.
    """
    theta, power = fitted.of(group), np.zeros(design.folds)
    for j in range(design.dof):
        place, have = design.present(j, group.ids)
        gram, _ = design.fold_sums(j, place)
        power += (gram @ theta[have]) @ theta[have] / design.rms[j] ** 2
    return power > THRESHOLDS.silent_fold_share * power.max()


def drop_members_failing_gate(
    task: SearchTask, fitted: Fit
) -> tuple[Fit, list[GateResult]]:
    """Drop the members that fail, weakest first, until all pass."""
    while True:
        tested = judge_members_by_gate(task, fitted)
        failed = [t for t in tested if t.by is None]
        if not failed:
            return fitted, tested
        worst = min(failed, key=lambda t: t.nats)
        rest = [g for g in fitted.members if g is not worst.group]
        fitted = task.settle(task.fit(rest, fitted))


# Names whose own curve is another: they resemble what the logs show, and are not it.
#
# A sensor with a dead zone looks like one of less gain, a stop that is leaned on like a
# spring, as long as only the error is asked. Over the variable that it is drawn against
# the name then leaves a curve that every log repeats, a third of what it explains. No
# author's form of the same effect leaves so much.


def find_wrong_forms(
    design: Design, tracks: Sequence[Track], fitted: Fit, tested: Sequence[GateResult]
) -> list[GateResult]:
    """Return the names that leave a third of their own curve or more unexplained."""
    return [t for t in tested if _is_wrong(design, tracks, fitted, t)]


def _is_wrong(
    design: Design, tracks: Sequence[Track], fitted: Fit, tested: GateResult
) -> bool:
    group = tested.group
    if EffectTrait.ONE_VARIABLE not in group.effect.traits:
        return False
    (j,) = group.joints
    place, have = design.present(j, group.ids)
    torque = design.columns(j, place) @ fitted.of(group)[have]
    residual = design.residual(j, fitted.ids, fitted.theta)
    x, log = _variable(design, tracks, tested, j)
    curve = _repeated(x, residual, log)
    return curve > max(
        THRESHOLDS.own_curve_share * np.std(torque),
        THRESHOLDS.own_curve_torque_share * design.rms[j],
    )


def _variable(
    design: Design, tracks: Sequence[Track], tested: GateResult, j: int
) -> tuple[Array, Array]:
    """Explaining variable of an effect on the rows of a joint, and each row's log."""
    values, logs = [], []
    for i, (track, state) in enumerate(zip(tracks, design.states, strict=True)):
        x, _ = tested.group.effect.variable(state, j)
        rows = track.moving[:, j]
        values.append(x[:: track.step][rows])
        logs.append(np.full(int(rows.sum()), i))
    return np.concatenate(values), np.concatenate(logs)


def _repeated(x: Array, y: Array, log: Array) -> float:
    """Rms of the curve of y over x that one log has from the others [of y].

    Products of the means of one bin in different logs: noise, which no two logs share,
    averages out instead of adding up.
    """
    edges = np.quantile(x, np.linspace(0, 1, BINS + 1)[1:-1])
    place = np.searchsorted(edges, x)
    total, weight = 0.0, 0.0
    for b in range(BINS):
        in_bin = place == b
        counts = np.bincount(log[in_bin])
        sums = np.bincount(log[in_bin], y[in_bin], minlength=len(counts))
        enough = counts >= FEWEST
        means = sums[enough] / counts[enough]
        if len(means) > 1:
            pairs = len(means) * (len(means) - 1)
            product = (means.sum() ** 2 - (means**2).sum()) / pairs
            total += in_bin.sum() * product
            weight += in_bin.sum()
    return float(np.sqrt(max(total / weight, 0.0))) if weight else 0.0


# Names that together are but a curve: a Fourier series is no physics.
#
# A spring and ripples of several orders can draw any function of a joint's position,
# such as a stop that the arm leans on. Where a free curve of as many numbers draws it
# as well, the names say nothing that the curve does not, and none of them stands.


def find_replaceable_by_curve(
    design: Design, tracks: Sequence[Track], fitted: Fit, tested: Sequence[GateResult]
) -> list[GateResult]:
    """Return the names that a free curve of as many numbers could stand for.

    Looked at are joints with two or more names that depend on the position alone and
    a wave that repeats among them.
    """
    out = []
    for j in range(design.dof):
        members = [t for t in tested if t.group.joints == (j,) and _of_position(t)]
        if len(members) > 1 and any(map(_is_wave, members)):
            residual = design.residual(j, fitted.ids, fitted.theta)
            torque = sum(_torque(design, fitted, t, j) for t in members)
            numbers = sum(len(t.group.ids) + len(t.group.shape) for t in members)
            lines = [x.q[:: x.step, j][x.moving[:, j]] for x in tracks]
            curve_residual = _without_curve(
                np.concatenate(lines), residual + torque, numbers
            )
            power = (residual**2).sum()
            explained = ((residual + torque) ** 2).sum() - power
            waves = sum(_torque(design, fitted, t, j) for t in members if _is_wave(t))
            # What the waves add must be drawn, not what a name beside them explains.
            added = ((residual + waves) ** 2).sum() - power
            if (curve_residual**2).sum() - power < (1 - THRESHOLDS.curve_share) * added:
                out += _waves(design, fitted, members, j, residual + torque, explained)
    return out


def _waves(
    design: Design,
    fitted: Fit,
    members: list[GateResult],
    j: int,
    torque: Array,
    explained: float,
) -> list[GateResult]:
    """Those of the names on a joint that draw the curve: all, or what rides on one.

    Where one name that is no wave explains nearly all of it, it is no drawing: the
    waves are what its textbook form leaves.
    """
    for t in members:
        residual = ((torque - _torque(design, fitted, t, j)) ** 2).sum()
        explained_alone = (torque**2).sum() - residual
        if not _is_wave(t) and explained_alone > THRESHOLDS.curve_share * explained:
            return [member for member in members if member is not t]
    return members


def _is_wave(tested: GateResult) -> bool:
    return EffectTrait.PERIODIC in tested.group.effect.traits


def _of_position(tested: GateResult) -> bool:
    return _is_wave(tested) or tested.group.effect.family == STATIC


def _torque(design: Design, fitted: Fit, tested: GateResult, j: int) -> Array:
    place, have = design.present(j, tested.group.ids)
    return design.columns(j, place) @ fitted.of(tested.group)[have]


def _without_curve(x: Array, y: Array, numbers: int) -> Array:
    """Residual of y about a piecewise linear curve with evenly spaced knots."""
    knots = np.linspace(x.min(), x.max(), max(numbers, 2))
    width = max(knots[1] - knots[0], 1e-12)
    hats = np.maximum(1 - abs(x[:, None] - knots) / width, 0)
    return y - hats @ np.linalg.lstsq(hats, y, rcond=None)[0]


# What a fit leaves of the torque, compared with the noise of torque and angles.


@dataclass(frozen=True, eq=False, slots=True)
class Adequacy:
    """What the model leaves unexplained on each joint, as a share of torque rms."""

    structured_share: Array  # root of (residual variance minus noise variance), (dof,)
    before: Array  # the same without the names, (dof,)
    noise: Array  # noise level, (dof,)
    # Per joint "repeatable" or "time-driven"; None without repeats.
    kind: tuple[str | None, ...]
    # Joints (from 0) on which so much remains that names are void.
    flagged: tuple[int, ...]
    # Joints on which more than noise remains; the flagged ones among them.
    doubted: tuple[int, ...]


def assess_adequacy(
    design: Design,
    tracks: tuple[Track, ...],
    before: Fit,
    after: Fit,
    angles: Array | None = None,
) -> Adequacy:
    """Compare what is left on the moving rows with the noise of torque and angles.

    That of the torque is measured above the identification filter and taken as white,
    that of the angles is given as the torque it makes [N m]. A joint
    is flagged above 5 % of torque rms, unless the names halved it, and above 10 % in
    any case. More than 1.5 % of torque rms and twice the noise is not nothing, and is
    said.
    """
    squares = np.mean([t.torque_noise**2 for t in tracks], axis=0)
    if angles is not None:
        squares = squares + angles**2
    noise = np.sqrt(squares) / design.rms
    structured = _structured(design, after, noise)
    first = _structured(design, before, noise)
    flagged = [
        j
        for j in range(design.dof)
        if (structured[j] > THRESHOLDS.flag_share and structured[j] > 0.5 * first[j])
        or structured[j] > 2 * THRESHOLDS.flag_share
    ]
    periods = [find_motion_period(track) for track in tracks]
    kinds = tuple(
        _residual_kind(design, periods, after, noise, j) for j in range(design.dof)
    )
    least = np.maximum(THRESHOLDS.doubt_share, THRESHOLDS.doubt_noises * noise)
    doubted = sorted({*flagged, *np.flatnonzero(structured > least).tolist()})
    kinds = tuple(k if j in doubted else None for j, k in enumerate(kinds))
    return Adequacy(structured, first, noise, kinds, tuple(flagged), tuple(doubted))


def _structured(design: Design, fitted: Fit, noise: Array) -> Array:
    """Excess over the noise, beyond three standard deviations of a variance."""
    left = fitted.sse / design.rows / design.rms**2
    doubt = 1 + 3 * np.sqrt(2 / fitted.counted)
    return np.sqrt(np.maximum(left - noise**2 * doubt, 0))


def _residual_kind(
    design: Design, periods: list[int | None], fitted: Fit, noise: Array, j: int
) -> str | None:
    """Whether the residual of a log that repeats itself repeats with it."""
    residuals = design.series(j, design.residual(j, fitted.ids, fitted.theta))
    same = other = count = 0.0
    for period, residual in zip(periods, residuals, strict=True):
        if period is None:
            continue
        a, b = residual[:-period], residual[period:]
        both = (a != 0) & (b != 0)
        same += float((a * b)[both].sum())
        other += float(((a - b) ** 2)[both].sum() / 2)
        count += float(both.sum())
    if not count:
        return None
    random = other / count - (noise[j] * design.rms[j]) ** 2
    return "repeatable" if same / count >= random else "time-driven"


def find_motion_period(track: Track) -> int | None:
    """Rows after which the motion repeats, found from q itself; None where it never."""
    q = track.q[:: track.step]
    m = len(q)
    spread = np.maximum(q.std(axis=0), 1e-6)
    best, period = THRESHOLDS.repeat_share, None
    for lag in range(int(0.2 * m), int(0.8 * m)):
        gap = np.abs(q[lag:] - q[:-lag])[5:-5].mean(axis=0)
        worst = float(np.max(gap / spread)) if m - lag > 20 else np.inf
        if worst < best:
            best, period = worst, lag
    return period


def torque_from_angle_noise(
    model: Model, tracks: Sequence[Track], noisy_tracks: Sequence[Track]
) -> Array:
    """Torque noise that the angles' noise makes of a model, on moving rows.

    Effective variance (Orear 1982): what scatters about a model is the noise of what is
    measured and that of what it is held against.

    Args:
        noisy_tracks: The same, ``shaken``.

    Returns:
        Root mean square behind the identification filter [N m]. Shape (dof,).
    """
    squares, rows = np.zeros(model.robot.dof), np.zeros(model.robot.dof)
    for track, redrawn_track in zip(tracks, noisy_tracks, strict=True):
        torque = [model.torque_on(t) for t in (track, redrawn_track)]
        gap = track.filter(torque[1] - torque[0]) * track.moving
        squares += (gap**2).sum(axis=0)
        rows += track.moving.sum(axis=0)
    return np.sqrt(squares / np.maximum(rows, 1))
