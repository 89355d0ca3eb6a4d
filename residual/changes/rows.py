"""Rows of both epochs: what any arm has, shared by both, and every candidate.

All that the arm has anyway is a nuisance: its bodies, friction by speed, load and
position, a few waves, a constant, and the effects of its model. It is fitted to each
joint by itself, over both epochs, so that only what is in one of them can be a change
(docs/changes.md).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from residual.changes.thresholds import ChangeThresholds
from residual.effects import load_effects
from residual.effects.base import EffectTrait, PlacedEffect
from residual.evidence.design import CandidateColumns, Design
from residual.evidence.fit import (
    Fit,
    NominalPrior,
    build_fitted_model,
    fit_jointly,
    refit_effective_rows,
)
from residual.evidence.priors import build_relative_prior
from residual.model.model import Model, Term
from residual.model.nominal import FitLogs, NominalModel
from residual.recording import Array
from residual.signals.splitting import group_pieces_by_log

LOOSE = 10.0  # relative scale of the bodies: a tool may weigh more than any link
FIRM = (1.0, 10.0, 100.0, 1000.0)  # times the precision of what any arm has a little of


@dataclass(frozen=True, eq=False, slots=True)
class RowLayout:
    """Where each row of one joint comes from; rows follow each other in time."""

    second: Array  # it is of the second epoch. Shape (rows,), bool
    log: Array  # number of its log, those of the first epoch first, (rows,)
    starts: Array  # first row of each block, (blocks,)
    blocks: Array  # number of each of these blocks, the same on all joints, (blocks,)

    @property
    def blocks_of_rows(self) -> Array:
        """Number of the block of each row. Shape (rows,)."""
        sizes = np.diff([*self.starts, len(self.log)])
        return np.repeat(self.blocks[: len(sizes)], sizes)


@dataclass(frozen=True, eq=False, slots=True)
class EpochRows:
    """Rows of both epochs."""

    # Columns of the nominal model, of the shared nuisance and of candidates.
    design: Design
    logs: FitLogs  # all logs, those of the first epoch first
    first: int  # number of logs of the first epoch
    shared: Array  # column numbers of the nuisance, the nominal model's among them
    common: tuple[CandidateColumns, ...]  # its effects beside the nominal model's
    # Those of its effects, last among the columns, that go by the torque that a gear
    # carries.
    loaded: tuple[CandidateColumns, ...]
    # Torque that the joint fit leaves of each joint [N m], (rows,).
    residuals: tuple[Array, ...]
    # Torque of all friction of the joint fit on each joint's rows [N m].
    friction: tuple[Array, ...]
    layout: tuple[RowLayout, ...]  # of each joint
    blocks: int  # number of blocks
    rules: ChangeThresholds  # thresholds
    fitted: Fit  # the joint fit of one arm to both epochs
    model: Model  # the same as a model
    prior: NominalPrior  # of its nominal coefficients
    # Torque on each joint of what is known to have changed on all of them [N m], on
    # rows of the second epoch. Shapes (rows,); empty without one.
    changed: tuple[Array, ...] = ()

    @property
    def first_logs(self) -> int:
        """How many logs the first epoch has; pieces of one count once."""
        return len(group_pieces_by_log([t.id for t in self.logs.tracks[: self.first]]))

    @property
    def analyzable_joints(self) -> list[int]:
        """Joints with rows enough in both epochs."""
        return [
            j
            for j, own in enumerate(self.layout)
            if min(own.second.sum(), (~own.second).sum()) > 60
        ]


@dataclass(frozen=True, eq=False, slots=True)
class CommonModelFit:
    """One arm fitted to logs, with all that any arm has a little of."""

    design: Design  # the columns
    fitted: Fit  # the fit
    common: tuple[CandidateColumns, ...]  # its effects beside the nominal model's
    prior: NominalPrior  # of the nominal coefficients


def fit_common_model(
    logs: FitLogs, nominal: NominalModel, scales: Sequence[float]
) -> CommonModelFit:
    """Fit one arm to logs: its model, and what any arm has a little of.

    How far the bodies are from the model's, and how little of the rest there is, the
    evidence chooses: a short log must not fill what it did not see.
    """
    design = Design(logs.tracks, nominal.model)
    own_features, loaded = _common_effects(logs, nominal.model)
    prior = build_relative_prior(design, nominal, LOOSE)
    groups = design.add(own_features)
    design.set_torque_model(build_fitted_model(nominal, _fit(design, prior, groups)))
    groups = (*groups, *design.add(loaded))
    fits = [
        CommonModelFit(
            design, _fit(design, prior, firm_groups), tuple(firm_groups), prior
        )
        for prior in (build_relative_prior(design, nominal, scale) for scale in scales)
        for firm_groups in (
            [g.scale_precision(times) for g in groups] for times in FIRM
        )
    ]
    return max(fits, key=lambda own: own.fitted.score)


def build_epoch_rows(
    logs: FitLogs, first: int, nominal: NominalModel, rules: ChangeThresholds
) -> EpochRows:
    """Build the rows of both epochs, without candidates.

    Args:
        logs: Logs of the first epoch, then those of the second.
        nominal: The model that the arm is said to have, adopted effects included.
    """
    joint = fit_common_model(logs, nominal, (LOOSE,))
    design, fitted, common = joint.design, joint.fitted, joint.common
    model = build_fitted_model(nominal, fitted)
    design.set_torque_model(model)
    layout, blocks = _layout(logs, first, design, rules.block_seconds)
    ids = [design.nominal, *(g.ids for g in common)]
    return EpochRows(
        design=design,
        logs=logs,
        first=first,
        shared=np.concatenate(ids),
        common=tuple(common),
        loaded=tuple(g for g in common if EffectTrait.USES_MODEL in g.effect.traits),
        residuals=_residuals(design, fitted),
        friction=_friction(design, fitted, nominal, common),
        layout=layout,
        blocks=blocks,
        rules=rules,
        fitted=fitted,
        model=model,
        prior=joint.prior,
    )


def account_for_changes(
    both: EpochRows, changed: Sequence[tuple[CandidateColumns, Array]], press: bool
) -> EpochRows:
    """The same rows beside what is known to have changed.

    The joint fit is made without it, and what goes by the torque that a gear carries
    sees it: a load that was hung on presses on the gears, and that is no other change.

    Args:
        both: The rows; columns of candidates that are there already stay as they are.
    """
    if press:
        both = _with_changed_loads(both, changed)
    design = both.design
    _, fitted, _ = fit_without_changes(both, changed)
    wide = [(g, theta) for g, theta in changed if g.effect.scope != "local"]
    torques = [
        own.second * _torque(design, j, wide) for j, own in enumerate(both.layout)
    ]
    return replace(
        both,
        residuals=_residuals(design, fitted),
        changed=tuple(torques) if wide else (),
    )


def fit_without_changes(
    both: EpochRows, changed: Sequence[tuple[CandidateColumns, Array]]
) -> tuple[Design, Fit, tuple[Array, ...]]:
    """The joint fit of one arm, the second epoch without what changed.

    Returns:
        The rows that are left, the fit, and the torque of the changes on the rows of
        each joint, (rows,).
    """
    design = both.design
    torques = tuple(
        own.second * _torque(design, j, changed) for j, own in enumerate(both.layout)
    )
    target = [y - x for y, x in zip(design.target, torques, strict=True)]
    remaining = design.with_target(target)
    return remaining, _fit(remaining, both.prior, both.common), torques


def _torque(
    design: Design, j: int, changed: Sequence[tuple[CandidateColumns, Array]]
) -> Array:
    """Torque of changes on the rows of a joint, in both epochs. Shape (rows,)."""
    out = np.zeros(len(design.target[j]))
    for group, theta in changed:
        place, have = design.present(j, group.ids)
        if len(place):
            out += design.columns(j, place) @ theta[have]
    return out


def _with_changed_loads(
    both: EpochRows, changed: Sequence[tuple[CandidateColumns, Array]]
) -> EpochRows:
    """Rows with the second epoch seen by the changed model."""
    terms = [
        Term(g.effect, g.joints, g.shape, theta)
        for g, theta in changed
        if EffectTrait.PARAMETER in g.effect.traits
    ]
    bodies = [t for t in terms if t.effect.carries == "body"]
    others = [t for t in terms if t.effect.carries != "body"]
    body = replace(both.model, terms=tuple(bodies)).loaded()
    seen = replace(both.model, inertial=body, terms=(*both.model.terms, *others))
    both.design.set_states(
        [
            (both.model if i < both.first else seen).observe(track)
            for i, track in enumerate(both.logs.tracks)
        ]
    )
    old = set(both.loaded)
    plain = [g for g in both.common if g not in old]
    loaded = both.design.add([g.placed for g in both.loaded])
    ids = [both.design.nominal, *(g.ids for g in (*plain, *loaded))]
    return replace(
        both, shared=np.concatenate(ids), common=(*plain, *loaded), loaded=tuple(loaded)
    )


def _residuals(design: Design, fitted: Fit) -> tuple[Array, ...]:
    residual = design.residual
    return tuple(residual(j, fitted.ids, fitted.theta) for j in range(design.dof))


def _common_effects(
    logs: FitLogs, model: Model
) -> tuple[list[PlacedEffect], list[PlacedEffect]]:
    """Effects that any arm has: those without and with the model's torque."""
    has = {(t.effect.name, t.joints, t.shape) for t in model.terms}
    out: tuple[list[PlacedEffect], list[PlacedEffect]] = ([], [])
    for effect in load_effects().values():
        for joints in effect.candidates(model.robot.dof, model.robot.prismatic):
            for shape in effect.in_any_arm(logs.span, joints[0] if joints else 0):
                if (effect.name, joints, shape) not in has:
                    kind = out[EffectTrait.USES_MODEL in effect.traits]
                    kind.append(PlacedEffect(effect, joints, shape))
    return out


def _fit(
    design: Design, prior: NominalPrior, groups: Sequence[CandidateColumns]
) -> Fit:
    return refit_effective_rows(
        design, prior, fit_jointly(design, prior, groups, design.rows / 5, rounds=4)
    )


def _friction(
    design: Design,
    fitted: Fit,
    nominal: NominalModel,
    groups: Sequence[CandidateColumns],
) -> tuple[Array, ...]:
    """Friction torque of the joint fit, per joint. Shapes (rows,)."""
    values = fitted.theta.copy()
    size = len(nominal.model.coefficients())
    values[:size] += nominal.model.coefficients()
    braking = []
    start = len(nominal.model.inertial)
    for effect, count in [
        *((t.effect, len(t.theta)) for t in nominal.model.terms),
        *((g.effect, len(g.ids)) for g in groups),
    ]:
        if EffectTrait.FRICTION in effect.traits:
            braking += range(start, start + count)
        start += count
    ids, values = fitted.ids[braking], values[braking]
    out = []
    for j in range(design.dof):
        place, have = design.present(j, ids)
        out.append(design.columns(j, place) @ values[have])
    return tuple(out)


def _layout(
    logs: FitLogs, first: int, design: Design, block: float
) -> tuple[tuple[RowLayout, ...], int]:
    labels, second, number, total = [], [], [], 0
    for i, track in enumerate(logs.tracks):
        t = np.arange(len(track.tau)) * track.step / track.rate
        own = (t // block).astype(int)
        labels.append(np.repeat((total + own)[:, None], design.dof, axis=1))
        second.append(np.full((len(t), design.dof), i >= first))
        number.append(np.full((len(t), design.dof), i))
        total += int(own[-1]) + 1
    stacks = [design.stacked(x) for x in (second, number, labels)]
    out = []
    for is_second, log, label in zip(*stacks, strict=True):
        blocks, starts = np.unique(label, return_index=True)
        out.append(RowLayout(is_second.astype(bool), log, starts, blocks))
    return tuple(out), total


# One joint's rows with what any arm has projected out, block by block.
#
# A contrast of columns against what is left then needs sums over blocks alone: errors
# within two seconds are anything, those of different blocks are independent. Each block
# is judged by a fit that left it out (jackknife; MacKinnon, Nielsen & Webb 2023).


RIDGE = 1e-5  # of the rows: keeps what no motion shows where the joint fit has it
LEAST = 1e-3  # of a row's error that a fit leaves in any case
OWN = 1e-3  # of a column's square: below, the nuisance has it already


@dataclass(frozen=True, eq=False, slots=True)
class ProjectedColumns:
    """Columns of one candidate on one joint, sums over the rows of each block.

    With a nuisance that is held to what is usual, generalised least squares has two
    Gram matrices: ``gram`` is the information, ``plain`` the part of its variance that
    is due to errors of single rows; the rest is due to what logs may differ by.
    """

    columns: Array  # what the nuisance leaves of them, (rows, k)
    lifted: Array  # the same, each block as a fit without it would see it, (rows, k)
    raw: Array  # the columns, without what may have been there before, (rows, k)
    plain: Array
    # Products of ``columns`` with ``raw`` and themselves, (k, k).
    gram: Array
    cross: Array  # product with the torque, (k,)
    lever: Array  # products of both by block, (blocks, k, k)
    pull: Array  # products with the torque by block, (blocks, k)


class JointRows:
    """One joint, ready for contrasts.

    Attributes:
        layout: Where its rows come from.
        y: Torque that the nuisance leaves [N m]. Shape (rows,).
    """

    def __init__(
        self,
        shared: Array,
        y: Array,
        layout: RowLayout,
        precisions: Array | None = None,
        light: bool = False,
    ) -> None:
        """Project the nuisance out.

        Args:
            shared: Its columns. Shape (rows, p).
            y: Torque less that of the nominal model [N m]. Shape (rows,).
            precisions: Prior precision of each, times the variance of independent
                rows. Shape (p,).
            light: Whether it is there to project only.
        """
        size = np.sqrt((shared**2).mean(axis=0))
        real = size > 1e-9 * size.max(initial=1e-30)
        x = shared[:, real] / size[real]
        precision = np.full(x.shape[1], RIDGE * len(y))
        if precisions is not None:
            precision = precision + precisions[real] / size[real] ** 2
        self.layout = layout
        self._x = x
        self._inverse = np.linalg.inv(x.T @ x + np.diag(precision))
        stops = [*layout.starts[1:], len(y)]
        self._blocks = [slice(a, b) for a, b in zip(layout.starts, stops, strict=True)]
        self._keep = [] if light else [self._out_of(own) for own in self._blocks]
        self.y = self.project(y)
        self.degrees = len(y) - float(np.einsum("ij,ji->", self._inverse, x.T @ x))

    def project(self, columns: Array) -> Array:
        """What the nuisance leaves of columns. Shape as given."""
        return columns - self._x @ (self._inverse @ (self._x.T @ columns))

    def _out_of(self, block: slice) -> Array:
        """What makes errors of a block as large as they are without its own pull.

        The square root of the leave-one-out factor: unbiased where rows are alike
        (CR2; Bell & McCaffrey 2002), where the factor itself is twice too much of a
        nuisance that few blocks determine.
        """
        x = self._x[block]
        values, vectors = np.linalg.eigh(np.eye(len(x)) - x @ self._inverse @ x.T)
        return (vectors / np.sqrt(np.maximum(values, LEAST))) @ vectors.T

    def lift(self, columns: Array) -> Array:
        """Projected columns as each block is seen by a fit without it. As given."""
        out = np.empty_like(columns)
        for block, keep in zip(self._blocks, self._keep, strict=True):
            out[block] = keep @ columns[block]
        return out

    def pieces(
        self,
        columns: Array,
        mask: Array,
        sizes: Sequence[int],
        before: Array | None = None,
    ) -> list[ProjectedColumns]:
        """Candidates that act on some rows only, and may have been there before.

        Args:
            columns: Columns of all candidates. Shape (rows, sum of sizes).
            mask: Rows on which they act. Shape (rows,).
            before: What of them may have been there before; the same where None.
        """
        raw = columns * mask[:, None]
        projected = self.project(raw)
        before = columns if before is None else before
        power = (before**2).sum(axis=0)
        before_projected = self.project(before)
        ends = np.cumsum([0, *sizes])
        places = [slice(a, b) for a, b in pairwise(ends)]
        remaining = []
        for at in places:
            b, c = before_projected[:, at], before[:, at]
            gram = b.T @ c + np.diag(OWN * power[at] + 1e-300)
            coefficients = np.linalg.solve(
                gram, c.T @ np.column_stack([projected[:, at], self.y])
            )
            projected[:, at] -= b @ coefficients[:, :-1]
            raw[:, at] -= c @ coefficients[:, :-1]
            remaining.append(self.y - b @ coefficients[:, -1])
        lifted = self.lift(projected)
        return [
            self._piece(projected[:, at], lifted[:, at], raw[:, at], y)
            for at, y in zip(places, remaining, strict=True)
        ]

    def _piece(
        self, projected: Array, lifted: Array, raw: Array, y: Array
    ) -> ProjectedColumns:
        gram = raw.T @ projected
        return ProjectedColumns(
            columns=projected,
            lifted=lifted,
            raw=raw,
            plain=projected.T @ projected,
            gram=0.5 * (gram + gram.T),
            cross=raw.T @ y,
            lever=self._sums(projected[:, :, None] * lifted[:, None, :]),
            pull=self._sums(lifted * y[:, None]),
        )

    def _sums(self, values: Array) -> Array:
        return np.add.reduceat(values, self.layout.starts, axis=0)

    def levers(self, first: ProjectedColumns, second: ProjectedColumns) -> Array:
        """Products of two candidates by block. Shape (blocks, k, l)."""
        return self._sums(first.columns[:, :, None] * second.lifted[:, None, :])
