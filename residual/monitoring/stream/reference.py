"""What is usual of an arm that is in order: what a stream is held against."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.model.model import Model
from residual.monitoring.stream.rows import Rows, Window
from residual.monitoring.stream.seen import Quantity, one_kilogram, quantities
from residual.monitoring.usual import Tail
from residual.names import shown
from residual.recording import Array

FORM = 1
_ROOM = 0.02  # share of a range by which a state may be outside of it
_ARRAYS = (
    "filters",
    "sigma",
    "felt",
    "prior",
    "usual",
    "sizes",
    "limits",
    "lowest",
    "highest",
)
_PLAIN = ("rate", "per_hour", "hours")


@dataclass(frozen=True, eq=False, slots=True)
class Reference:
    """What healthy runs of an arm have taught.

    Attributes:
        model: Expects the torque, fitted to the healthy runs, with tables of what else
            they show (`learn`).
        rate: Rate of the samples [Hz].
        filters: What makes the residual white: a_i of each joint. Shape (p, dof).
        sigma: Standard deviation of the white rest [N m]. Shape (dof,).
        felt: Joints whose torque tells the mass of a load wherever its centre is, 1 or
            0. Shape (dof,).
        prior: Information of the belief that nothing has changed. Shape (h,).
        usual: Size of change that healthy runs imitate, by quantity. Shape (h,).
        sizes: Smallest change of each quantity that is looked for. Shape (h,).
        limits: Limit of the sum of each quantity [nats]. Shape (h,).
        tails: How the sums of healthy runs decay, by quantity.
        per_hour: False alarms wanted at most [1/h].
        hours: Length of the healthy runs [h].
        lowest, highest: Range of q, qd, qdd in the healthy runs. Shape (3, dof) each.
    """

    model: Model
    rate: float
    filters: Array
    sigma: Array
    felt: Array
    prior: Array
    usual: Array
    sizes: Array
    limits: Array
    tails: tuple[Tail, ...]
    per_hour: float
    hours: float
    lowest: Array
    highest: Array

    @property
    def dof(self) -> int:
        """Number of joints."""
        return self.model.robot.dof

    @property
    def window(self) -> Window:
        """How samples become rows."""
        return Window(self.rate)

    @property
    def watched(self) -> tuple[Quantity, ...]:
        """What is watched, in the order of `sizes`."""
        return quantities(self.dof)

    @property
    def load(self) -> Array:
        """Inertial parameters of one kilogram on the flange. Shape (10,)."""
        return one_kilogram(self.model.robot)

    def outside(self, rows: Rows) -> Array:
        """Where a joint is faster, or at another place, than in any healthy run.

        What the model is worth there nobody knows. Shape (m, dof), bool.
        """
        motion = np.stack([rows.q, rows.qd, rows.qdd], axis=1)
        room = _ROOM * (self.highest - self.lowest)
        apart = (motion < self.lowest - room) | (motion > self.highest + room)
        return apart.any(axis=1)

    def to_record(self) -> dict:
        """Return it whole, as JSON can hold it."""
        return {
            "form": FORM,
            "model": self.model.to_record(),
            **{name: getattr(self, name) for name in _PLAIN},
            **{name: getattr(self, name).tolist() for name in _ARRAYS},
            "tails": [[t.threshold, t.beta, t.share] for t in self.tails],
        }

    @classmethod
    def from_record(cls, record: Mapping) -> "Reference":
        """Return the reference of a record.

        Raises:
            InputError: If it is of another form, or damaged.
        """
        if record.get("form") != FORM:
            raise InputError(
                f"A reference of form {shown(record.get('form'))}, expected {FORM}. "
                "Learn it again from healthy runs."
            )
        try:
            return cls(
                model=Model.from_record(record["model"]),
                tails=tuple(Tail(*values) for values in record["tails"]),
                **{name: record[name] for name in _PLAIN},
                **{name: np.array(record[name]) for name in _ARRAYS},
            )
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(f"The reference is damaged: {error}.") from error
