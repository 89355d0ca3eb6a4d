"""The chosen options of all joints put together into one set of look-up tables."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.recording import Array
from residual.tables.blocks import as_names, frozen
from residual.tables.form import (
    LEAST_SQUARES,
    LOADED,
    NAMED,
    PAIRS,
    Base,
    EffectForm,
    Option,
    Rest,
)
from residual.tables.levels import Levels
from residual.tables.lookup.lookup import Lookup, live_tables
from residual.tables.lookup.pack import Axis, Table


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
            offset[j] = base.linear.offset[j]
            slope[:, j] = base.linear.slope[:, j]
        if option.ridge is not None:
            number = form.ridges.index(option.ridge)
            loaded = option.kind == LOADED
            fit = base.loaded[number].main if loaded else base.main[number]
            offset[j] = fit.offset[j]
            for table, own in zip(main, fit.tables, strict=True):
                table[:, j] = own[:, j]
    axes = [*_axes(levels)]
    tables = [Table((i,), frozen(t)) for i, t in enumerate(main)]
    for found in (_named(rest, chosen), _all_pairs(rest, chosen, offset)):
        if found:
            start = len(axes)
            axes += _axes(found[0])
            tables += [Table((start + a, start + b), t) for (a, b), t in found[1]]
    plain = Lookup(
        levels.names,
        as_names(None, joints, "joint "),
        tuple(axes),
        live_tables(tables),
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
            empty = np.zeros((*pair.table.shape, len(chosen)))
            table = tables.setdefault(pair.variables, empty)
            table[..., j] += pair.table
    return (rest.levels, list(tables.items())) if tables else None


def _all_pairs(rest: Rest, chosen: Sequence[Option], offset: Array) -> _Found | None:
    """Tables of the joints that take all pairs; their offsets are added in place."""
    model = rest.pairs
    takers = [j for j, option in enumerate(chosen) if option.kind == PAIRS]
    if model is None or not takers:
        return None
    tables = [np.zeros((*shape, len(chosen))) for shape in _shapes(model)]
    for j in takers:
        count = min(chosen[j].count, model.components)
        offset[j] += model.offset(count)[j]
        for table, own in zip(tables, model.tables(count), strict=True):
            table[..., j] = own[..., j]
    return model.levels, list(zip(model.pairs, tables, strict=True))


def _shapes(model) -> list[tuple[int, int]]:
    sizes = model.levels.sizes
    return [(sizes[a], sizes[b]) for a, b in model.pairs]


def _axes(levels: Levels) -> list[Axis]:
    return [Axis(i, edges) for i, edges in enumerate(levels.edges)]
