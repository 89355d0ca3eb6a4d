"""Which columns of a log are which signal of the robot."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches

from residual.errors import InputError
from warehouse.logs.columns import JOINT_SIGNALS, UNITS, ColumnMap, SignalMap
from warehouse.logs.convert import shorten

_NEEDED = ("q", "tau")
_JOINT_COLUMN = re.compile(r"(q|tau|qd|qdd|q_ref)(\d+)")


@dataclass(frozen=True, slots=True)
class Selection:
    """The columns of a log that are read.

    Attributes:
        time: Column of time.
        signals: Signals found, by name.
        ignored: Columns that are not read.
    """

    time: str
    signals: Mapping[str, SignalMap]
    ignored: tuple[str, ...]

    @property
    def used(self) -> tuple[str, ...]:
        """Columns that are read, time first."""
        joints = (c for signal in self.signals.values() for c in signal.columns)
        return (self.time, *joints)


def select(
    columns: tuple[str, ...], column_map: ColumnMap, dof: int, where: str
) -> Selection:
    """Find the columns of every signal.

    Raises:
        InputError: If a needed column is missing or doubled, or there is a joint column
            beyond the robot's joints.
    """
    signals = {}
    for name in JOINT_SIGNALS:
        signal = column_map.signals.get(name)
        if signal is not None and len(signal.columns) != dof:
            raise InputError(
                f"The map names {len(signal.columns)} columns of {name}, the robot has "
                f"{dof} joints."
            )
        if signal is None:
            signal = default_signal(name, dof)
            # An optional signal is read where it is whole, else ignored and named.
            if name not in _NEEDED and not set(signal.columns) <= set(columns):
                continue
        signals[name] = signal
    chosen = Selection(column_map.time, signals, ())
    _check_there(chosen.used, columns, where)
    _check_beyond(set(columns) - set(chosen.used), dof, where)
    ignored = tuple(c for c in columns if c not in chosen.used and c)
    return Selection(column_map.time, signals, ignored)


def check_units(
    chosen: Selection, time_unit: str, stated: Mapping[str, str], where: str
) -> None:
    """Compare the units of the map, or the usual ones, with those of the file.

    Raises:
        InputError: If they differ.
    """
    meant = {chosen.time: ("time", time_unit)}
    for name, signal in chosen.signals.items():
        unit = "N m" if signal.unit == "Nm" else signal.unit
        meant |= dict.fromkeys(signal.columns, (name, unit))
    for column, (name, unit) in meant.items():
        said = stated.get(column, unit)
        if said != unit:
            key = "column" if name == "time" else "columns"
            raise InputError(
                f"{where}: column '{column}' is in {said} by the file, in {unit} by "
                f"the map.\nSay so in --map: {name} = {{{key} = ..., unit = '{said}'}}."
            )


def default_signal(name: str, dof: int) -> SignalMap:
    """Return what is meant by a signal that no map names: q1, q2, ... in SI units.

    Args:
        name: "q", "qd", "qdd", "q_ref" or "tau".
    """
    columns = tuple(f"{name}{i}" for i in range(1, dof + 1))
    return SignalMap(columns=columns, unit=next(iter(UNITS[name])))


def _check_there(used: tuple[str, ...], columns: tuple[str, ...], where: str) -> None:
    missing = [c for c in used if c not in columns]
    if missing:
        near = get_close_matches(missing[0], columns, n=1, cutoff=0.5)
        hint = f" (near: '{near[0]}')" if near else ""
        found = shorten(columns)
        found = found if len(found) < 80 else f"{found[:77]}..."
        raise InputError(
            f"{where}: missing column {shorten(missing)}{hint}; found {found}.\n"
            "Rename the columns, or say which is which with --map COLUMNS.toml."
        )
    for column in used:
        if columns.count(column) > 1 or used.count(column) > 1:
            raise InputError(
                f"{where}: column '{column}' stands twice, expected once. "
                "Rename one of them."
            )


def _check_beyond(rest: set[str], dof: int, where: str) -> None:
    for column in sorted(rest):
        match = _JOINT_COLUMN.fullmatch(column)
        # Python reads no number of thousands of digits.
        if match and (len(match[2]) > 9 or not 1 <= int(match[2]) <= dof):
            raise InputError(
                f"{where}: column '{column}' is beyond the robot's joints 1 to {dof}. "
                "Is --robot the right one? Else remove or rename the column."
            )
