"""Lines of text to samples of a robot: a table with a line of names, or JSON."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residual.errors import InputError
from residual.monitoring.rows import Samples
from residual.robot.robot import Robot
from warehouse.logs.columns import (
    TIME_UNITS,
    ColumnMap,
    Selection,
    select,
    to_link_side,
)
from warehouse.logs.tables import is_number, sniff, split

_LISTS = ("q", "tau")


@dataclass(frozen=True, eq=False, slots=True)
class Reader:
    """What the lines of one table mean.

    Attributes:
        robot: The arm.
        columns: The user's map.
        names: Names of the table's columns.
        chosen: Which of them are read.
        separator: Between two values; empty for JSON.
    """

    robot: Robot
    columns: ColumnMap
    names: tuple[str, ...]
    chosen: Selection
    separator: str

    def samples(self, lines: Sequence[str]) -> Samples:
        """Return lines as samples, NaN where a value is missing or no number."""
        rows = self._from_json(lines) if not self.separator else self._table(lines)
        at = {name: i for i, name in enumerate(self.names)}
        t = rows[:, at[self.chosen.time]]
        t = t * (TIME_UNITS[self.columns.time_unit] * self.columns.time_scale)
        made = {}
        for name in _LISTS:
            signal = self.chosen.signals[name]
            raw = rows[:, [at[column] for column in signal.columns]]
            with np.errstate(over="ignore", invalid="ignore"):
                made[name] = to_link_side(name, raw, signal, self.robot)
        return Samples(t, made["q"], made["tau"])

    def _table(self, lines: Sequence[str]) -> np.ndarray:
        comma = self.columns.csv.decimal == ","
        out = np.full((len(lines), len(self.names)), np.nan)
        for i, line in enumerate(lines):
            values = split(line, self.separator)
            if len(values) == len(self.names):
                out[i] = [_number(v.replace(",", ".") if comma else v) for v in values]
        return out

    def _from_json(self, lines: Sequence[str]) -> np.ndarray:
        out = np.full((len(lines), len(self.names)), np.nan)
        for i, line in enumerate(lines):
            values = _flat(line) or {}
            out[i] = [_number(values.get(name)) for name in self.names]
        return out


def reader_of(line: str, robot: Robot, columns: ColumnMap, where: str) -> Reader:
    """Return what the lines after a first one mean.

    Raises:
        InputError: If a needed column is missing, or the line has no names.
    """
    if line.lstrip().startswith("{"):
        values = _flat(line)
        if values is None:
            raise InputError(
                f'{where}: no JSON object, expected lines such as {{"t": 0.004, '
                '"q": [..], "tau": [..]}.'
            )
        names = tuple(values)
        return Reader(robot, columns, names, _chosen(names, robot, columns, where), "")
    separator = columns.csv.separator or sniff(line)
    names = tuple(name.strip() for name in split(line, separator))
    if all(is_number(name) for name in names):
        raise InputError(
            f"{where} starts with numbers, expected a line of column names such as "
            "t,q1,tau1."
        )
    chosen = _chosen(names, robot, columns, where)
    return Reader(robot, columns, names, chosen, separator)


def _chosen(
    names: tuple[str, ...], robot: Robot, columns: ColumnMap, where: str
) -> Selection:
    return select(names, columns, robot.dof, where)


def _flat(line: str) -> Mapping | None:
    """A JSON object with its lists as q1, q2, ...; None where it is none."""
    try:
        given = json.loads(line)
    except ValueError:
        return None
    if not isinstance(given, dict):
        return None
    out = {}
    for name, value in given.items():
        if isinstance(value, list):
            out |= {f"{name}{k}": v for k, v in enumerate(value, start=1)}
        else:
            out[name] = value
    return out


def _number(value: object) -> float:
    try:
        return float(value)  # pyright: ignore[reportArgumentType]
    except (TypeError, ValueError):
        return float("nan")
