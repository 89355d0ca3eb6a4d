"""Fitted models turned into look-up tables."""

from collections.abc import Sequence

from residual.tables.blocks import as_names
from residual.tables.lookup.lookup import Lookup, no_slope
from residual.tables.lookup.pack import Axis, Table
from residual.tables.nominal.pls import NominalPls


def nominal_lookup(
    model: NominalPls,
    components: int | None = None,
    joints: Sequence[str] | None = None,
) -> Lookup:
    """The paper form as its 36 tables per joint.

    Args:
        components: Leading components to use; all if None.

    Raises:
        InputError: If there are not so many components, or names.
    """
    levels, offset = model.levels, model.offset(components)
    axes = tuple(Axis(i, edges) for i, edges in enumerate(levels.edges))
    pairs = zip(model.pairs, model.tables(components), strict=True)
    return Lookup(
        levels.names,
        as_names(joints, len(offset), "joint "),
        axes,
        tuple(Table(pair, values) for pair, values in pairs),
        offset,
        no_slope(len(levels.names), len(offset)),
        levels.low,
        levels.high,
    )
