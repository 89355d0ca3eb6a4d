"""Main effects beside a table of speed and load: friction that grows with the load.

Friction of a gear depends on its speed and on the torque that it carries, and that
torque is known: it is the model's. One small table of both per joint is fitted together
with the main effects; fitted after them it would find that they have already learnt the
load as a function of the path.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.recording import Array
from residual.tables.blocks import frozen
from residual.tables.levels import Levels, quantile_levels
from residual.tables.main_tables import MainEffects, Normal, Pyramid, root_of, unite

WIDTHS = (6, 12)  # levels of either; speeds part at standstill


@dataclass(frozen=True, eq=False, slots=True)
class Loaded:
    """Main effects and each joint's table of speed and load, for one ridge.

    Attributes:
        main: The main effects; other ones than without the tables.
        levels: Levels of the speeds and the loads, in pairs, joint by joint.
        tables: Correction by level of speed and of load, of zero mean over the
            calibration rows [N m]. One of shape (k1, k2) per joint.
    """

    main: MainEffects
    levels: Levels
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
    """Fit main effects together with one table per joint.

    The equations of the main effects are solved already; what a table adds is a Schur
    complement of its own size.

    Args:
        pairs: Speed [rad/s] and load [N m] of each joint by turns. Shape (n, 2 j).
        Y: Responses [N m]. Shape (n, j).
        ridges: Ridges per 20 000 rows; of the tables as of the main effects.

    Returns:
        One fit per ridge.
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
        sizes = codes.sizes[both]
        first, second = codes.values[:, both].astype(np.int64).T
        root = root_of([_crossed(a, b) for a, b in zip(*groups[both], strict=True)])
        cells = first * sizes[1] + second, sizes, root
        solved.append(_solve(normal, cells, Y[:, j], j, ridges))
    fits = []
    for i, ridge in enumerate(ridges):
        stacked = np.column_stack([joint[i][0] for joint in solved])
        main = normal.effects(pyramid.levels, stacked, ridge)
        fits.append(Loaded(main, levels, tuple(joint[i][1] for joint in solved)))
    return tuple(fits)


def _crossed(first: Array, second: Array) -> Array:
    """Number of each cell of a table in one width. Shape (k1 k2,)."""
    return np.add.outer(first * (second.max() + 1), second).ravel()


def _solve(normal: Normal, cells: tuple, y: Array, joint: int, ridges) -> list[tuple]:
    """Coefficients of the main effects and a table of one joint, by ridge."""
    cell, sizes, root = cells
    size, n = sizes[0] * sizes[1], len(y)
    count = np.bincount(cell, minlength=size)
    share = count / n
    cross = normal.cross(cell, size, share) @ root
    own = root.T @ (np.diag(count) - n * np.outer(share, share)) @ root
    right = root.T @ (np.bincount(cell, y, size) - count * y.mean())
    out = []
    for ridge in ridges:
        inverse = 1.0 / normal.stiffened(ridge)
        known = inverse * normal.right[:, joint]
        schur = own - cross.T @ (inverse[:, None] * cross)
        schur[np.diag_indices(len(schur))] += normal.scaled(ridge)
        solved = np.linalg.solve(schur, right - cross.T @ known)
        rest, table = known - inverse * (cross @ solved), root @ solved
        out.append((rest, frozen((table - share @ table).reshape(sizes))))
    return out
