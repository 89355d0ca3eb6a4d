"""Which correction each joint gets: what leaves least on runs or blocks left out.

`residual/tables/choose.py` proposes tables of several variables. Here its proposal
stands beside what anyone would try first: nothing, a constant, PLSR of the states with
every number of components, least squares, main effects by ridge, the same with load.
Each is fitted to the other runs and judged on the one left out, with a nominal model
that has not seen it: what a model leaves on runs that it was identified from is
smaller, and of another shape, than what it leaves on others.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.calibration.rows import FEW
from residual.model.compare import is_sure
from residual.recording import Array
from residual.tables.choose import (
    PROVEN,
    EffectModel,
    build_lookup,
    fit_effect_tables,
    of_joints,
)
from residual.tables.components import fit_pls
from residual.tables.form import (
    LEAST_SQUARES,
    LOADED,
    MAIN,
    NAMED,
    NONE,
    PAIRS,
    PLSR,
    Base,
    EffectForm,
    Option,
    fit_base,
    fit_linear,
    fit_rest,
)
from residual.tables.lookup import Lookup

# How surely a correction is better than nothing, one-sided. To take nothing has its
# price too, so one in ten by chance, and not the hundredth that a model is blamed at.
LIKELY = 0.9


@dataclass(frozen=True, eq=False, slots=True)
class Training:
    """Rows to fit.

    Attributes:
        X: States. Shape (n, d).
        Y: What the nominal model leaves [N m]. Shape (n, j).
        run: Run of each row. Shape (n,).
        tau: Measured torque [N m]. Shape (n, j).
        part: Part of each row, a block of its run. Shape (n,).
        second: Second that each row is in, through all runs. Shape (n,).
        moving: Whether a row counts for a joint; None where all do. Shape (n, j), bool.
        without: What a nominal model leaves on these rows that has not seen some more
            parts; None where Y does not depend on the rows.
    """

    X: Array
    Y: Array
    run: Array
    tau: Array
    part: Array
    second: Array
    moving: Array | None = None
    without: Callable[[Collection[int]], Array] | None = None

    @property
    def loaded(self) -> Array:
        """States, then what each joint carries by the model [N m]. Shape (n, d + j)."""
        return np.hstack([self.X, self.tau - self.Y])

    def rows(self, chosen: Array) -> "Training":
        """Return some of the rows."""
        parts = (self.X, self.Y, self.run, self.tau, self.part, self.second)
        moving = None if self.moving is None else self.moving[chosen]
        return Training(*(part[chosen] for part in parts), moving)

    @property
    def counted(self) -> Array:
        """Whether a row counts for a joint. Shape (n, j), bool."""
        every = np.ones(self.Y.shape, bool)
        return every if self.moving is None else self.moving

    def misses(self, predicted: Array) -> Array:
        """Squared errors [N^2 m^2], none where a joint stands. Shape (n, j)."""
        squares = (self.Y - predicted) ** 2
        return squares if self.moving is None else squares * self.moving

    def taught(self) -> "Training":
        """Return the same where a joint that stands says what it does in motion.

        Friction at standstill may take any value up to breakaway: from such rows a
        table of speed learns one reversal by heart, and an arm that it drives gets that
        at every other one. A line and a step in the joint's own speed, fitted to the
        rows in motion, stand in for them: tables that share such rows with others lean
        on what friction mostly is.
        """
        if self.moving is None or self.moving.all():
            return self
        Y, speeds = self.Y.copy(), self.X.shape[1] // 3
        for j, moves in enumerate(self.moving.T):
            X = np.column_stack([self.X, np.sign(self.X[:, speeds + j])])
            if moves.any():
                offset, slope = fit_linear(X[moves], self.Y[moves][:, [j]])
                Y[~moves, j] = (offset + X[~moves] @ slope)[:, 0]
            else:
                Y[:, j] = 0.0
        # The load, which is torque less what is left, stays as it is.
        return replace(self, Y=Y, tau=self.tau + Y - self.Y)


def corrected(lookup: Lookup, rows: Training) -> Array:
    """Corrections by tables that may need loads. Shape (m, j)."""
    return lookup.predict(rows.loaded[:, : len(lookup.names)])


def chosen_lookup(training: Training, form: EffectForm) -> Lookup:
    """The default form, its options chosen on runs left out of these rows."""
    return lookup_of(training, form, *chosen_model(training, form))


def lookup_of(
    training: Training,
    form: EffectForm,
    model: EffectModel,
    options: Sequence[Option],
) -> Lookup:
    """The tables of a fit of these rows, with each joint's option."""
    lookup = build_lookup(model.base, model.rest, options, form)
    return _with_plsr(lookup, training, options)


def chosen_model(
    training: Training, form: EffectForm
) -> tuple[EffectModel, tuple[Option, ...]]:
    """The default form with the options that leave least on what was left out.

    The best must be better than nothing beyond chance, by blocks of two seconds.

    Of fewer than four runs blocks are left out instead, of which the other blocks of
    the run are fitted: one run, or two, do not span what a third one does. Blocks do
    not show what happens outside the range of their own runs.
    """
    taught, runs = training.taught(), _runs(training)
    X = taught.loaded if form.loads else taught.X
    model = fit_effect_tables(X, taught.Y, runs, taught.tau, form)
    tried = _candidates(model.chosen, form, training.X.shape[1])
    miss = _held_out(training, choice_groups(training), form, tried)
    joints = range(len(model.chosen))
    return model, tuple(tried[_best(miss[..., j])][j] for j in joints)


def choice_groups(training: Training) -> Array:
    """Runs to choose by; their blocks where runs are fewer than four. Shape (n,)."""
    few = len(np.unique(training.run)) < FEW
    return training.part if few else training.run


def _runs(training: Training) -> Array:
    """Runs that a proposal is made by; their blocks where there are two. (n,)."""
    two = len(np.unique(training.run)) < PROVEN
    return training.part if two else training.run


def _candidates(
    proposed: Sequence[Option], form: EffectForm, variables: int
) -> list[tuple[Option, ...]]:
    """What is tried, each with an option per joint: nothing is the first."""
    tables = [Option(MAIN, r) for r in form.ridges]
    tables += [Option(LOADED, r) for r in form.ridges if form.loads]
    lines = [Option(PLSR, count=a) for a in range(variables)]  # of none: a constant
    every = [Option(NONE), *tables, *lines, Option(LEAST_SQUARES)]
    out = [(one,) * len(proposed) for one in every]
    # The others are among these already.
    return out + [tuple(proposed)] * any(o.kind in (NAMED, PAIRS) for o in proposed)


def _best(miss: Array) -> int:
    """Number of the best candidate; the first, nothing, where that may be chance.

    Args:
        miss: Squared errors per second. Shape (candidates, seconds).
    """
    best = int(np.argmin(miss.sum(axis=1)))
    return best if is_sure(miss[0], miss[best], LIKELY) else 0


def _held_out(
    training: Training,
    groups: Array,
    form: EffectForm,
    tried: Sequence[tuple[Option, ...]],
) -> Array:
    """Squared errors of each candidate on groups left out, per second. (c, s, j)."""
    _, second = np.unique(training.second, return_inverse=True)
    out = np.zeros((len(tried), second.max() + 1, training.Y.shape[1]))
    for label in np.unique(groups):
        held = groups == label
        Y = training.Y
        if training.without is not None:
            Y = training.without(np.unique(training.part[held]).tolist())
        rows = replace(training, Y=Y, without=None)
        kept, new = rows.rows(~held).taught(), rows.rows(held)
        for number, guess in enumerate(_guesses(kept, new, form, tried)):
            np.add.at(out[number], second[held], new.misses(guess))
    return out


def _guesses(
    kept: Training, new: Training, form: EffectForm, tried: Sequence[tuple]
) -> list[Array]:
    """Corrections of new rows by every candidate. Shapes (m, j)."""
    base = fit_base(kept.loaded if form.loads else kept.X, kept.Y, form)
    seen = new.loaded if form.loads else new.X
    linear, main, loaded = base.predict(seen, form)
    pls = fit_pls(kept.X, kept.Y)
    by_ridge = {MAIN: main, LOADED: loaded}
    out = []
    for options in tried:
        (one, *_) = options
        if len(set(options)) > 1 or one.kind in (NAMED, PAIRS):
            guess = corrected(fixed_lookup(kept, form, options, base), new)
        elif one.kind in by_ridge:
            guess = by_ridge[one.kind][form.ridges.index(one.ridge)]
        elif one.kind == PLSR:
            offset, slope = pls.linear(one.count)
            guess = offset + new.X @ slope
        else:
            guess = linear if one.kind == LEAST_SQUARES else np.zeros_like(linear)
        out.append(guess)
    return out


def fixed_lookup(
    training: Training,
    form: EffectForm,
    options: Sequence[Option],
    base: Base | None = None,
) -> Lookup:
    """The default form with its options given: nothing is chosen on these rows.

    Args:
        base: What `fit_base` makes of these rows, where it is known.
    """
    training = training.taught()
    X = training.loaded if form.loads else training.X
    base = base or fit_base(X, training.Y, form)
    ridges = [form.ridges.index(o.ridge or form.ridges[-1]) for o in options]
    left = training.Y - of_joints(base.predict(X, form)[1], ridges)
    rest = fit_rest(X, left, _runs(training), form, options)
    return _with_plsr(build_lookup(base, rest, options, form), training, options)


def _with_plsr(lookup: Lookup, training: Training, options: Sequence[Option]) -> Lookup:
    """The same with the linear part of the joints that take PLSR."""
    takers = [j for j, option in enumerate(options) if option.kind == PLSR]
    if not takers:
        return lookup
    pls = fit_pls(training.X, training.taught().Y)
    offset, slope = lookup.offset.copy(), lookup.slope.copy()
    for j in takers:
        own_offset, own_slope = pls.linear(options[j].count)
        offset[j], slope[: len(own_slope), j] = own_offset[j], own_slope[:, j]
    return replace(lookup, offset=offset, slope=slope)
