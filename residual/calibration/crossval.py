"""Which rows are held out together, and relative errors (paper, section 2.5).

The paper's systematic and random schemes hold out rows whose neighbours, or whose
repetition a period later, stay in the training set: they measure memory of the path.
Runs and families held out measure what the model knows of motion that it never saw.
"""

from dataclasses import dataclass

import numpy as np

from residual.quantity import check_count, frozen
from residual.recording import Array

BLOCKS = 20  # paper, section 2.5.2


@dataclass(frozen=True, eq=False, slots=True)
class Folds:
    """Which rows are held out together."""

    of_row: Array  # fold of each row, (n,)
    names: tuple[str, ...]  # name of each fold, such as the run left out

    @property
    def count(self) -> int:
        """Number of folds."""
        return len(self.names)


def relative_error(miss: Array, power: Array) -> Array:
    """Return 100 ||Y* - Yhat|| / ||Y*|| (paper, eq. 29) [%]; NaN without torque."""
    some = np.where(power > 0, power, np.nan)
    return 100 * np.sqrt(np.maximum(miss, 0) / some)


def leave_one_out(labels: Array) -> Folds:
    """Hold out all rows of one label at a time: of one run, or of one family."""
    names, of_row = np.unique(labels, return_inverse=True)
    remedy = "Take more logs, or cut a long one into parts with windows."
    check_count(len(names), 2, len(labels), "number of different runs", remedy)
    return Folds(frozen(of_row.reshape(-1)), tuple(map(str, names)))


def systematic(rows: int, blocks: int = BLOCKS) -> Folds:
    """Hold out sequential blocks of rows (paper, section 2.5.2)."""
    return _in_blocks(np.arange(rows) * blocks // max(rows, 1), blocks)


def random_blocks(rows: int, rng: np.random.Generator, blocks: int = BLOCKS) -> Folds:
    """Hold out randomly drawn rows, equally many each time (paper, section 2.5.3)."""
    return _in_blocks(rng.permutation(rows) % blocks, blocks)


def fold_sums(values: Array, folds: Folds) -> Array:
    """Sum of each column over the rows of each fold. Shapes (n, j), (folds, j)."""
    columns = [np.bincount(folds.of_row, v, folds.count) for v in values.T]
    return np.stack(columns, axis=1)


def _in_blocks(of_row: Array, blocks: int) -> Folds:
    remedy = f"There are {len(of_row)} rows: take longer logs or fewer blocks."
    check_count(blocks, 2, len(of_row), "blocks", remedy)
    return Folds(frozen(of_row), tuple(f"block {i + 1}" for i in range(blocks)))
