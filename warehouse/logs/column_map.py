"""COLUMNS.toml: which column is which signal, its unit, and the conversion to SI.

Only what the map states is converted.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass as table

from residual.drive import Drive
from residual.errors import InputError, check_name
from residual.robot.robot import Robot
from warehouse.toml_records import build_toml_record, read_toml

JOINT_SIGNALS = ("q", "tau", "qd", "qdd", "q_ref")

_DEGREE = math.pi / 180
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_ANGLE = {"rad": 1.0, "deg": _DEGREE}
# A torque in one of these units needs the robot's torque_per_unit.
LOGGED_UNITS = ("A", "counts", "%")
UNITS: Mapping[str, Mapping[str, float]] = {
    "q": _ANGLE,
    "q_ref": _ANGLE,
    "qd": {"rad/s": 1.0, "deg/s": _DEGREE},
    "qdd": {"rad/s^2": 1.0, "deg/s^2": _DEGREE},
    "tau": {"N m": 1.0, "Nm": 1.0, "N mm": 1e-3, **dict.fromkeys(LOGGED_UNITS, 1.0)},
}

# TOML has types, so "7" for 7 or true for 1 is a mistake.
_Numbers = tuple[Annotated[float, Field(strict=True, allow_inf_nan=False)], ...]
_TABLE = ConfigDict(extra="forbid")

MOST_FOUND = 4000  # characters: enough for all columns of an arm, not of a broken file
_NEEDED = ("q", "tau")
_JOINT_COLUMN = re.compile(r"(q|tau|qd|qdd|q_ref)(\d+)")
Array = np.ndarray


@table(frozen=True, slots=True, config=_TABLE)
class SignalMap:
    """One signal of all joints."""

    # Column names, joint 1 first.
    columns: Annotated[tuple[str, ...], Field(min_length=1)]
    unit: str = ""  # unit of the columns; empty for the default
    side: Literal["link", "motor"] = "link"
    sign: _Numbers = ()  # factor 1 or -1 of each joint, empty for all 1
    # Reading at the joint's zero in the unit of the columns, empty for all 0.
    zero: _Numbers = ()
    # Positive factor of each joint, after unit and sign; empty for all 1.
    scale: _Numbers = ()
    # Whether readings that wrap after a whole turn are unwrapped (positions).
    unwrap: Annotated[bool, Field(strict=True)] = False

    @model_validator(mode="after")
    def _check(self) -> "SignalMap":
        if not {*self.sign} <= {1, -1}:
            raise ValueError("sign must be a list of 1 and -1")
        if any(value <= 0 for value in self.scale):
            raise ValueError("scale must be a list of positive numbers; see sign")
        for key in ("sign", "zero", "scale"):
            values = getattr(self, key)
            if values and len(values) != len(self.columns):
                raise ValueError(f"{key} has {len(values)} entries for {len(self.columns)} columns")
        return self


@table(frozen=True, slots=True, config=_TABLE)
class CsvFormat:
    """How a text log is written."""

    separator: str | None = None  # one character, None to sniff it
    decimal: Literal[".", ","] = "."
    skip: Annotated[int, Field(ge=0, strict=True)] = 0  # lines before the line of names

    @model_validator(mode="after")
    def _check(self) -> "CsvFormat":
        if self.separator is not None and len(self.separator) != 1:
            raise ValueError("separator must be one character")
        if self.separator == self.decimal:
            raise ValueError(f"separator and decimal are both '{self.decimal}'")
        return self


@table(frozen=True, slots=True, config=_TABLE)
class BagFormat:
    """The part of a bag to read."""

    topic: str | None = None  # topic with joint states, None where there is only one
    # Names of the joints in the bag, joint 1 first; empty for the URDF's.
    joints: tuple[str, ...] = ()
    # "header" for the time in the messages, "record" for that of recording.
    time: Literal["header", "record"] = "header"

    @model_validator(mode="after")
    def _check(self) -> "BagFormat":
        if len(set(self.joints)) < len(self.joints):
            raise ValueError("joints has one name twice")
        return self


@table(frozen=True, slots=True, config=_TABLE)
class ColumnMap:
    """The checked content of a COLUMNS.toml."""

    time: str = "t"
    time_unit: str = "s"  # "s", "ms" or "us"
    time_scale: float = 1.0  # factor on time, after its unit
    nanoseconds: str | None = None  # column that is added to one of whole seconds
    # Joint signals in the map; others keep their default columns.
    signals: Mapping[str, SignalMap] = field(default_factory=dict)
    csv: CsvFormat = CsvFormat()
    bag: BagFormat = BagFormat()
    # How torque follows from goal and position; None where it is in columns.
    drive: Drive | None = None

    @property
    def time_unit_seconds(self) -> float:
        """Seconds in one unit of the column of time [s]."""
        return TIME_UNITS[self.time_unit] * self.time_scale


@table(frozen=True, slots=True, config=_TABLE)
class _Time:
    column: str = "t"
    unit: Literal["s", "ms", "us"] = "s"
    scale: Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)] = 1.0
    nanoseconds: str | None = None

    @model_validator(mode="after")
    def _check(self) -> "_Time":
        if self.nanoseconds is not None and (self.unit != "s" or self.scale != 1):
            raise ValueError("nanoseconds need a column in s, without a scale")
        return self


@table(frozen=True, slots=True, config=_TABLE)
class _File:
    """The tables of a COLUMNS.toml."""

    time: _Time = _Time()
    q: SignalMap | None = None
    tau: SignalMap | None = None
    qd: SignalMap | None = None
    qdd: SignalMap | None = None
    q_ref: SignalMap | None = None
    csv: CsvFormat = CsvFormat()
    bag: BagFormat = BagFormat()
    drive: Drive | None = None


class MissingColumnsError(InputError):
    """A log lacks the expected columns; a map can name them."""


def choose_column_map(robot: Robot, path: str | Path | None = None) -> ColumnMap | None:
    """Return the column map for the logs of a robot.

    Args:
        path: COLUMNS.toml; None for [columns] of the robot.toml.
    """
    if path:
        return read_column_map(path)
    return _column_map(robot.columns, "robot.toml, [columns]") if robot.columns else None


def read_column_map(path: str | Path) -> ColumnMap:
    """Read a COLUMNS.toml."""
    try:
        content = read_toml(path)
    except InputError as error:
        raise InputError(
            f"{error}\nA map is a TOML file; modelgap map LOG --robot ROBOT "
            "--out COLUMNS.toml drafts one."
        ) from error
    return _column_map(content, Path(path).name)


def _column_map(content: Mapping, name: str) -> ColumnMap:
    file = build_toml_record(_File, dict(content), name)
    maps = {key: getattr(file, key) for key in JOINT_SIGNALS}
    return ColumnMap(
        time=file.time.column,
        time_unit=file.time.unit,
        time_scale=file.time.scale,
        nanoseconds=file.time.nanoseconds,
        signals={k: _in_unit(k, s, name) for k, s in maps.items() if s},
        csv=file.csv,
        bag=file.bag,
        drive=file.drive,
    )


def _in_unit(key: str, signal: SignalMap, where: str) -> SignalMap:
    """Return a signal with its unit, by default the standard one."""
    if signal.zero and key not in ("q", "q_ref"):
        raise InputError(f"{where}: [{key}] has a zero; only a position can have one.")
    if signal.unwrap and key not in ("q", "q_ref"):
        raise InputError(f"{where}: [{key}] has unwrap; only a position can wrap.")
    unit = signal.unit or next(iter(UNITS[key]))
    check_name(unit, UNITS[key], f"unit of {key} in {where}")
    return replace(signal, unit=unit)


def abbreviate_column_names(columns: Iterable[str]) -> str:
    """Return names in one line: q1 q2 q3 tau1 tau2 as "q1..3 tau1..2"."""
    words: list[str] = []
    first, last = "", ("", -1)  # of the word that the next number may continue
    for name in columns:
        # A number with a leading zero would lose it: "J01" stays as it is.
        match = re.fullmatch(r"(.*\D)(0|[1-9]\d{0,8})", name, re.DOTALL | re.ASCII)
        stem, number = (match[1], int(match[2])) if match else (name, -1)
        # Continues the last word: q1..3 and q4 are q1..4.
        if match and last == (stem, number - 1):
            words[-1] = f"{first}..{number}"
        else:
            words.append(name)
            first = name
        last = stem, number
    return " ".join(words)


@dataclass(frozen=True, slots=True)
class ColumnSelection:
    """The columns of a log that are read."""

    time: str
    signals: Mapping[str, SignalMap]
    ignored: tuple[str, ...]
    nanoseconds: str | None = None
    enabled: str | None = None

    @property
    def used(self) -> tuple[str, ...]:
        """Columns that are read, time first."""
        joints = (c for signal in self.signals.values() for c in signal.columns)
        return (*filter(None, (self.time, self.nanoseconds, self.enabled)), *joints)


def select_columns(
    columns: tuple[str, ...], column_map: ColumnMap, robot: Robot, source: str
) -> ColumnSelection:
    """Find the columns of every signal.

    Raises:
        InputError: If a signal with default names has columns of more joints than the
            robot: then they are of another arm, or of a part of it that only the map
            can name. Or if the drive has values of other joints.
    """
    signals, dof, drive = {}, robot.dof, column_map.drive
    beyond = _find_columns_beyond(columns, dof)
    needed = _NEEDED if drive is None else ("q", "q_ref")
    if drive is not None and drive.dof not in (None, dof):
        raise InputError(
            f"drive has values for {drive.dof} joints, the robot has {dof} "
            f"({', '.join(robot.joints)}). Give one value per joint."
        )
    part = all(name in column_map.signals for name in needed)
    for name in JOINT_SIGNALS:
        if name == "tau" and drive is not None:
            continue  # it follows from goal and position
        signal = column_map.signals.get(name)
        if signal is not None and len(signal.columns) != dof:
            raise InputError(
                f"The map names {len(signal.columns)} columns of {name}, the robot has "
                f"{dof} joints ({', '.join(robot.joints)}). Name one column per joint "
                "in the map, or choose the joints of the log with --chain."
            )
        if signal is None:
            signal = build_default_signal(name, dof)
            if name in beyond and not part:
                raise InputError(
                    f"{source}: column '{beyond[name]}' is beyond the robot's joints 1 "
                    f"to {dof}. Is --robot the right one? For a part of an arm, "
                    "name its columns of q and tau in --map; else rename the column."
                )
            # An optional signal is read if complete, else listed as ignored; of
            # a part of an arm its first joints need not be those of the robot.
            whole = set(signal.columns) <= set(columns) and name not in beyond
            if name not in needed and not whole:
                continue
        signals[name] = signal
    clock = column_map.time, signals, (), column_map.nanoseconds
    chosen = ColumnSelection(*clock, enabled=drive and drive.enabled)
    _check_there(chosen.used, columns, source)
    ignored = tuple(c for c in columns if c not in chosen.used and c)
    return replace(chosen, ignored=ignored)


def _find_columns_beyond(columns: Sequence[str], dof: int) -> dict[str, str]:
    """Return the first column of no joint of the robot, by its signal."""
    out: dict[str, str] = {}
    for column in sorted(columns):
        match = _JOINT_COLUMN.fullmatch(column)
        # Python reads no number of thousands of digits.
        if match and (len(match[2]) > 9 or not 1 <= int(match[2]) <= dof):
            out.setdefault(match[1], column)
    return out


def check_column_units(
    selection: ColumnSelection, time_unit: str, file_units: Mapping[str, str], source: str
) -> None:
    """Compare the units of the map, or the default ones, with those of the file."""
    meant = {selection.time: ("time", time_unit)}
    for name, signal in selection.signals.items():
        unit = "N m" if signal.unit == "Nm" else signal.unit
        meant |= dict.fromkeys(signal.columns, (name, unit))
    for column, (name, unit) in meant.items():
        stated_unit = file_units.get(column, unit)
        if stated_unit != unit:
            key = "column" if name == "time" else "columns"
            raise InputError(
                f"{source}: column '{column}' is in {stated_unit} by the file, in "
                f"{unit} by the map.\nSay so in --map: "
                f"{name} = {{{key} = ..., unit = '{stated_unit}'}}."
            )


def build_default_signal(name: str, dof: int) -> SignalMap:
    """Return the default of a signal without a map: q1, q2, ... in SI units."""
    columns = tuple(f"{name}{i}" for i in range(1, dof + 1))
    return SignalMap(columns=columns, unit=next(iter(UNITS[name])))


def _check_there(used: tuple[str, ...], columns: tuple[str, ...], where: str) -> None:
    missing = [c for c in used if c not in columns]
    if missing:
        near = get_close_matches(missing[0], columns, n=1, cutoff=0.5)
        hint = f" (near: '{near[0]}')" if near else ""
        listing = abbreviate_column_names(columns)
        if len(listing) > MOST_FOUND:
            listing = f"{listing[:MOST_FOUND]}... ({len(columns)} columns in all)"
        raise MissingColumnsError(
            f"{where}: missing column {abbreviate_column_names(missing)}{hint}; found {listing}.\n"
            "Rename the columns, or map them with --map COLUMNS.toml."
        )
    for column in used:
        if columns.count(column) > 1 or used.count(column) > 1:
            raise InputError(
                f"{where}: column '{column}' appears twice, expected once. Rename one of them."
            )


def convert_to_link_side(name: str, raw: Array, signal: SignalMap, arm: Robot) -> Array:
    """Convert one signal of all joints.

    Positions, unwrapped on request, and their derivatives:
    scale * unit * sign * (reading - zero), then from motor to joint by the inverse of
    the transmission. Torques: from motor to joint by
    its transpose, since both sides carry the same power.

    Args:
        raw: Readings. Shape (n, dof).

    Returns:
        Values in SI units, link side. Shape (n, dof).
    """
    values = raw
    if signal.unwrap:
        values = np.unwrap(raw, axis=0, period=2 * math.pi / UNITS[name][signal.unit])
    if signal.zero:
        values = values - np.array(signal.zero)
    factor = UNITS[name][signal.unit]
    if factor != 1 or signal.sign:
        values = values * (factor * np.array(signal.sign or 1.0))
    if signal.scale:
        values = values * np.array(signal.scale)
    if name == "tau":
        return _torque(values, signal, arm)
    if signal.side == "motor":
        return np.linalg.solve(_transmission(name, arm), values.T).T
    return values


def _torque(values: Array, signal: SignalMap, robot: Robot) -> Array:
    logged = signal.unit in LOGGED_UNITS
    if logged:
        if robot.torque_per_unit is None:
            raise InputError(
                f"tau is in {signal.unit}: robot.toml of '{robot.name}' needs "
                "torque_per_unit under [joints], N m at the link per logged unit."
            )
        values = values * robot.torque_per_unit
    if signal.side == "link":
        return values
    # torque_per_unit already applies at the link; only couplings remain.
    if logged and robot.motor_from_joint is None:
        return values
    transmission = _transmission("tau", robot)
    if logged:
        values = values / np.diag(transmission)
    return values @ transmission


def _transmission(name: str, robot: Robot) -> Array:
    if robot.transmission is None:
        raise InputError(
            f"{name} is on the motor side: robot.toml of '{robot.name}' needs "
            "gear_ratio under [joints] (or [couplings] motor_from_joint)."
        )
    return robot.transmission


def list_signal_channels(name: str, signal: SignalMap) -> list[tuple[str, str, str, str]]:
    """Return channel, column, unit and conversion, joint by joint."""
    out = []
    for i, column in enumerate(signal.columns):
        done = ["from motor side"] if signal.side == "motor" else []
        if signal.sign and signal.sign[i] < 0:
            done.append("sign reversed")
        if signal.scale and signal.scale[i] != 1:
            done.append(f"times {signal.scale[i]:.6g}")
        if signal.zero and signal.zero[i]:
            done.append(f"zero at {signal.zero[i]:g}")
        out.append((f"{name}{i + 1}", column, signal.unit, ", ".join(done)))
    return out


def describe_conversion(name: str, signal: SignalMap) -> str | None:
    """Return the conversion in words, None for none."""
    units = [unit for unit, factor in UNITS[name].items() if factor == 1]
    parts = []
    if signal.unit not in units or signal.unit in LOGGED_UNITS:
        parts.append(f"{signal.unit} to {units[0]}")
    if signal.side == "motor":
        parts.append("motor to link side")
    if any(s < 0 for s in signal.sign):
        turned = [str(i) for i, s in enumerate(signal.sign, start=1) if s < 0]
        parts.append(f"sign reversed on joint {', '.join(turned)}")
    if any(value != 1 for value in signal.scale):
        parts.append(f"times {', '.join(f'{value:.6g}' for value in signal.scale)}")
    if any(signal.zero):
        parts.append("zero shifted")
    if signal.unwrap:
        parts.append("unwrapped")
    return f"{name}: {', '.join(parts)}" if parts else None
