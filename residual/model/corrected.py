"""A model with look-up tables on top of it: what a statistical correction makes."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from residual.effects.base import State
from residual.model.lookup import Lookup
from residual.model.model import Model
from residual.recording import Array, Recording
from residual.signals.track import Track, at_samples, prepare

NONE = "none"  # the kind of a correction that no table helps
NOTHING, NEAREST = "nothing", "nearest"  # what a table says beyond its range
DIFFERENCE = "difference"  # of two positions, where their sum is not meant


class Column(NamedTuple):
    """A variable that a table reads: of which signal, of which joints (from 0), how."""

    on: str
    of: tuple[int, ...]
    form: str


@dataclass(frozen=True, eq=False, slots=True)
class Tables:
    """The correction of one joint."""

    joint: int  # from 0
    # What its tables read, beside the load; velocities among them.
    columns: tuple[Column, ...]
    lookup: Lookup  # the tables
    kind: str  # what it got: NONE, or a kind of `calibration.choice`
    # What it says beyond the range it was drawn on: "nothing", or what the "nearest"
    # level has.
    beyond: str = NOTHING

    def torque(self, state: State, load: Array) -> Array:
        """Correction under the model's torque `load` [N m]. Shape (n,)."""
        X = np.column_stack([*read(state, self.columns), load])
        X = X[:, : len(self.lookup.names)]
        if self.beyond == NEAREST:
            return self.lookup.predict(X)[:, 0]
        inside = ~self.lookup.outside(X).any(axis=1)
        return inside * self.lookup.predict(X)[:, 0]


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class CorrectedModel:
    """A model with tables on top of it."""

    model: Model  # the model
    tables: tuple[Tables, ...]  # one entry per unexplained joint that could be checked

    def __repr__(self) -> str:
        joints = ", ".join(f"J{t.joint + 1}" for t in self.tables if t.kind != NONE)
        return f"Corrected({self.model!r}, tables on {joints or 'no joint'})"

    @property
    def helpless(self) -> tuple[int, ...]:
        """Joints from 0 that no table of the state helps."""
        return tuple(t.joint for t in self.tables if t.kind == NONE)

    def predict(self, recording: Recording) -> Array:
        """Torque on a recorded motion, as ``Model.predict`` [N m]. Shape (n, dof)."""
        base = self.model
        (track,), _ = prepare([recording], base.filters, base.speed_floor, True)
        return at_samples(self.torque_on(track), track, recording)

    def along(self, t: Array, motion: Sequence[Array]) -> Array:
        """Torque along a motion that is known, as ``Model.along`` [N m]. (n, dof)."""
        rate = (len(t) - 1) / np.ptp(t)
        return self.torque_of_state(self.model.state(rate, t, motion))

    def observe(self, track: Track) -> State:
        """What the model's effects see of one log."""
        return self.model.observe(track)

    def torque_on(self, track: Track) -> Array:
        """Torque at the samples of a log's signals [N m]. Shape (n, dof)."""
        state = self.observe(track)
        return self._and_tables(self.model.torque_seen(state), state)

    def torque_of_state(self, state: State) -> Array:
        """Torque of the model and the tables [N m]. Shape (n, dof)."""
        return self._and_tables(self.model.torque_of_state(state), state)

    def _and_tables(self, out: Array, state: State) -> Array:
        for table in self.tables:
            if table.kind != NONE:
                out[:, table.joint] += table.torque(state, out[:, table.joint])
        return out

    def to_record(self) -> dict:
        """Model and tables as plain values."""
        return {
            **self.model.to_record(),
            "tables": [
                {
                    "joint": t.joint + 1,
                    "columns": [
                        [on, [j + 1 for j in of], f] for on, of, f in t.columns
                    ],
                    "kind": t.kind,
                    "lookup": t.lookup.to_record(),
                    **({"beyond": t.beyond} if t.beyond != NOTHING else {}),
                }
                for t in self.tables
            ],
        }

    def save(self, path: str | Path) -> None:
        """Write model and tables into a JSON file, which ``load_model`` reads."""
        Path(path).write_text(json.dumps(self.to_record(), allow_nan=False) + "\n")

    @classmethod
    def from_record(cls, record: Mapping) -> "CorrectedModel":
        """The way back: it predicts the very bits."""
        tables = [
            Tables(
                t["joint"] - 1,
                tuple(
                    Column(on, tuple(j - 1 for j in of), f)
                    for on, of, f in t["columns"]
                ),
                Lookup.from_record(t["lookup"]),
                t["kind"],
                t.get("beyond", NOTHING),
            )
            for t in record["tables"]
        ]
        return cls(Model.from_record(record), tuple(tables))


def read(state: State, columns: Sequence[Column]) -> list[Array]:
    """Values of the columns of a table along a log. Shapes (n,)."""
    out = []
    for on, of, form in columns:
        values = getattr(state, on)
        sign = -1 if form == DIFFERENCE else 1
        first, *others = of
        out.append(values[:, first] + sign * sum(values[:, k] for k in others))
    return out
