"""Constants of torque sensors and drives: in the model first, and named last.

A sensor's constant that the model lacks bends everything beside it: over little travel
it is taken for a spring or a balancer. So every joint has one, free, while names are
sought (METHOD 16.2). Then each must lower the error of parts of the logs that were left
out, by what any name must, and be three deviations from nothing; one that does not is
held at zero, and the search goes on. What stands is one finding like any other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.gate import STATIC, cross_validation_errors
from residual.diagnosis.search import (
    SearchTask,
    rank_additions,
    refine_last_shape,
    search_effect_set,
)
from residual.diagnosis.select import Selection
from residual.effects import load_effects
from residual.effects.base import EffectTrait
from residual.evidence.columns import CandidateColumns
from residual.evidence.fit import Fit, NominalPrior
from residual.evidence.priors import HELD, drop_coefficients, hold_coefficients
from residual.evidence.thresholds import THRESHOLDS
from residual.model.model import pair_coefficient_slices
from residual.model.nominal import (
    FitLogs,
    NominalModel,
    build_free_nominal,
    list_known_values,
)
from residual.recording import Array

SWAPS = 3  # names that are tried in the place of constants
ROUNDS = 3  # of holding constants and searching on
SURE = 3.0  # deviations from nothing
# By what the score of a held coefficient is too low, since its prior's volume is that
# of a free one.
HELD_NATS = 0.5 * float(np.log(1 + HELD))


def add_joint_constants(logs: FitLogs, names: Sequence[str]) -> NominalModel:
    """The declared model and, where it says nothing of one, a constant of each joint.

    Args:
        names: The declared effects.
    """
    settled = {*names, *(known.name for known in list_known_values(logs.robot))}
    more = [e.name for e in load_effects().values() if EffectTrait.CONSTANT in e.traits]
    more = [name for name in more if name not in settled]
    nominal = build_free_nominal(logs, (*names, *more))
    terms = [t for t in nominal.model.terms if t.effect.name in more]
    return replace(nominal, constants=len(terms))


def constant_columns(nominal: NominalModel) -> dict[int, int]:
    """Coefficient of each undeclared constant, by its joint from 0."""
    terms = list(
        pair_coefficient_slices(nominal.model.terms, len(nominal.model.inertial))
    )
    mine = terms[len(terms) - nominal.constants :]
    return {term.joints[0]: own.start for term, own in mine}


@dataclass(frozen=True, eq=False, slots=True)
class _FreeConstants:
    """Names and free constants."""

    task: SearchTask  # its prior holds the other constants at zero
    fit: Fit
    free: Mapping[int, int]  # coefficient of each free constant, by its joint

    @property
    def places(self) -> tuple:
        """What is in it, apart from shapes."""
        names = sorted((g.effect.name, g.joints) for g in self.fit.members)
        return *names, *self.free

    def holding(self, joints: Sequence[int]) -> "_FreeConstants":
        """The same with some constants at zero, fitted anew."""
        slots = np.array([self.free[j] for j in joints], dtype=int)
        task = replace(self.task, prior=hold_coefficients(self.task.prior, slots))
        fitted = task.settle(task.fit(self.fit.members, self.fit, rounds=4))
        free = {j: slot for j, slot in self.free.items() if j not in joints}
        return _FreeConstants(task, fitted, free)

    def searched(self) -> "_FreeConstants":
        """The same constants with names sought anew, from those that are there."""
        found = search_effect_set(self.task, self.fit)
        return replace(self, fit=self.task.settle(found))

    def left_out(self) -> Array:
        """Squared error of each fold, predicted from the others. (folds, dof)."""
        return cross_validation_errors(self.task, self.fit)

    def deviations(self, j: int) -> float:
        """Of a constant from nothing."""
        slot = self.free[j]
        sd = np.sqrt(max(self.fit.covariance()[slot, slot], 1e-300))
        return float(abs(self.fit.theta[slot]) / sd)


def drop_unsupported_constants(
    selection: Selection,
    nominal: NominalModel,
    supported_joints: Sequence[int] | None = None,
) -> tuple[Selection, tuple[int, ...]]:
    """Hold the constants that do not pay at zero, and search on without them.

    Args:
        selection: What was found with every constant free.
        supported_joints: Joints (from 0) whose constants alone are to be free at
            first, as those that paid in an earlier search; None for all.

    Returns:
        What is named beside the constants, and the joints (from 0) whose constant pays.
    """
    slots = constant_columns(nominal)
    if not slots:
        return selection, ()
    now = _FreeConstants(selection.task, selection.fit, slots)
    if supported_joints is not None:
        now = now.holding([j for j in slots if j not in supported_joints]).searched()
    for turn in range(ROUNDS):
        before, now = now.places, _prune(now)
        if turn or supported_joints is not None:
            now = _release(now, selection.task, slots)
        now = _simplify(_replace_by_name(now))
        if now.places == before:
            break
        now = now.searched()
    held = [slot for j, slot in slots.items() if j not in now.free]
    wide = hold_coefficients(selection.wide, np.array(held, dtype=int))
    return Selection(now.task, now.fit, wide), tuple(now.free)


def _release(
    now: _FreeConstants, free: SearchTask, slots: Mapping[int, int]
) -> _FreeConstants:
    """Free a held constant that would pay beside what was found since.

    Args:
        free: The task in which none is held.
    """
    held = [j for j in slots if j not in now.free]
    all_free = _FreeConstants(free, now.fit, slots)
    errors = now.left_out()
    for j in held:
        freed = all_free.holding([i for i in held if i != j])
        if _pays(freed, j, freed.left_out()[:, j], errors[:, j]):
            return _prune(replace(freed, free={**now.free, j: slots[j]}))
    return now


def _prune(now: _FreeConstants) -> _FreeConstants:
    """Hold the constants that do not pay at zero, the least missed first."""
    while now.free:
        with_all, power = now.left_out(), now.task.design.tau_power.sum(axis=0)
        missed = {}
        for j in now.free:
            held = now.holding([j])
            errors = held.left_out()
            if not _pays(now, j, with_all[:, j], errors[:, j]):
                missed[j] = (errors - with_all)[:, j].sum() / max(power[j], 1e-30), held
        if not missed:
            break
        now = min(missed.values(), key=lambda one: one[0])[1]
    return now


def _pays(now: _FreeConstants, j: int, with_constant: Array, without: Array) -> bool:
    """Whether a constant lowers its joint's left-out error and is significant."""
    power = max(now.task.design.tau_power.sum(axis=0)[j], 1e-30)
    fall = np.sqrt(max((without - with_constant).sum() / power, 0.0))
    share = 1 - with_constant.sum() / max(without.sum(), 1e-30)
    often = np.mean(without > with_constant) >= THRESHOLDS.min_improved_folds
    clear = bool(now.task.rules.lower(fall, share)) and often
    return clear and now.deviations(j) >= SURE


def _replace_by_name(now: _FreeConstants) -> _FreeConstants:
    """One name in the place of several constants, where beside it they pay no more.

    A load is a constant to each joint that hardly turns. The name must win what any
    must where no constant is free, and predict left-out parts clearly better than the
    constants. In the place of a single one it would not be the simpler: there the
    search finds what is more than a constant.
    """
    if not now.free:
        return now
    without_constants = now.holding(list(now.free))
    tried = 0
    for value, group, _ in rank_additions(
        without_constants.task, without_constants.fit, looks=2 * SWAPS
    ):
        if group.effect.family == STATIC and len(group.ids) == max(len(group.parts), 1):
            continue  # no more than a constant where its joints move
        if value < now.task.rules.min_nats or tried == SWAPS:
            break
        tried += 1
        members = (*now.fit.members, *(group.parts or (group,)))
        task = now.task
        fitted = task.fit(refine_last_shape(task, members, now.fit), now.fit, rounds=4)
        candidate_set = _prune(_FreeConstants(task, task.settle(fitted), now.free))
        if len(candidate_set.free) + 1 < len(now.free):
            weight = candidate_set.fit.weight(task.design.rows)
            fall = (now.left_out() - candidate_set.left_out()).sum(axis=0) @ weight
            if fall > 2 * THRESHOLDS.class_nats:
                return candidate_set
    return now


def _simplify(now: _FreeConstants) -> _FreeConstants:
    """A name that needs no constant in the place of its kin that needs one.

    A spring over little travel is a gas spring and a constant.
    """
    for group in now.fit.members:
        j = group.joints[0] if group.effect.family == STATIC else -1
        if j not in now.free:
            continue
        without_constant = now.holding([j])
        others = tuple(g for g in now.fit.members if g is not group)
        without = without_constant.task.fit(others, now.fit)
        for _, candidate, _ in rank_additions(
            without_constant.task, without, instead=group
        ):
            if candidate.effect.family != STATIC or candidate.joints != group.joints:
                continue
            fitted = without_constant.task.settle(
                without_constant.task.fit((*others, candidate), without)
            )
            if now.fit.score - fitted.score - HELD_NATS < THRESHOLDS.simpler_nats:
                return replace(without_constant, fit=fitted)
    return now


# Constants as names: what stands is said, and held against the logs, like any effect.


@dataclass(frozen=True, eq=False, slots=True)
class ConstantEffects:
    """The same logs with the constants among the effects, not in the model."""

    task: SearchTask
    nominal: NominalModel
    wide: NominalPrior
    groups: tuple[CandidateColumns, ...]  # those that pay


def convert_constants_to_effects(
    task: SearchTask,
    nominal: NominalModel,
    wide: NominalPrior,
    supported_joints: Sequence[int],
) -> ConstantEffects:
    """Take the constants out of the nominal model; nothing is computed anew.

    Args:
        supported_joints: Joints (from 0) whose constant is an effect; that of any
            other joint may be one, and is none.
    """
    count, slots = nominal.constants, constant_columns(nominal)
    terms = nominal.model.terms[-count:]
    ids = {j: task.design.nominal[[slot]] for j, slot in slots.items()}
    design = task.design.drop_last_terms(count)
    groups = [design.group_columns(t, ids[t.joints[0]]) for t in terms]
    gone = np.array(sorted(slots.values()))
    return ConstantEffects(
        replace(
            task,
            design=design,
            prior=drop_coefficients(task.prior, gone),
            candidates=task.candidates.beside(groups),
        ),
        nominal.without_constants(),
        drop_coefficients(wide, gone),
        tuple(g for g in groups if g.joints[0] in supported_joints),
    )
