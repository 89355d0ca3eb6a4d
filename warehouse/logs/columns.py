"""COLUMNS.toml: which column is what, in which unit. Nothing is converted by guess."""

import math
from collections.abc import Mapping
from dataclasses import field, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import ConfigDict, Field, model_validator
from pydantic.dataclasses import dataclass

from residual.errors import InputError
from residual.names import check_name
from warehouse.toml import checked, read_toml

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
    "tau": {"N m": 1.0, "Nm": 1.0, **dict.fromkeys(LOGGED_UNITS, 1.0)},
}

# TOML has types, so "7" for 7 or true for 1 is a slip and not a wish.
_Numbers = tuple[Annotated[float, Field(strict=True, allow_inf_nan=False)], ...]
_TABLE = ConfigDict(extra="forbid")


@dataclass(frozen=True, slots=True, config=_TABLE)
class SignalMap:
    """One signal of all joints.

    Attributes:
        columns: Column names, joint 1 first.
        unit: Unit of the columns; empty for the usual one.
        side: "link" or "motor".
        sign: Factor 1 or -1 of each joint, empty for all 1.
        scale: Positive factor of each joint, after unit and sign; empty for all 1.
        zero: Reading at the joint's zero in the unit of the columns, empty for all 0.
    """

    columns: Annotated[tuple[str, ...], Field(min_length=1)]
    unit: str = ""
    side: Literal["link", "motor"] = "link"
    sign: _Numbers = ()
    zero: _Numbers = ()
    scale: _Numbers = ()

    @model_validator(mode="after")
    def _check(self) -> "SignalMap":
        if not {*self.sign} <= {1, -1}:
            raise ValueError("sign must be a list of 1 and -1")
        if any(value <= 0 for value in self.scale):
            raise ValueError("scale must be a list of positive numbers; see sign")
        for key in ("sign", "zero", "scale"):
            values = getattr(self, key)
            if values and len(values) != len(self.columns):
                raise ValueError(
                    f"{key} has {len(values)} entries for {len(self.columns)} columns"
                )
        return self


@dataclass(frozen=True, slots=True, config=_TABLE)
class CsvFormat:
    """How a text log is written.

    Attributes:
        separator: One character, None to sniff it.
        decimal: "." or ",".
        skip: Lines before the line of names.
    """

    separator: str | None = None
    decimal: Literal[".", ","] = "."
    skip: Annotated[int, Field(ge=0, strict=True)] = 0

    @model_validator(mode="after")
    def _check(self) -> "CsvFormat":
        if self.separator is not None and len(self.separator) != 1:
            raise ValueError("separator must be one character")
        if self.separator == self.decimal:
            raise ValueError(f"separator and decimal are both '{self.decimal}'")
        return self


@dataclass(frozen=True, slots=True, config=_TABLE)
class BagFormat:
    """What of a bag is read.

    Attributes:
        topic: Topic with joint states, None where there is only one.
        joints: Names of the joints in the bag, joint 1 first; empty for the URDF's.
        time: "header" for the time in the messages, "record" for that of recording.
    """

    topic: str | None = None
    joints: tuple[str, ...] = ()
    time: Literal["header", "record"] = "header"

    @model_validator(mode="after")
    def _check(self) -> "BagFormat":
        if len(set(self.joints)) < len(self.joints):
            raise ValueError("joints names one of them twice")
        return self


@dataclass(frozen=True, slots=True, config=_TABLE)
class ColumnMap:
    """The checked content of a COLUMNS.toml.

    Attributes:
        time: Column of time.
        time_unit: "s", "ms" or "us".
        time_scale: Factor on time, after its unit.
        signals: Joint signals that the map names; others keep their default columns.
        csv: How text logs are written.
        bag: What of a bag is read.
    """

    time: str = "t"
    time_unit: str = "s"
    time_scale: float = 1.0
    signals: Mapping[str, SignalMap] = field(default_factory=dict)
    csv: CsvFormat = CsvFormat()
    bag: BagFormat = BagFormat()

    @property
    def time_unit_seconds(self) -> float:
        """Seconds in one unit of the column of time [s]."""
        return TIME_UNITS[self.time_unit] * self.time_scale


@dataclass(frozen=True, slots=True, config=_TABLE)
class _Time:
    column: str = "t"
    unit: Literal["s", "ms", "us"] = "s"
    scale: Annotated[float, Field(strict=True, gt=0, allow_inf_nan=False)] = 1.0


@dataclass(frozen=True, slots=True, config=_TABLE)
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


def load_columns(path: str | Path) -> ColumnMap:
    """Read a COLUMNS.toml.

    Raises:
        InputError: If the file is not usable.
        UnknownNameError: On a unit that is not known.
    """
    name = Path(path).name
    file = checked(_File, read_toml(path), name)
    given = {key: getattr(file, key) for key in JOINT_SIGNALS}
    return ColumnMap(
        time=file.time.column,
        time_unit=file.time.unit,
        time_scale=file.time.scale,
        signals={k: _in_unit(k, s, name) for k, s in given.items() if s},
        csv=file.csv,
        bag=file.bag,
    )


def _in_unit(key: str, signal: SignalMap, where: str) -> SignalMap:
    """Return a signal with its unit, the usual one where the file gives none."""
    if signal.zero and key not in ("q", "q_ref"):
        raise InputError(f"{where}: [{key}] has a zero; only a position has its own.")
    unit = signal.unit or next(iter(UNITS[key]))
    check_name(unit, UNITS[key], f"unit of {key} in {where}")
    return replace(signal, unit=unit)
