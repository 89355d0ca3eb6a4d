"""How many levels and components: chosen on runs left out, variable by variable.

The paper takes 22 levels from trials on rows that it had seen, and asks for "a
mathematical method" (section 2.6.2). Here the criterion is the error on runs left out:
first one number for all variables with the number of components, then each variable in
turn may halve or double its own. The simplest choice within one standard error counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.recording import Array
from residual.tables.blocks import as_pair
from residual.tables.crossval import HeldOut, leave_one_out, simplest
from residual.tables.levels import merge_rows
from residual.tables.nominal.crossval import nominal_errors
from residual.tables.nominal.pls import NominalForm, component_bound

SWEEP = (2, 3, 4, 6, 8, 12, 16, 22, 30, 40)
NARROWEST, WIDEST = 2, 80


@dataclass(frozen=True, slots=True)
class ChosenLevels:
    """The form that was chosen, and what it was chosen from.

    Attributes:
        form: Levels of each variable, and components.
        components: Components, 0 where none is better than the mean.
        common: Number of levels of all variables that was best before each had its own.
    """

    form: NominalForm
    components: int
    common: int


def choose_levels(
    X: Array,
    Y: Array,
    group: Array,
    torque: Array,
    form: NominalForm,
    levels: Sequence[int] = SWEEP,
) -> ChosenLevels:
    """Choose levels and components of the paper's form.

    Args:
        X: Variables. Shape (n, d).
        Y: Responses [N m]. Shape (n, j).
        group: Run of each row, or block where runs are few. Shape (n,).
        torque: Measured torque, which errors are relative to [N m]. Shape (n, j).
        form: The form; its components are the most that are tried.

    Raises:
        InputError: On a single group, a constant column, or blocks that do not fit.
    """
    X, Y = as_pair(X, Y)
    data = (X, Y, leave_one_out(group), torque)
    common, count = _common(data, form, levels)
    own = (common,) * X.shape[1]
    if count:
        own = _own_levels(data, replace(form, levels=own, components=count))
    made = replace(form, levels=own, components=max(count, 1))
    return ChosenLevels(made, count, common)


def _common(data: tuple, form: NominalForm, levels: Sequence[int]) -> tuple[int, int]:
    """One number of levels for all variables, and the number of components."""
    choices, miss = [], []
    for one in levels:
        found = _errors(data, replace(form, levels=one))
        choices += [(one, count) for count in range(len(found.miss))]
        miss.append(found.miss)
    # From simple to involved: by the numbers that a response is made of.
    order = sorted(
        range(len(choices)), key=lambda i: choices[i][1] * choices[i][0] ** 2
    )
    errors = HeldOut(found.scheme, np.concatenate(miss)[order], found.power)
    return choices[order[simplest(errors, 0)]]


def _own_levels(data: tuple, form: NominalForm) -> tuple[int, ...]:
    """Half, as many or twice the levels, each variable in turn."""
    own = list(form.levels)
    for variable, now in enumerate(own):
        tried = sorted({max(now // 2, NARROWEST), now, min(2 * now, WIDEST)})
        miss = []
        for count in tried:
            own[variable] = count
            found = _errors(data, replace(form, levels=tuple(own)))
            miss.append(found.miss[-1])
        errors = HeldOut(found.scheme, np.stack(miss), found.power)
        own[variable] = tried[simplest(errors, 0)]
    return tuple(own)


def _errors(data: tuple, form: NominalForm) -> HeldOut:
    """Errors of all joints together, each relative to its torque. (A + 1, F, 1)."""
    X, Y, folds, torque = data
    bound = component_bound(merge_rows(form.make_levels(X).encode(X)))
    form = replace(form, components=min(form.components, bound))
    (found,) = nominal_errors(X, Y, [folds], torque, form)
    whole = found.power.sum(axis=0)
    size = np.where(whole > 0, whole, np.inf)
    miss = (found.miss / size).sum(axis=2, keepdims=True)
    return HeldOut(found.scheme, miss, (found.power / size).sum(axis=1, keepdims=True))
