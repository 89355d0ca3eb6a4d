"""Cross-validation of the nominal-level PLSR: all folds in one pass, all components.

The training sums of a fold are those of all rows less those held out, so a table that
is as wide as there are folds carries every fold's fit at once. A held-out row is a cell
of weight zero: its score comes out of the same pass, and with it its prediction for
every number of components.

How many levels and components: the paper takes 22 levels from trials on rows that it
had seen, and asks for "a mathematical method" (section 2.6.2). Here the criterion is
the error on runs left out: first one number for all variables with the number of
components, then each variable in turn may halve or double its own. The simplest choice
within one standard error counts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from residual.recording import Array
from residual.tables.crossval import (
    EXHAUSTED,
    Folds,
    HeldOut,
    as_pair,
    check_folds,
    fold_power,
    leave_one_out,
    simplest,
)
from residual.tables.levels import Cells, merge_rows
from residual.tables.nominal_pls import (
    NominalForm,
    check_components,
    component_bound,
    response_scale,
)

WIDTH = 8  # folds that share a pass: one cache line of a table
ROOM = 4e7  # numbers that the scores of a pass may take: 320 MB
SWEEP = (2, 3, 4, 6, 8, 12, 16, 22, 30, 40)
NARROWEST, WIDEST = 2, 80


@dataclass(frozen=True, eq=False, slots=True)
class _Held:
    """Held-out rows merged by cell and fold: counts, sums and squares of responses."""

    cell: Array
    fold: Array
    count: Array
    sums: Array
    squares: Array

    def part(self, folds: range) -> "_Held":
        chosen = (self.fold >= folds.start) & (self.fold < folds.stop)
        cut = (self.cell, self.fold - folds.start, self.count, self.sums, self.squares)
        return _Held(*(values[chosen] for values in cut))


def nominal_errors(
    X: Array,
    Y: Array,
    schemes: Sequence[Folds],
    torque: Array,
    form: NominalForm | None = None,
) -> tuple[HeldOut, ...]:
    """Errors of 0 to A components on held-out rows, for several schemes at once.

    Levels are those of all rows: the responses [N m] of held-out rows stay unseen, but
    their range is known. Errors are relative to the measured torque [N m].
    """
    X, Y = as_pair(X, Y)
    form = form or NominalForm()
    cells = merge_rows(form.make_levels(X).encode(X))
    check_components(cells, form.components)
    out = []
    for folds in schemes:
        check_folds(folds, len(X))
        scale = response_scale(Y, form.scale_y)
        miss = _all_folds(cells, Y / scale, folds, form) * scale**2
        out.append(HeldOut(folds.scheme, miss, fold_power(torque, folds)))
    return tuple(out)


def _all_folds(cells: Cells, Y: Array, folds: Folds, form: NominalForm) -> Array:
    """Squared errors of all folds, a few folds at a time. Shape (A + 1, F, j)."""
    held = _held(cells, Y, folds.of_row, folds.count)
    width = int(np.clip(ROOM // (form.components * len(cells.count)), 1, WIDTH))
    starts = range(0, folds.count, width)
    batches = [range(s, min(s + width, folds.count)) for s in starts]
    parts = [_pass(cells, Y, held.part(b), len(b), form) for b in batches]
    return np.concatenate(parts, axis=1)


def _held(cells: Cells, Y: Array, fold: Array, count: int) -> _Held:
    rows = np.flatnonzero(fold >= 0)
    key, place = np.unique(cells.of_row[rows] * count + fold[rows], return_inverse=True)
    sums = [np.bincount(place, y, len(key)) for y in Y[rows].T]
    squares = [np.bincount(place, y * y, len(key)) for y in Y[rows].T]
    number = np.bincount(place, minlength=len(key)).astype(float)
    parts = (number, np.stack(sums, 1), np.stack(squares, 1))
    return _Held(key // count, key % count, *parts)


def _pass(cells: Cells, Y: Array, held: _Held, width: int, form: NominalForm) -> Array:
    """Fit some folds side by side. Squared errors, shape (A + 1, width, j)."""
    from residual.tables.kernels import (
        deflate,
        directions,
        gather_pairs,
        orthogonalise,
        scatter_pairs,
    )

    count, sums = _training(cells, Y, held, width)
    total = count.sum(axis=0)
    y_mean = sums.sum(axis=1) / total
    middle = np.zeros((cells.pair_columns, width))
    scatter_pairs(cells.codes, cells.sizes, count, middle)
    middle /= total
    S = np.zeros((Y.shape[1], *middle.shape))
    for j, table in enumerate(S):
        sums[j] -= count * y_mean[j]
        scatter_pairs(cells.codes, cells.sizes, sums[j], table)
    T = np.zeros((form.components, *count.shape))
    energy = np.ones((form.components, width))
    W, P = np.empty_like(middle), np.empty_like(middle)
    predicted = y_mean.T[held.fold]
    out = [_squared(held, predicted, width)]
    first = None
    for a in range(form.components):
        norm = directions(S, _leading_all(S), W, form.sparsity)
        first = norm if first is None else first
        alive = norm > EXHAUSTED * first
        gather_pairs(cells.codes, cells.sizes, W, T[a])
        T[a] -= (middle * W).sum(axis=0)
        orthogonalise(T, energy, count, a)
        weighted = count * T[a]
        energy[a] = np.where(alive, (weighted * T[a]).sum(axis=0), 1.0)
        P[:] = 0
        scatter_pairs(cells.codes, cells.sizes, weighted, P)
        q = np.stack([(s * T[a]).sum(axis=0) for s in sums]) / energy[a] * alive
        deflate(S, P, middle, weighted.sum(axis=0), q)
        predicted = predicted + (T[a][held.cell, held.fold] * q[:, held.fold]).T
        out.append(_squared(held, predicted, width))
    return np.stack(out)


def _training(cells: Cells, Y: Array, held: _Held, width: int) -> tuple[Array, Array]:
    """Rows and sums that each fold is fitted to. Shapes (c, F), (j, c, F)."""
    count = np.repeat(cells.count[:, None], width, axis=1)
    count[held.cell, held.fold] -= held.count
    sums = np.repeat(cells.sums(Y).T[:, :, None], width, axis=2)
    for j, table in enumerate(sums):
        table[held.cell, held.fold] -= held.sums[:, j]
    return count, sums


def _leading_all(S: Array) -> Array:
    """Eigenvector of S S' to the largest eigenvalue, in each fold. Shape (F, j)."""
    products = [[np.einsum("pf,pf->f", a, b) for b in S] for a in S]
    _, vectors = np.linalg.eigh(np.array(products).transpose(2, 0, 1))
    return np.ascontiguousarray(vectors[:, :, -1])


def _squared(held: _Held, predicted: Array, width: int) -> Array:
    """Sum of (y - yhat)^2 over each fold's rows. Shape (F, j)."""
    gap = held.squares - 2 * predicted * held.sums
    gap += held.count[:, None] * predicted**2
    return np.stack([np.bincount(held.fold, g, width) for g in gap.T], axis=1)


@dataclass(frozen=True, slots=True)
class ChosenLevels:
    """The form that was chosen, and what it was chosen from."""

    form: NominalForm  # levels of each variable, and components
    components: int  # components, 0 where none is better than the mean
    # Number of levels of all variables that was best before each had its own.
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
        group: Run of each row, or block where runs are few. Shape (n,).
        form: The form; its components are the most that are tried.
    """
    X, Y = as_pair(X, Y)
    errors_of = partial(_level_errors, X, Y, leave_one_out(group), torque)
    common, count = _common(errors_of, form, levels)
    own = (common,) * X.shape[1]
    if count:
        own = _own_levels(errors_of, replace(form, levels=own, components=count))
    made = replace(form, levels=own, components=max(count, 1))
    return ChosenLevels(made, count, common)


_Errors = Callable[[NominalForm], HeldOut]


def _common(
    errors_of: _Errors, form: NominalForm, levels: Sequence[int]
) -> tuple[int, int]:
    """One number of levels for all variables, and the number of components."""
    choices, miss = [], []
    for one in levels:
        found = errors_of(replace(form, levels=one))
        choices += [(one, count) for count in range(len(found.miss))]
        miss.append(found.miss)
    # From simple to involved: by the numbers that a response is made of.
    order = sorted(
        range(len(choices)), key=lambda i: choices[i][1] * choices[i][0] ** 2
    )
    errors = HeldOut(found.scheme, np.concatenate(miss)[order], found.power)
    return choices[order[simplest(errors, 0)]]


def _own_levels(errors_of: _Errors, form: NominalForm) -> tuple[int, ...]:
    """Half, as many or twice the levels, each variable in turn."""
    own = list(form.levels)
    for variable, now in enumerate(own):
        tried = sorted({max(now // 2, NARROWEST), now, min(2 * now, WIDEST)})
        miss = []
        for count in tried:
            own[variable] = count
            found = errors_of(replace(form, levels=tuple(own)))
            miss.append(found.miss[-1])
        errors = HeldOut(found.scheme, np.stack(miss), found.power)
        own[variable] = tried[simplest(errors, 0)]
    return tuple(own)


def _level_errors(
    X: Array, Y: Array, folds: Folds, torque: Array, form: NominalForm
) -> HeldOut:
    """Errors of all joints together, each relative to its torque. (A + 1, F, 1)."""
    bound = component_bound(merge_rows(form.make_levels(X).encode(X)))
    form = replace(form, components=min(form.components, bound))
    (found,) = nominal_errors(X, Y, [folds], torque, form)
    whole = found.power.sum(axis=0)
    size = np.where(whole > 0, whole, np.inf)
    miss = (found.miss / size).sum(axis=2, keepdims=True)
    return HeldOut(found.scheme, miss, (found.power / size).sum(axis=1, keepdims=True))
