"""The default form of the data-driven correction: main effects, then a few pairs.

Per joint one of: nothing, least squares, main effects, main effects with a table of
speed and load, with up to three named pair tables, or with all pair tables by PLS.
`residual/tables/choose.py` chooses among them on runs left out; the study behind it
says why in this order.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.recording import Array
from residual.tables.crossval import as_block, as_pair, frozen
from residual.tables.levels import Levels, quantile_levels
from residual.tables.lookup import Table
from residual.tables.main_tables import (
    LEVELS,
    MOST,
    PYRAMID,
    RIDGES,
    MainEffects,
    Normal,
    Pyramid,
    add_pairs,
    main_effects,
    make_pyramid,
    normal_equations,
    read_pairs,
    root_of,
    unite,
)
from residual.tables.nominal_pls import (
    NominalForm,
    NominalPls,
    fit_nominal_pls,
)

WIDTHS = (6, 12)  # levels of either; speeds part at standstill
NONE, LEAST_SQUARES, MAIN = "none", "least squares", "main effects"
PLSR = "plsr"  # least squares in fewer directions; chosen by `residual.calibration`
LOADED, NAMED, PAIRS = "main effects and load", "named pairs", "all pairs"


# Main effects beside a table of speed and load: friction that grows with the load.
#
# Friction of a gear depends on its speed and on the torque that it carries, and that
# torque is known: it is the model's. One small table of both per joint is fitted
# together with the main effects; fitted after them it would find that they have already
# learnt the load as a function of the path.


@dataclass(frozen=True, eq=False, slots=True)
class Loaded:
    """Main effects and each joint's table of speed and load, for one ridge."""

    main: MainEffects  # the main effects; other ones than without the tables
    levels: Levels  # levels of the speeds and the loads, in pairs, joint by joint
    # Correction by level of speed and of load, of zero mean over the calibration rows
    # [N m]. One of shape (k1, k2) per joint.
    tables: tuple[Array, ...]

    def predict(self, X: Array, speeds_and_loads: Array) -> Array:
        """Return main effects and tables [N m]. Shape (m, j)."""
        codes = self.levels.encode(speeds_and_loads).values
        out = self.main.predict(X)
        for j, table in enumerate(self.tables):
            out[:, j] += table[codes[:, 2 * j], codes[:, 2 * j + 1]]
        return out


def fit_loaded(
    normal: Normal, pyramid: Pyramid, pairs: Array, Y: Array, ridges: Sequence[float]
) -> tuple[Loaded, ...]:
    """Fit main effects together with one table per joint, once per ridge.

    The equations of the main effects are solved already; what a table adds is a Schur
    complement of its own size. Pairs are speed [rad/s] and load [N m] of each joint by
    turns, shape (n, 2 j); ridges, per 20 000 rows, are of tables as of main effects.
    """
    speeds = tuple(range(0, pairs.shape[1], 2))
    layers = [
        quantile_levels(pairs, width, velocities=speeds, constant=True)
        for width in WIDTHS
    ]
    edges, groups = zip(*unite(layers), strict=True)
    levels = replace(layers[0], edges=edges)
    codes = levels.encode(pairs)
    solved = []
    for j in range(Y.shape[1]):
        both = slice(2 * j, 2 * j + 2)
        # Numbers of the cells of a table, in each width.
        crossed = [
            np.add.outer(a * (b.max() + 1), b).ravel()
            for a, b in zip(*groups[both], strict=True)
        ]
        root = root_of(crossed)
        cells = codes.values[:, both].astype(np.int64).T
        cell = np.ravel_multi_index(cells, codes.sizes[both])
        solved.append(_solve(normal, cell, codes.sizes[both], root, Y[:, j], j, ridges))
    fits = []
    for ridge, joints in zip(ridges, zip(*solved, strict=True), strict=True):
        coefficients, tables = zip(*joints, strict=True)
        main = normal.effects(pyramid.levels, np.column_stack(coefficients), ridge)
        fits.append(Loaded(main, levels, tables))
    return tuple(fits)


def _solve(
    normal: Normal,
    cell: Array,
    sizes: Sequence[int],
    root: Array,
    y: Array,
    joint: int,
    ridges: Sequence[float],
) -> list[tuple]:
    """Coefficients of the main effects and a table of one joint, by ridge.

    Given each row's cell, and the root of the penalty on cells. (n,), (cells, k).
    """
    n = len(y)
    count = np.bincount(cell, minlength=len(root))
    share = count / n
    cross = normal.cross(cell, share) @ root
    own = root.T @ (np.diag(count) - n * np.outer(share, share)) @ root
    right = root.T @ (np.bincount(cell, y, len(root)) - count * y.mean())
    out = []
    for ridge in ridges:
        stiff = normal.scaled(ridge)
        inverse = 1.0 / (normal.values + stiff)
        known = inverse * normal.right[:, joint]
        schur = own - cross.T @ (inverse[:, None] * cross) + stiff * np.eye(len(own))
        solved = np.linalg.solve(schur, right - cross.T @ known)
        table = root @ solved
        table = frozen((table - share @ table).reshape(sizes))
        out.append((known - inverse * (cross @ solved), table))
    return out


# Sparse: dense pair tables were no better on unseen runs, with twenty times the cells.
PAIR_FORM = NominalForm(22, 15, "quantile", scale_y=True, sparsity=0.5)


@dataclass(frozen=True, slots=True)
class EffectForm:
    """What may be chosen from."""

    # Columns that hold velocities: their levels part at standstill.
    velocities: tuple[int, ...] = ()
    names: tuple[str, ...] | None = None  # names of the variables
    # Column of each joint's speed and of its load, which is the model's torque [N m].
    # The columns of loads are the last; they have no table of their own.
    loads: tuple[tuple[int, int], ...] = ()
    # Levels of the main effects, from wide to narrow.
    pyramid: tuple[int, ...] = PYRAMID
    ridges: tuple[float, ...] = RIDGES  # ridges of the main effects per 20 000 rows
    named: int = MOST  # named pair tables at most
    # All pair tables by PLS, with the most components tried and the velocities above;
    # None for none.
    pairs: NominalForm | None = PAIR_FORM

    def states(self, X: Array) -> Array:
        """Columns other than loads. Shape (n, d - loads)."""
        return X[:, : X.shape[1] - len(self.loads)]

    def speeds_and_loads(self, X: Array) -> Array:
        """Speed and load of each joint by turns. Shape (n, 2 loads)."""
        return X[:, [column for pair in self.loads for column in pair]]

    def state_names(self) -> tuple[str, ...] | None:
        """Names of the columns other than loads."""
        return self.names and self.names[: len(self.names) - len(self.loads)]


@dataclass(frozen=True, slots=True)
class Option:
    """One choice for one joint."""

    kind: str  # one of the seven constants of this module
    ridge: float | None = None  # ridge of the main effects, where there are any
    count: int = 0  # named pair tables, or components: of all pair tables, of PLSR

    @property
    def tabled(self) -> bool:
        """Whether it has main effects."""
        return self.kind in (MAIN, LOADED, NAMED, PAIRS)


@dataclass(frozen=True, eq=False, slots=True)
class Base:
    """What needs no choice before it: least squares, and main effects by ridge."""

    # Least squares with a constant, the LS of the paper's table 1: constant (j,), and
    # coefficients in units of Y per unit of X (d, j).
    linear: tuple[Array, Array]
    main: tuple[MainEffects, ...]  # main effects, one fit per ridge of the form
    # The same with tables of speed and load; none where there are no loads.
    loaded: tuple[Loaded, ...]

    def predict(self, X: Array, form: EffectForm) -> tuple[Array, Array, Array]:
        """Return corrections [N m] by least squares, main effects, and with loads.

        Shapes (m, j), (ridges, m, j) and the same, or (0,) where there are no loads.
        """
        X = as_block(X, "X")
        plain, loads = form.states(X), form.speeds_and_loads(X)
        codes = self.main[0].levels.encode(plain)
        offset, slope = self.linear
        main = np.stack([fit.read(codes) for fit in self.main])
        loaded = [fit.predict(plain, loads) for fit in self.loaded]
        return offset + plain @ slope, main, np.array(loaded)


@dataclass(frozen=True, eq=False, slots=True)
class Rest:
    """Pair tables on what main effects leave, each joint by its own ridge."""

    levels: Levels  # levels of the named tables
    # Named tables of each joint, in the order they were found.
    named: tuple[tuple[Table, ...], ...]
    # All pair tables by PLS, None where the form leaves them out.
    pairs: NominalPls | None

    def predict(self, X: Array, form: EffectForm) -> Array:
        """What comes on top of main effects, by option. (named + A, m, j).

        First 1, 2 ... named tables, then 1, 2 ... components of all tables; where
        fewer were found, the last ones repeat.
        """
        X = form.states(X)
        codes = self.levels.encode(X)
        by_joint = [read_pairs(found, codes) for found in self.named]
        out = [
            np.stack([part[min(n + 1, len(part) - 1)] for part in by_joint], axis=1)
            for n in range(form.named)
        ]
        if self.pairs is not None:
            scores, mean = self.pairs.transform(X), self.pairs.y_mean
            Q = self.pairs.Q * self.pairs.y_scale
            for a in range(1, form.pairs.components + 1):
                out.append(mean + scores[:, :a] @ Q[:a])
        empty = np.zeros((0, len(codes.values), len(self.named)))
        return np.stack(out) if out else empty


def fit_base(X: Array, Y: Array, form: EffectForm) -> Base:
    """Fit least squares and main effects."""
    X, Y = as_pair(X, Y)
    plain, names = form.states(X), form.state_names()
    pyramid = make_pyramid(plain, form.pyramid, names, velocities=form.velocities)
    normal = normal_equations(plain, Y, pyramid)
    main = main_effects(normal, pyramid, form.ridges)
    loaded: tuple[Loaded, ...] = ()
    if form.loads:
        pairs = form.speeds_and_loads(X)
        loaded = fit_loaded(normal, pyramid, pairs, Y, form.ridges)
    return Base(fit_linear(plain, Y), main, loaded)


def fit_rest(
    X: Array,
    rest: Array,
    run: Array,
    form: EffectForm,
    options: Sequence[Option] | None = None,
) -> Rest:
    """Fit pair tables to what main effects leave of the responses [N m], shape (n, j).

    A named table must predict each run from the others. Only tables that some option
    takes are fitted, or all of them: they are most of the work.
    """

    def taken(kind: str, j: int) -> bool:
        return options is None or options[j].kind == kind

    X, joints = form.states(X), range(rest.shape[1])
    levels = quantile_levels(X, LEVELS, form.state_names(), velocities=form.velocities)
    codes = levels.encode(X)
    named = tuple(
        add_pairs(codes, rest[:, j], run, form.named) if taken(NAMED, j) else ()
        for j in joints
    )
    if form.pairs is None or not any(taken(PAIRS, j) for j in joints):
        return Rest(levels, named, None)
    pairs = replace(form.pairs, velocities=form.velocities)
    every = pairs.make_levels(X, form.state_names())
    # Short logs bear fewer components; nobody asked for just so many here.
    return Rest(levels, named, fit_nominal_pls(X, rest, pairs, every, fewer=True))


def fit_linear(X: Array, Y: Array) -> tuple[Array, Array]:
    """Least squares of Y: a constant (j,), and coefficients of X's columns (d, j)."""
    mean, scale = X.mean(axis=0), X.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    slope = np.linalg.lstsq((X - mean) / scale, Y - Y.mean(axis=0), rcond=None)[0]
    slope = slope / scale[:, None]
    return Y.mean(axis=0) - mean @ slope, slope
