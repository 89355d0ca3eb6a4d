"""Which form of correction each joint gets, decided on runs left out.

The order of options is from simple to involved: nothing, least squares, main effects,
the same with load, named pairs, all pairs. A joint takes the first that is as good as
the best within one standard error of the difference over runs, and nothing is always
among them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.recording import Array
from residual.tables.crossval import (
    Folds,
    HeldOut,
    as_names,
    as_pair,
    check_varying,
    fold_power,
    frozen,
    leave_one_out,
    simplest,
)
from residual.tables.form import (
    LEAST_SQUARES,
    LOADED,
    MAIN,
    NAMED,
    NONE,
    PAIRS,
    Base,
    EffectForm,
    Option,
    Rest,
    fit_base,
    fit_rest,
)
from residual.tables.levels import Levels
from residual.tables.lookup import Axis, Lookup, Table

PROVEN = 3  # runs from which on a choice among them can be trusted


def build_lookup(
    base: Base, rest: Rest, chosen: Sequence[Option], form: EffectForm
) -> Lookup:
    """Return the tables of all joints; a joint without a table has zeros in it.

    Loads become variables, after all others, only if a joint takes them.
    """
    levels, joints = base.main[0].levels, len(chosen)
    offset, slope = np.zeros(joints), np.zeros((len(levels.names), joints))
    main = [np.zeros((size, joints)) for size in levels.sizes]
    for j, option in enumerate(chosen):
        if option.kind == LEAST_SQUARES:
            offset[j], slope[:, j] = (part[..., j] for part in base.linear)
        if option.ridge is not None:
            number = form.ridges.index(option.ridge)
            loaded = option.kind == LOADED
            fit = base.loaded[number].main if loaded else base.main[number]
            offset[j] = fit.offset[j]
            for table, own in zip(main, fit.tables, strict=True):
                table[:, j] = own[:, j]
    axes = [Axis(i, edges) for i, edges in enumerate(levels.edges)]
    tables = [Table((i,), frozen(t)) for i, t in enumerate(main)]
    for found in (_named(rest, chosen), _all_pairs(rest, chosen, offset)):
        if found:
            start = len(axes)
            axes += [Axis(i, edges) for i, edges in enumerate(found[0].edges)]
            tables += [Table((start + a, start + b), t) for (a, b), t in found[1]]
    plain = Lookup(
        levels.names,
        as_names(None, joints, "joint "),
        tuple(axes),
        tuple(t for t in tables if t.values.any()),
        frozen(offset),
        frozen(slope),
        levels.low,
        levels.high,
    )
    return _with_loads(plain, base, chosen, form)


def _with_loads(
    plain: Lookup, base: Base, chosen: Sequence[Option], form: EffectForm
) -> Lookup:
    """The tables of speed and load of those joints that take them, added."""
    takers = [j for j, option in enumerate(chosen) if option.kind == LOADED]
    if not takers:
        return plain
    axes, tables = list(plain.axes), list(plain.tables)
    for j in takers:
        fit = base.loaded[form.ridges.index(chosen[j].ridge)]
        table = np.zeros((*fit.tables[j].shape, len(chosen)))
        table[..., j] = fit.tables[j]
        tables.append(Table((len(axes), len(axes) + 1), frozen(table)))
        for column, place in zip(form.loads[j], (2 * j, 2 * j + 1), strict=True):
            axes.append(Axis(column, fit.levels.edges[place]))
    loads, count = base.loaded[0].levels, len(form.loads)
    names = as_names(form.names, len(plain.names) + count, "x")
    return replace(
        plain,
        names=names,
        axes=tuple(axes),
        tables=tuple(tables),
        slope=frozen(np.vstack([plain.slope, np.zeros((count, len(chosen)))])),
        low=frozen(np.concatenate([plain.low, loads.low[1::2]])),
        high=frozen(np.concatenate([plain.high, loads.high[1::2]])),
    )


_Found = tuple[Levels, list[tuple[tuple[int, int], Array]]]


def _named(rest: Rest, chosen: Sequence[Option]) -> _Found | None:
    tables: dict[tuple[int, int], Array] = {}
    for j, option in enumerate(chosen):
        used = rest.named[j][: option.count] if option.kind == NAMED else ()
        for pair in used:
            empty = np.zeros((*pair.values.shape, len(chosen)))
            table = tables.setdefault(pair.axes, empty)
            table[..., j] += pair.values
    return (rest.levels, list(tables.items())) if tables else None


def _all_pairs(rest: Rest, chosen: Sequence[Option], offset: Array) -> _Found | None:
    """Tables of the joints that take all pairs; their offsets are added in place."""
    model = rest.pairs
    takers = [j for j, option in enumerate(chosen) if option.kind == PAIRS]
    if model is None or not takers:
        return None
    tables = [np.zeros_like(table) for table in model.tables()]
    for j in takers:
        count = min(chosen[j].count, model.components)
        offset[j] += model.offset(count)[j]
        for table, own in zip(tables, model.tables(count), strict=True):
            table[..., j] = own[..., j]
    return model.levels, list(zip(model.pairs, tables, strict=True))


@dataclass(frozen=True, eq=False, slots=True)
class EffectModel:
    """The default form, fitted to all rows."""

    # The correction; loads are variables of it only where a joint takes them.
    lookup: Lookup
    chosen: tuple[Option, ...]  # option of each joint
    # The fits behind the tables.
    base: Base
    rest: Rest


def fit_effect_tables(
    X: Array,
    Y: Array,
    run: Array,
    torque: Array,
    form: EffectForm | None = None,
) -> EffectModel:
    """Fit the default form and choose its parts on runs left out.

    Args:
        X: Variables: q, qd, qdd of the joints in question, then their loads. (n, d).
        Y: What the nominal model leaves: the residual [N m]. Shape (n, j).
        run: Run of each row. Shape (n,).
        torque: Measured torque, which errors are relative to [N m]. Shape (n, j).

    Raises:
        InputError: On a single run, a constant column, or blocks that do not fit.
    """
    X, Y = as_pair(X, Y)
    form = form or EffectForm()
    folds = leave_one_out(run)
    _check_runs(X, folds, form)
    power = fold_power(torque, folds)
    bases = [fit_base(X[k], Y[k], form) for k in _training(folds)]
    pairs = zip(_training(folds), bases, strict=True)
    seen = [base.predict(X[~keep], form) for keep, base in pairs]
    # The stiffest ridge is the simplest.
    order = np.argsort(form.ridges)[::-1]
    gaps = [
        ((Y[~keep] - main[order]) ** 2).sum(axis=1)
        for keep, (_, main, _) in zip(_training(folds), seen, strict=True)
    ]
    errors = HeldOut(folds.scheme, np.stack(gaps, axis=1), power)
    ridge = [int(order[simplest(errors, j)]) for j in range(Y.shape[1])]
    miss = _all_options(X, Y, folds, bases, seen, form, ridge)
    errors = HeldOut(folds.scheme, miss, power)
    options = list_options(form)
    if folds.count >= PROVEN:
        picked = [simplest(errors, j) for j in range(Y.shape[1])]
    else:  # on two runs only what helps both of them
        picked = np.where((miss[2] < miss[0]).all(axis=0), 2, 0)
    base = fit_base(X, Y, form)
    rest = fit_rest(X, Y - _main(base, X, ridge, form), np.asarray(run), form)
    chosen = tuple(
        replace(options[p], ridge=form.ridges[r] if options[p].tabled else None)
        for p, r in zip(picked, ridge, strict=True)
    )
    lookup = build_lookup(base, rest, chosen, form)
    return EffectModel(lookup, chosen, base, rest)


def list_options(form: EffectForm) -> tuple[Option, ...]:
    """The options of a joint from simple to involved, its ridge left open."""
    components = form.pairs.components if form.pairs else 0
    return (
        Option(NONE),
        Option(LEAST_SQUARES),
        Option(MAIN),
        *((Option(LOADED),) if form.loads else ()),
        *(Option(NAMED, count=n + 1) for n in range(form.named)),
        *(Option(PAIRS, count=n + 1) for n in range(components)),
    )


def _check_runs(X: Array, folds: Folds, form: EffectForm) -> None:
    """Refuse a variable that varies in one run only: nothing checks its table."""
    X = form.states(X)
    names = as_names(form.state_names(), X.shape[1], "x")
    check_varying(X, names)
    for name, keep in zip(folds.names, _training(folds), strict=True):
        check_varying(X[keep], names, f"all but run {name},")


def _training(folds: Folds) -> list[Array]:
    return [folds.of_row != fold for fold in range(folds.count)]


def _all_options(X, Y, folds, bases, seen, form, ridge) -> Array:
    """Squared errors of every option in every fold. Shape (options, folds, j)."""
    run = folds.of_row
    miss = []
    for keep, base, (linear, by_ridge, with_loads) in zip(
        _training(folds), bases, seen, strict=True
    ):
        left = Y[keep] - _main(base, X[keep], ridge, form)
        rest = fit_rest(X[keep], left, run[keep], form)
        main = of_joints(by_ridge, ridge)
        loaded = [of_joints(with_loads, ridge)] if form.loads else []
        more = main + rest.predict(X[~keep], form)
        guess = [np.zeros_like(main), linear, main, *loaded, *more]
        miss.append(((Y[~keep] - np.stack(guess)) ** 2).sum(axis=1))
    return np.stack(miss, axis=1)


def _main(base: Base, X: Array, ridge: list[int], form: EffectForm) -> Array:
    return of_joints(base.predict(X, form)[1], ridge)


def of_joints(by_ridge: Array, ridge: list[int]) -> Array:
    """Each joint's column from the fit of its own ridge. (ridges, m, j) to (m, j)."""
    return np.stack([by_ridge[r, :, j] for j, r in enumerate(ridge)], axis=1)
