"""Two epochs of an arm as one design (``evidence.epoch_design``), and their search.

Both epochs share the bodies and declared effects of the arm, and small effects of any arm
(friction by speed, load and position, a few waves, a constant). They also share the
differences between logs of an unchanged arm: the friction of a joint from log to log, and
of all joints together (warmth). Further differences are estimated from the logs of the
first epoch, joint by joint.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import psi

from residual.diagnosis.candidates import Candidates, list_present_effects, price_keys
from residual.diagnosis.score import Score, label_blocks
from residual.diagnosis.search import Search, SearchRun, add_curves
from residual.effects import load_effects
from residual.effects.base import Effect, EffectTrait, PlacedEffect, Shape
from residual.evidence.columns import CandidateColumns
from residual.evidence.design import Design
from residual.evidence.epoch_design import OWN, EpochDesign, EpochRows, Whitening, locate_rows
from residual.evidence.fit import (
    Fit,
    NominalPrior,
    add_nominal_values,
    build_fitted_model,
    estimate_autocorrelation_time,
    fit_jointly,
    refit_effective_rows,
    select_coefficients,
)
from residual.evidence.priors import build_relative_prior
from residual.evidence.thresholds import THRESHOLDS
from residual.model.model import Model, Term
from residual.model.nominal import FitLogs, NominalModel
from residual.recording import Array

LOOSE = 10.0  # relative scale of the bodies: a tool may weigh more than any link
FIRM = (1.0, 10.0, 100.0, 1000.0)  # times the precision of the small effects of any arm
RIDGE = 1e-5  # of the rows: keeps unexcited parameters at the joint fit
CLEAR = 0.2  # deviation from which friction of a joint gives no information
FEWEST = 50  # rows of a log that can be compared


@dataclass(frozen=True, eq=False, slots=True)
class CommonModelFit:
    """One arm fitted to logs, with the small effects of any arm."""

    design: Design  # the columns
    fitted: Fit  # the fit
    common: tuple[CandidateColumns, ...]  # its effects besides those of the nominal model
    prior: NominalPrior  # of the nominal coefficients

    def without(self, torques: Sequence[Array]) -> tuple[Design, "CommonModelFit"]:
        """The same fitted to what these torques [N m] leave: such rows, and the fit.

        Args:
            torques: On the rows of each joint. Shapes (rows,).
        """
        target = [y - x for y, x in zip(self.design.target, torques, strict=True)]
        remaining = self.design.with_target(target)
        fitted = _fit(remaining, self.prior, self.common)
        return remaining, replace(self, fitted=fitted)


def fit_common_model(
    logs: FitLogs, nominal: NominalModel, scales: Sequence[float], labels: Sequence[Array] = ()
) -> CommonModelFit:
    """Fit one arm to logs: its model, and the small effects of any arm.

    The evidence chooses the scales of the bodies and of the small effects, so that short
    logs do not overfit.
    """
    design = Design(logs.tracks, nominal.model, labels=labels)
    own_features, loaded = _common_effects(logs, nominal.model)
    prior = build_relative_prior(design, nominal, LOOSE)
    groups = design.add(own_features)
    design.set_torque_model(build_fitted_model(nominal, _fit(design, prior, groups)))
    groups = (*groups, *design.add(loaded))
    fits = [
        CommonModelFit(design, _fit(design, prior, firm_groups), tuple(firm_groups), prior)
        for prior in (build_relative_prior(design, nominal, scale) for scale in scales)
        for firm_groups in ([g.scale_precision(times) for g in groups] for times in FIRM)
    ]
    return max(fits, key=lambda own: own.fitted.score)


def _common_effects(logs: FitLogs, model: Model) -> tuple[list[PlacedEffect], list[PlacedEffect]]:
    """Small effects of any arm: those without and with the model's torque."""
    has = {(t.effect.name, t.joints, t.shape) for t in model.terms}
    out: tuple[list[PlacedEffect], list[PlacedEffect]] = ([], [])
    for effect in load_effects().values():
        for joints in effect.candidates(model.robot.dof, model.robot.prismatic):
            for shape in effect.in_any_arm(logs.span, joints[0] if joints else 0):
                if (effect.name, joints, shape) not in has:
                    kind = out[EffectTrait.USES_MODEL in effect.traits]
                    kind.append(PlacedEffect(effect, joints, shape))
    return out


def _fit(design: Design, prior: NominalPrior, groups: Sequence[CandidateColumns]) -> Fit:
    return refit_effective_rows(
        design, prior, fit_jointly(design, prior, groups, design.rows / 5, rounds=4)
    )


@dataclass(frozen=True, eq=False, slots=True)
class FrictionSpread:
    """The spread of friction without any other change."""

    # Of each joint, second epoch over first, less one; NaN where it has none, (dof,).
    moved: Array
    spread: Array  # standard deviation from log to log, (dof,)
    # Median of all joints; None for fewer than three. Its deviation, from the spread of
    # the joints.
    warmth: float | None
    deviation: float


@dataclass(frozen=True, eq=False, slots=True)
class Epochs:
    """Two epochs, prepared for the search."""

    logs: FitLogs  # all logs, those of the first epoch first
    first: int  # number of logs of the first epoch
    nominal: NominalModel  # the declared model
    common: CommonModelFit  # one arm fitted to both, without known changes
    # Torque of all its friction on each joint's rows [N m], (rows,).
    friction: tuple[Array, ...]
    drift: FrictionSpread
    search: Search

    @property
    def design(self) -> EpochDesign:
        """The whitened rows."""
        return self.search.score.design

    def fit_without(self, changes: Sequence[Term]) -> tuple[Design, Fit, tuple[Array, ...]]:
        """Fit one arm to both epochs, the second without its changes.

        Returns:
            The remaining rows, the fit, and the torque of the changes on the rows of
            each joint [N m], (rows,).
        """
        torques = _sum_torques(self.common.design, self.design.epochs, changes)
        remaining, common = self.common.without(torques)
        return remaining, common.fitted, torques


def _sum_torques(
    raw: Design, epochs: Sequence[EpochRows], changes: Sequence[Term]
) -> tuple[Array, ...]:
    """Torque of changes on the rows of each joint, in the second epoch [N m]."""
    out = [np.zeros(len(own.second)) for own in epochs]
    groups = raw.add([PlacedEffect(t.effect, t.joints, t.shape) for t in changes])
    for group, term in zip(groups, changes, strict=True):
        for j, own in enumerate(epochs):
            out[j] += own.second * raw.torque(group, term.theta, j)
    return tuple(out)


def search_epochs(
    logs: FitLogs, first: int, nominal: NominalModel, progress: Callable[[float], None]
) -> tuple[Epochs, SearchRun]:
    """Search two epochs for changes.

    A large change loads the gears, and shifts the joint fit and the report of each
    drive: the changes are removed from the fit once, and the search is repeated.

    Args:
        first: Number of logs of the first epoch, which come first.
    """
    labels = label_blocks(logs.tracks)
    common = fit_common_model(logs, nominal, (LOOSE,), labels)
    seen = common
    if logs.span.one_drive:  # with a very different gain the mean of both epochs is no arm
        seen = fit_common_model(replace(logs, tracks=logs.tracks[:first]), nominal, (LOOSE,))
    model = build_fitted_model(nominal, seen.fitted)
    common.design.set_torque_model(model)
    epochs = _build_epochs(logs, first, nominal, common, model, ())
    progress(0.5)
    run = epochs.search.run()
    design, large = epochs.design, []
    for group in run.named:
        theta = run.fit.of(group)
        if design.torque_shares(group, theta).max() > THRESHOLDS.large_torque_share:
            large.append(Term(group.effect, group.joints, group.shape, theta))
    if large:
        epochs = _build_epochs(logs, first, nominal, common, model, large)
        run = epochs.search.run()
    return epochs, run


def _build_epochs(
    logs: FitLogs,
    first: int,
    nominal: NominalModel,
    common: CommonModelFit,
    model: Model,
    changes: Sequence[Term],
) -> Epochs:
    """Whiten both epochs, and append every candidate.

    Args:
        model: Model whose torque the effects depend on.
        changes: Known changes.
    """
    raw, rows = common.design, locate_rows(common.design, first)
    reported: tuple[Array, ...] = ()
    if changes:
        groups = _see_changes(logs, first, model, raw, common.common, changes)
        torques = _sum_torques(raw, rows, changes)
        _, common = replace(common, common=groups).without(torques)
        wide = [t for t in changes if t.effect.scope != "local"]
        reported = _sum_torques(raw, rows, wide) if wide else ()
    fitted = common.fitted
    friction = _friction_torque(raw, fitted, nominal.model)
    residuals = [raw.residual(j, fitted.ids, fitted.theta) for j in range(raw.dof)]
    joints = {
        j: _SharedColumns.of(raw, fitted.ids, own, j, logs.span.one_drive)
        for j, own in enumerate(rows)
        if own.compared
    }
    drift = _measure_friction(joints, residuals, friction, first)
    whiten = {
        j: joint.whiten(friction[j], drift, j, reported[j] if reported else None)
        for j, joint in joints.items()
    }
    design = EpochDesign.of(raw, residuals, friction, whiten, rows, logs.span)
    design.model = model
    candidates = _build_candidates(design, logs, list(joints))
    curves = add_curves(design, logs.tracks, centred=True)
    design.unrest = _measure_unrest(design, candidates.groups, joints, whiten, residuals, first)
    # Fewer than three joints give no common factor.
    width = THRESHOLDS.friction_spread if drift.warmth is None else THRESHOLDS.warmth
    precision = np.array([[width**-2]])
    prior = NominalPrior(precision, float(np.log(precision[0, 0])), LOOSE, {})
    search = Search(Score(design, prior), candidates, curves)
    return Epochs(logs, first, nominal, common, friction, drift, search)


def _see_changes(
    logs: FitLogs,
    first: int,
    model: Model,
    raw: Design,
    groups: Sequence[CandidateColumns],
    changes: Sequence[Term],
) -> tuple[CandidateColumns, ...]:
    """Recompute the second epoch with the changed model, and the small effects."""
    terms = [t for t in changes if EffectTrait.PARAMETER in t.effect.traits]
    if logs.span.one_drive:  # the share of the gain is not determined
        terms = [t for t in terms if EffectTrait.MOTOR not in t.effect.traits]
    bodies = [t for t in terms if t.effect.carries == "body"]
    others = [t for t in terms if t.effect.carries != "body"]
    body = replace(model, terms=tuple(bodies)).loaded()
    seen = replace(model, inertial=body, terms=(*model.terms, *others))
    raw.set_states(
        [(model if i < first else seen).observe(track) for i, track in enumerate(logs.tracks)]
    )
    reading = [g for g in groups if EffectTrait.USES_MODEL in g.effect.traits]
    added = iter(raw.add([g.placed for g in reading]))
    return tuple(
        replace(g, ids=next(added).ids) if EffectTrait.USES_MODEL in g.effect.traits else g
        for g in groups
    )


def _friction_torque(raw: Design, fitted: Fit, model: Model) -> tuple[Array, ...]:
    """Friction torque of the joint fit, per joint [N m]. Shapes (rows,)."""
    brakes = select_coefficients(
        model, fitted, lambda effect, on: EffectTrait.FRICTION in effect.traits
    )
    ids, values = fitted.ids[brakes], add_nominal_values(model, fitted)[brakes]
    out = []
    for j in range(raw.dof):
        place, have = raw.present(j, ids)
        out.append(raw.columns(j, place) @ values[have])
    return tuple(out)


@dataclass(frozen=True, eq=False, slots=True)
class _SharedColumns:
    """The shared columns of one joint in both epochs, besides the joint fit."""

    rows: EpochRows
    columns: Array  # (rows, p)
    precision: Array  # in units of the noise, (p,)
    noise: float  # variance of independent rows [N^2 m^2]
    weight: Array | float  # of the rows: the typical deviation over theirs, (rows,)

    @classmethod
    def of(cls, raw: Design, ids: Array, rows: EpochRows, j: int, uneven: bool) -> "_SharedColumns":
        """Columns of the joint fit, scaled to equal torque.

        The noise is estimated within each epoch, so that it contains no change, unlike
        the residual of a fit of both.

        Args:
            uneven: Whether blocks have separate noise levels. The residual of a drive's
                chain is many times larger at its limit.
        """
        columns = raw.columns(j, raw.present(j, ids)[0])
        power = (columns**2).mean(axis=0)
        unit = columns / np.sqrt(np.maximum(power, 1e-300))
        line = np.zeros(len(unit))
        line[~rows.second], degrees = _fit_alone(unit, raw.target[j], ~rows.second)
        left = line[~rows.second]
        slow = max(estimate_autocorrelation_time(raw.line(j, line)), 1.0)
        floor = (THRESHOLDS.noise_floor * raw.rms[j]) ** 2
        noise = slow * (float(left @ left) / max(degrees, 1.0) + floor)
        share = THRESHOLDS.shared_share * raw.rms[j]
        held = noise / share**2 + RIDGE * len(columns)
        weight: Array | float = 1.0
        if uneven:
            line[rows.second], more = _fit_alone(unit, raw.target[j], rows.second)
            usual = float(line @ line) / max(degrees + more, 1.0) + floor
            square, count = np.bincount(rows.block, line**2), np.bincount(rows.block)
            # The typical noise counts as one more independent row.
            own = (square + slow * usual) / (count + slow)
            weight = own[rows.block] ** -0.5
            weight /= np.sqrt((weight**2).mean())
        return cls(rows, columns, held * power, noise, weight)

    def whiten(
        self, friction: Array, drift: FrictionSpread, j: int, reported: Array | None
    ) -> Whitening:
        """Whiten with the friction of each log, its slope, and that of the second epoch.

        Args:
            friction: Torque of all friction [N m]. Shape (rows,).
            j: The joint, from 0.
            reported: Torque of a large change, which each drive reports with a separate
                gain; None without one. Shape (rows,).
        """
        spread, warmth = float(drift.spread[j]), abs(drift.warmth or 0.0)
        numbers = np.unique(self.rows.log)
        own = self.rows.log[:, None] == numbers
        ramp = np.zeros(len(friction))
        for mask in own.T:
            ramp[mask] = np.linspace(-1, 1, int(mask.sum()))
        # Asymmetric friction varies with temperature too.
        epoch = np.column_stack([friction, abs(friction)]) * self.rows.second[:, None]
        columns = [friction[:, None] * own, (friction * ramp)[:, None] * own, epoch]
        sd = [spread] * len(numbers) + [THRESHOLDS.ramp_share] * len(numbers)
        sd += [spread, THRESHOLDS.one_way_share * (warmth + spread)]
        if reported is not None:
            columns.append(reported[:, None])
            sd.append(THRESHOLDS.gain_share)
        return Whitening.of(
            np.hstack([self.columns, *columns]),
            np.concatenate([self.precision, self.noise / np.square(sd)]),
            self.weight,
        )


def _fit_alone(unit: Array, y: Array, kept: Array) -> tuple[Array, float]:
    """Return the residual of a free fit of some rows, and its degrees of freedom."""
    x, y = unit[kept], y[kept]
    inverse = np.linalg.inv(x.T @ x + np.diag(np.full(x.shape[1], RIDGE * len(x))))
    left = y - x @ (inverse @ (x.T @ y))
    return left, len(y) - float((inverse * (x.T @ x)).sum())


def _contrast(
    whiten: Whitening, columns: Array, y: Array, block: Array, mask: Array
) -> list[tuple[float, float, int] | None]:
    """Contrast of each column on some rows with all rows: value, deviation, blocks.

    None if nearly all of it is shared.

    Args:
        columns: Shape (k, rows).
        y: Whitened torque [N m]. Shape (rows,).
    """
    own, every = whiten(columns * mask), whiten(columns)
    size = (every**2).sum(axis=1) + OWN * (columns**2).sum(axis=1) + 1e-300
    own = own - every * ((own * every).sum(axis=1) / size)[:, None]
    out: list[tuple[float, float, int] | None] = []
    for z, column in zip(own, columns, strict=True):
        known = float(z @ z)
        if known <= OWN * float((column[mask] ** 2).sum()):
            out.append(None)
            continue
        value = float(z @ y) / known
        lever, pull = (np.bincount(block, z * x) for x in (z, y - value * z))
        pull = pull / np.maximum(1 - lever / known, 0.1)
        deviation = float(np.sqrt((pull**2).sum())) / known
        out.append((value, deviation, int((lever > 0.02 * known).sum())))
    return out


def _measure_friction(
    joints: Mapping[int, _SharedColumns],
    residuals: Sequence[Array],
    friction: Sequence[Array],
    first: int,
) -> FrictionSpread:
    """Measure the spread of friction from log to log, per joint and of all together.

    Joints warm by different amounts, and few joints determine the spread poorly: use a
    robust spread of the second epoch over the joints, and of the first over its logs.
    """
    moved, sd = np.full((2, len(friction)), np.nan)
    within = np.zeros(len(friction))
    for j, joint in joints.items():
        whiten = Whitening.of(joint.columns, joint.precision, joint.weight)
        own, before = joint.rows, ~joint.rows.second
        known = friction[j][None], whiten(residuals[j]), own.block, own.second
        if beyond := _contrast(whiten, *known)[0]:
            moved[j], sd[j], _ = beyond
        known = friction[j][None] * before, whiten(residuals[j] * before), own.block
        logs = (_contrast(whiten, *known, own.log == i)[0] for i in range(first))
        if len(single := [x for x in logs if x]) > 1:
            values, deviations, _ = np.array(single).T
            beyond = values.var(ddof=1) - (deviations**2).mean()
            within[j] = max(float(beyond), 0.0)
    rules, clear, warmth, deviation = THRESHOLDS, sd < CLEAR, None, 0.0
    spread, usual = rules.friction_spread, rules.usual_joints
    if clear.sum() >= rules.few_logs:
        warmth = float(np.median(moved[clear]))
        gap = 1.48 * float(np.median(abs(moved[clear] - warmth)))
        beyond = max(gap**2 - float(np.median(sd[clear])) ** 2, 0.0)
        count = clear.sum()
        square = (usual * spread**2 + count * beyond) / (usual + count)
        known = (1 / (sd[clear] ** 2 + square)).sum()
        deviation = 1.25 / float(np.sqrt(known))  # of a median
        spread = max(float(np.sqrt(square)), rules.warmth_spread * abs(warmth))
    logs = first - 1
    each = (usual * spread**2 + logs * within) / (usual + logs)
    return FrictionSpread(moved, np.sqrt(each), warmth, deviation)


def _measure_unrest(
    design: EpochDesign,
    groups: Sequence[CandidateColumns],
    joints: Mapping[int, _SharedColumns],
    whiten: Mapping[int, Whitening],
    residuals: Sequence[Array],
    first: int,
) -> Array:
    """Measure the differences of logs of the first epoch beyond noise, by joint.

    A factor on standard deviations, from all plain candidates and logs together: three
    logs give about twenty values, of which no single one decides. With fewer logs, thirds
    of the epoch are compared. Shape (dof,).
    """
    plain = [g for g in groups if g.effect.scope == "local" and g.shape == ()]
    plain = [g for g in plain if len(g.ids) == 1]
    raw, out = design.raw, np.ones(design.dof)
    added = raw.add([g.placed for g in plain])
    for j, joint in joints.items():
        own = [g.ids for g in added if g.joints == (j,)]
        if not own:
            continue
        before = ~joint.rows.second
        columns = raw.columns(j, raw.present(j, np.concatenate(own))[0]).T * before
        y, number = whiten[j](residuals[j] * before), joint.rows.log
        masks = [number == i for i in range(first)]
        masks = [mask for mask in masks if mask.sum() >= FEWEST]
        few = len(masks) < THRESHOLDS.few_logs
        if few:
            parts = np.array_split(np.flatnonzero(before), THRESHOLDS.few_logs)
            masks = [np.isin(np.arange(len(before)), part) for part in parts]
        ratios = []
        for mask in masks:
            found = _contrast(whiten[j], columns, y, joint.rows.block, mask)
            for value, deviation, blocks in filter(None, found):
                free = max(blocks - 1, 2)
                square = np.log1p((value / deviation) ** 2 / free)
                # Mean logarithm of Student's t with these degrees of freedom.
                ratios.append(square / (psi((free + 1) / 2) - psi(free / 2)))
        kept = np.sort(ratios)[: max(1, int(THRESHOLDS.kept_ratios * len(ratios)))]
        seen = float(np.sqrt(np.mean(kept))) if ratios else 2.0
        out[j] = max(seen, THRESHOLDS.few_logs_factor if few else 1.0)
    return out


def _build_candidates(design: EpochDesign, logs: FitLogs, live: Sequence[int]) -> Candidates:
    """Append every effect that may have changed, on each joint and in each shape."""
    placed = []
    for effect in list_present_effects(logs.span, logs.clock is not None):
        for on in effect.candidates(design.dof, logs.span.prismatic):
            if effect.scope in ("local", "pair") and not set(on) <= set(live):
                continue
            shapes = effect.shapes(logs.span, on[0] if on else 0)
            placed += [PlacedEffect(effect, on, x) for x in _extend(effect, shapes)]
    groups = design.add(placed)
    return Candidates(tuple(groups), price_keys(groups, design.dof))


def _extend(effect: Effect, shapes: Sequence[Shape]) -> list[Shape]:
    """Extend shapes on a grid of ratios, up to the largest possible.

    A change may exceed the effects of a new arm.
    """
    out, how = list(shapes), effect.refine
    if how is None or how.step != "ratio" or len(out) < 2 or not np.isfinite(how.upper):
        return out
    ratio = out[-1][0] / out[-2][0]
    while ratio > 1 and out[-1][0] * ratio < how.upper:
        out.append((out[-1][0] * ratio, *out[-1][1:]))
    return out
