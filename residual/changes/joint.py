"""One joint's rows with what any arm has projected out, block by block.

A contrast of columns against what is left then needs sums over blocks alone: errors
within two seconds are anything, those of different blocks are independent. Each block
is judged by a fit that left it out (jackknife; MacKinnon, Nielsen & Webb 2023).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from residual.changes.rows import Layout
from residual.recording import Array

RIDGE = 1e-5  # of the rows: keeps what no motion shows where the joint fit has it
LEAST = 1e-3  # of a row's error that a fit leaves in any case
OWN = 1e-3  # of a column's square: below, the nuisance has it already


@dataclass(frozen=True, eq=False, slots=True)
class JointColumns:
    """Columns of one candidate on one joint, sums over the rows of each block.

    With a nuisance that is held to what is usual, generalised least squares has two
    Gram matrices: ``gram`` is the information, ``plain`` the part of its variance that
    is due to errors of single rows; the rest is due to what logs may differ by.
    """

    columns: Array  # what the nuisance leaves of them, (rows, k)
    lifted: Array  # the same, each block as a fit without it would see it, (rows, k)
    raw: Array  # the columns, without what may have been there before, (rows, k)
    plain: Array
    # Products of ``columns`` with ``raw`` and themselves, (k, k).
    gram: Array
    cross: Array  # product with the torque, (k,)
    lever: Array  # products of both by block, (blocks, k, k)
    pull: Array  # products with the torque by block, (blocks, k)


class JointRows:
    """One joint, ready for contrasts.

    Attributes:
        layout: Where its rows come from.
        y: Torque that the nuisance leaves [N m]. Shape (rows,).
        torque: What the nuisance explains or not: the filtered torque. Shape (rows,).
    """

    def __init__(
        self,
        shared: Array,
        y: Array,
        layout: Layout,
        precisions: Array | None = None,
        light: bool = False,
    ) -> None:
        """Project the nuisance out.

        Args:
            shared: Its columns. Shape (rows, p).
            y: Torque less that of the nominal model [N m]. Shape (rows,).
            precisions: Prior precision of each, times the variance of independent
                rows. Shape (p,).
            light: Whether it is there to project only.
        """
        size = np.sqrt((shared**2).mean(axis=0))
        real = size > 1e-9 * size.max(initial=1e-30)
        x = shared[:, real] / size[real]
        precision = np.full(x.shape[1], RIDGE * len(y))
        if precisions is not None:
            precision = precision + precisions[real] / size[real] ** 2
        self.layout = layout
        self._x = x
        self._inverse = np.linalg.inv(x.T @ x + np.diag(precision))
        stops = [*layout.starts[1:], len(y)]
        self._blocks = [slice(a, b) for a, b in zip(layout.starts, stops, strict=True)]
        self._keep = [] if light else [self._out_of(own) for own in self._blocks]
        self.y = self.project(y)
        self.degrees = len(y) - float(np.einsum("ij,ji->", self._inverse, x.T @ x))

    def project(self, columns: Array) -> Array:
        """What the nuisance leaves of columns. Shape as given."""
        return columns - self._x @ (self._inverse @ (self._x.T @ columns))

    def _out_of(self, block: slice) -> Array:
        """What makes errors of a block as large as they are without its own pull.

        The square root of the leave-one-out factor: unbiased where rows are alike
        (CR2; Bell & McCaffrey 2002), where the factor itself is twice too much of a
        nuisance that few blocks determine.
        """
        x = self._x[block]
        values, vectors = np.linalg.eigh(np.eye(len(x)) - x @ self._inverse @ x.T)
        return (vectors / np.sqrt(np.maximum(values, LEAST))) @ vectors.T

    def lift(self, columns: Array) -> Array:
        """Projected columns as each block is seen by a fit without it. As given."""
        out = np.empty_like(columns)
        for block, keep in zip(self._blocks, self._keep, strict=True):
            out[block] = keep @ columns[block]
        return out

    def pieces(
        self,
        columns: Array,
        mask: Array,
        sizes: Sequence[int],
        before: Array | None = None,
    ) -> list[JointColumns]:
        """Candidates that act on some rows only, and may have been there before.

        Args:
            columns: Columns of all candidates. Shape (rows, sum of sizes).
            mask: Rows on which they act. Shape (rows,).
            before: What of them may have been there before; the same where None.
        """
        raw = columns * mask[:, None]
        projected = self.project(raw)
        before = columns if before is None else before
        power = (before**2).sum(axis=0)
        before_projected = self.project(before)
        ends = np.cumsum([0, *sizes])
        places = [slice(a, b) for a, b in pairwise(ends)]
        remaining = []
        for at in places:
            b, c = before_projected[:, at], before[:, at]
            gram = b.T @ c + np.diag(OWN * power[at] + 1e-300)
            coefficients = np.linalg.solve(
                gram, c.T @ np.column_stack([projected[:, at], self.y])
            )
            projected[:, at] -= b @ coefficients[:, :-1]
            raw[:, at] -= c @ coefficients[:, :-1]
            remaining.append(self.y - b @ coefficients[:, -1])
        lifted = self.lift(projected)
        return [
            self._piece(projected[:, at], lifted[:, at], raw[:, at], y)
            for at, y in zip(places, remaining, strict=True)
        ]

    def _piece(
        self, projected: Array, lifted: Array, raw: Array, y: Array
    ) -> JointColumns:
        gram = raw.T @ projected
        return JointColumns(
            columns=projected,
            lifted=lifted,
            raw=raw,
            plain=projected.T @ projected,
            gram=0.5 * (gram + gram.T),
            cross=raw.T @ y,
            lever=self._sums(projected[:, :, None] * lifted[:, None, :]),
            pull=self._sums(lifted * y[:, None]),
        )

    def _sums(self, values: Array) -> Array:
        return np.add.reduceat(values, self.layout.starts, axis=0)

    def levers(self, first: JointColumns, second: JointColumns) -> Array:
        """Products of two candidates by block. Shape (blocks, k, l)."""
        return self._sums(first.columns[:, :, None] * second.lifted[:, None, :])
