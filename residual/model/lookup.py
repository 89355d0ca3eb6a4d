"""A fitted correction as small tables, as files, and a model with tables on top of it.

The paper's "look up table of coefficients" (section 2.6.2): B f_pls of eq. 31.
"""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np

from residual.effects.base import State
from residual.model import evaluate
from residual.model.model import Model
from residual.quantity import check_rows, convert_to_plain_values
from residual.recording import Array, Recording
from residual.signals.track import Track, build_tracks, interpolate_torque

FORM = 1  # of the exported files; raised when they change


@dataclass(frozen=True, eq=False, slots=True)
class LevelAxis:
    """Levels of one variable."""

    variable: int  # column of X, from 0
    edges: Array  # inner edges, increasing; a value at one belongs above, (k - 1,)


@dataclass(frozen=True, eq=False, slots=True)
class LookupTable:
    """Corrections by the levels of one axis or two."""

    axes: tuple[int, ...]  # numbers of its axes
    values: Array  # shape (k, j) or (k1, k2, j), in units of the responses


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Lookup:
    """y = offset + x slope + the sum of all tables at the levels of x."""

    names: tuple[str, ...]  # variables, in the order of X's columns
    joints: tuple[str, ...]  # names of the responses
    # Levels, and corrections on them.
    axes: tuple[LevelAxis, ...]
    tables: tuple[LookupTable, ...]
    offset: Array  # , (j,)
    slope: Array  # shape (d, j); zero where nothing is linear
    # Calibrated range, (d,).
    low: Array
    high: Array

    def __repr__(self) -> str:
        return (
            f"Lookup({', '.join(self.names)} -> {', '.join(self.joints)}: "
            f"{len(self.tables)} tables)"
        )

    def predict(self, X: Array) -> Array:
        """Return the correction of rows, in units of the responses. Shape (m, j)."""
        X = check_rows(X, self.names, "the tables are of")
        return evaluate.predict(self.arrays, X)

    def outside(self, X: Array) -> Array:
        """Values outside the calibrated range, which take the nearest level. (m, d)."""
        X = check_rows(X, self.names, "the tables are of")
        return evaluate.flag_outside_range(self.arrays, X)

    @property
    def arrays(self) -> dict[str, Array]:
        """The tables as the arrays of `model.npz`."""
        named = ("names", "joints", "offset", "slope", "low", "high")
        arrays = {name: np.array(getattr(self, name)) for name in named}
        places = [(*t.axes, -1)[:2] for t in self.tables]
        arrays["axis_variable"] = np.array([a.variable for a in self.axes], np.int64)
        arrays["table_axes"] = np.array(places, np.int64).reshape(-1, 2)
        arrays |= {f"edges_{i}": a.edges for i, a in enumerate(self.axes)}
        return arrays | {f"values_{i}": t.values for i, t in enumerate(self.tables)}

    def to_record(self) -> dict:
        """The tables as plain values."""
        return convert_to_plain_values(asdict(self))

    @classmethod
    def from_record(cls, record: Mapping) -> "Lookup":
        """The way back."""
        axes = (LevelAxis(a["variable"], np.array(a["edges"])) for a in record["axes"])
        parts = record["tables"]
        tables = (LookupTable(tuple(t["axes"]), np.array(t["values"])) for t in parts)
        names, joints = tuple(record["names"]), tuple(record["joints"])
        arrays = (np.array(record[name]) for name in ("offset", "slope", "low", "high"))
        return cls(names, joints, tuple(axes), tuple(tables), *arrays)

    @classmethod
    def load(cls, path: str | Path) -> "Lookup":
        """Read the `model.npz` of an export."""
        with np.load(path) as file:
            axes = tuple(
                LevelAxis(int(variable), file[f"edges_{i}"])
                for i, variable in enumerate(file["axis_variable"])
            )
            tables = tuple(
                LookupTable(tuple(int(a) for a in pair if a >= 0), file[f"values_{i}"])
                for i, pair in enumerate(file["table_axes"])
            )
            names, joints = (tuple(file[k].tolist()) for k in ("names", "joints"))
            arrays = (file[k] for k in ("offset", "slope", "low", "high"))
            return cls(names, joints, axes, tables, *arrays)


def build_lookup_files(lookup: Lookup) -> dict[str, bytes]:
    """Return the files of an export by name; the same bytes for the same tables.

    `model.npz` holds everything, `tables.csv` the same cells to read, `model.json` what
    the tables are, `evaluate.py` evaluates the NPZ with numpy alone.
    """
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **lookup.arrays)
    return {
        "model.npz": buffer.getvalue(),
        "tables.csv": _csv(lookup),
        "model.json": _json(lookup),
        "evaluate.py": Path(evaluate.__file__).read_bytes(),
    }


def _csv(lookup: Lookup) -> bytes:
    """One line per cell: its intervals [from, to) and its value for each joint."""
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    sides = [f"{side}_{n}" for n in (1, 2) for side in ("variable", "from", "to")]
    out.writerow(["table", *sides, *lookup.joints])
    out.writerow(["offset", *[""] * 6, *map(repr, lookup.offset.tolist())])
    for name, slope in zip(lookup.names, lookup.slope.tolist(), strict=True):
        if any(slope):
            out.writerow(["slope", name, *[""] * 5, *map(repr, slope)])
    for number, table in enumerate(lookup.tables):
        bounds = []
        for axis in (lookup.axes[i] for i in table.axes):
            edges = pairwise(["-inf", *map(repr, axis.edges.tolist()), "inf"])
            bounds.append([(lookup.names[axis.variable], *pair) for pair in edges])
        flat = table.values.reshape(-1, len(lookup.joints)).tolist()
        cells = np.ndindex(table.values.shape[:-1])
        for place, values in zip(cells, flat, strict=True):
            interval = [w for b, k in zip(bounds, place, strict=True) for w in b[k]]
            interval += [""] * (6 - len(interval))
            out.writerow([number, *interval, *map(repr, values)])
    return text.getvalue().encode()


def _json(lookup: Lookup) -> bytes:
    content = {
        "form": FORM,
        "meaning": "correction [N m] = offset + x slope + sum of tables; x in rad, "
        "rad/s, rad/s^2, of tau in N m (torque of the model); a value at an edge "
        "belongs above it",
        "variables": [
            {"name": n, "low": float(a), "high": float(b)}
            for n, a, b in zip(lookup.names, lookup.low, lookup.high, strict=True)
        ],
        "joints": list(lookup.joints),
        "offset": lookup.offset.tolist(),
        "slope": lookup.slope.tolist(),
        "axes": [
            {"variable": lookup.names[a.variable], "edges": a.edges.tolist()} for a in lookup.axes
        ],
        "tables": [
            {
                "table": number,
                "axes": list(t.axes),
                "variables": [lookup.names[lookup.axes[a].variable] for a in t.axes],
                "levels": list(t.values.shape[:-1]),
                "largest": np.abs(t.values).max(axis=(*range(t.values.ndim - 1),)).tolist(),
            }
            for number, t in enumerate(lookup.tables)
        ],
    }
    return (json.dumps(content, indent=1) + "\n").encode()


NONE = "none"  # kind of a joint that no table improves
NOTHING, NEAREST = "nothing", "nearest"  # behaviour of a table beyond its range
DIFFERENCE = "difference"  # of two positions, as opposed to their sum


class TableVariable(NamedTuple):
    """A variable of a table: its signal, its joints (from 0), and its form."""

    on: str
    of: tuple[int, ...]
    form: str


@dataclass(frozen=True, eq=False, slots=True)
class JointCorrection:
    """The correction of one joint."""

    joint: int  # from 0
    # Variables of its tables besides the load; velocities among them.
    columns: tuple[TableVariable, ...]
    lookup: Lookup  # the tables
    kind: str  # its kind: NONE, or that of a `CorrectionOption`
    # Behaviour beyond the fitted range: "nothing", or the value of the "nearest"
    # level.
    beyond: str = NOTHING

    def torque(self, state: State, load: Array) -> Array:
        """Correction under the model's torque `load` [N m]. Shape (n,)."""
        X = np.column_stack([*compute_table_variables(state, self.columns), load])
        X = X[:, : len(self.lookup.names)]
        if self.beyond == NEAREST:
            return self.lookup.predict(X)[:, 0]
        inside = ~self.lookup.outside(X).any(axis=1)
        return inside * self.lookup.predict(X)[:, 0]


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class CorrectedModel:
    """A model with tables on top of it."""

    model: Model  # the model
    tables: tuple[JointCorrection, ...]  # one entry per unexplained joint that could be checked

    def __repr__(self) -> str:
        joints = ", ".join(f"J{t.joint + 1}" for t in self.tables if t.kind != NONE)
        return f"Corrected({self.model!r}, tables on {joints or 'no joint'})"

    @property
    def uncorrected_joints(self) -> tuple[int, ...]:
        """Joints from 0 that no table of the state improves."""
        return tuple(t.joint for t in self.tables if t.kind == NONE)

    def predict(self, recording: Recording) -> Array:
        """Torque on a recorded motion, as ``Model.predict`` [N m]. Shape (n, dof)."""
        base = self.model
        (track,), _ = build_tracks([recording], base.filters, base.speed_floor, True)
        return interpolate_torque(self.torque_on(track), track, recording)

    def along(self, t: Array, motion: Sequence[Array]) -> Array:
        """Torque along a known motion, as ``Model.along`` [N m]. (n, dof)."""
        rate = (len(t) - 1) / np.ptp(t)
        return self.torque_of_state(self.model.state(rate, t, motion))

    def torque_on(self, track: Track) -> Array:
        """Torque at the samples of a log's signals [N m]. Shape (n, dof)."""
        state = self.model.observe(track)
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
                    "columns": [[on, [j + 1 for j in of], f] for on, of, f in t.columns],
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
            JointCorrection(
                t["joint"] - 1,
                tuple(TableVariable(on, tuple(j - 1 for j in of), f) for on, of, f in t["columns"]),
                Lookup.from_record(t["lookup"]),
                t["kind"],
                t.get("beyond", NOTHING),
            )
            for t in record["tables"]
        ]
        return cls(Model.from_record(record), tuple(tables))


AnyModel = Model | CorrectedModel


def remove_tables(source: AnyModel) -> Model:
    """Return the model without its tables."""
    return source.model if isinstance(source, CorrectedModel) else source


def replace_model(source: AnyModel, model: Model) -> AnyModel:
    """Return another model with the same tables, if any."""
    return replace(source, model=model) if isinstance(source, CorrectedModel) else model


def compute_table_variables(state: State, columns: Sequence[TableVariable]) -> list[Array]:
    """Values of the columns of a table along a log. Shapes (n,)."""
    out = []
    for on, of, form in columns:
        values = getattr(state, on)
        sign = -1 if form == DIFFERENCE else 1
        first, *others = of
        out.append(values[:, first] + sign * sum(values[:, k] for k in others))
    return out
