"""Rows of a calibration, and what nominal models leave on them that saw less."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from residual.calibration.cut import shorten, thinning
from residual.calibration.nominal import (
    Prepared,
    identified_without,
    prepare_runs,
)
from residual.calibration.rows import Rows, Run, measured_rows, paper_rows
from residual.model.model import Model
from residual.model.term import Term
from residual.recording import Array
from residual.robot.robot import Robot


@dataclass(frozen=True, slots=True)
class Asked:
    """What rows are wanted.

    Attributes:
        paper: The paper's regressors and twin error, in place of measured motion.
        declared: Effects that the nominal model has; None for the robot's own list.
        joints: Joints of X and Y, from 1; None for all, or the paper's.
    """

    paper: bool = False
    declared: tuple[str, ...] | None = None
    joints: tuple[int, ...] | None = None


class Source:
    """Rows, and what nominal models leave on them; each is identified once."""

    def __init__(
        self, robot: Robot, runs: Sequence[Run], asked: Asked, named: Sequence[Term]
    ) -> None:
        self._prepared: Prepared | None = None
        self._known: dict[tuple, Array] = {}
        self.nominal: Model | None = None
        self.declared: tuple[str, ...] = tuple(robot.declared)
        self.notes: tuple[str, ...] = ()
        self.named: tuple = ()
        if asked.paper:
            runs, self.notes = shorten(runs)
            self.rows = paper_rows(runs, asked.joints)
            if asked.declared is not None:
                self.notes = (
                    *self.notes,
                    "--declared says nothing with --paper: the twin has what its "
                    "robot declares",
                )
            return
        self._prepared = prepare_runs(robot, runs, asked.declared)
        self.declared = self._prepared.names
        self.nominal = identified_without(self._prepared)
        left = self._prepared.residuals(self.nominal)
        self._thin, self.notes = thinning(runs)
        self._joints = asked.joints
        self.rows = self._rows(left)
        self._known[frozenset(), False] = self.rows.Y
        self.named = named

    def plain(self, left_out: Collection[int]) -> Array:
        """What the nominal model leaves. Shape (n, j)."""
        return self._left(left_out, ())

    def with_effects(self, left_out: Collection[int]) -> Array:
        """What the model with named effects leaves. Shape (n, j)."""
        return self._left(left_out, self.named)

    def _left(self, left_out: Collection[int], named: tuple) -> Array:
        if self._prepared is None:
            return self.rows.Y
        key = (frozenset(left_out), bool(named))
        if key not in self._known:
            model = identified_without(self._prepared, left_out, named)
            self._known[key] = self._rows(self._prepared.residuals(model)).Y
        return self._known[key]

    def _rows(self, left: Sequence[Array]) -> Rows:
        runs, tracks = self._prepared.runs, self._prepared.tracks
        return measured_rows(runs, tracks, left, self._joints, self._thin)
