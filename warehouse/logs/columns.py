"""COLUMNS.toml: which column is what, in which unit. Nothing is converted by guess."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from residual.errors import InputError
from residual.names import check_keys, check_name

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


@dataclass(frozen=True, slots=True)
class SignalMap:
    """One signal of all joints.

    Attributes:
        columns: Column names, joint 1 first.
        unit: Unit of the columns.
        side: "link" or "motor".
        sign: Factor 1 or -1 of each joint, empty for all 1.
        zero: Reading at the joint's zero in the unit of the columns, empty for all 0.
    """

    columns: tuple[str, ...]
    unit: str
    side: str = "link"
    sign: tuple[float, ...] = ()
    zero: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class CsvFormat:
    """How a text log is written.

    Attributes:
        separator: One character, None to sniff it.
        decimal: "." or ",".
        skip: Lines before the line of names.
    """

    separator: str | None = None
    decimal: str = "."
    skip: int = 0


@dataclass(frozen=True, slots=True)
class BagFormat:
    """What of a bag is read.

    Attributes:
        topic: Topic with joint states, None where there is only one.
        joints: Names of the joints in the bag, joint 1 first; empty for the URDF's.
        time: "header" for the time in the messages, "record" for that of recording.
    """

    topic: str | None = None
    joints: tuple[str, ...] = ()
    time: str = "header"


@dataclass(frozen=True, slots=True)
class ColumnMap:
    """The checked content of a COLUMNS.toml.

    Attributes:
        time: Column of time.
        time_unit: "s", "ms" or "us".
        signals: Joint signals that the map names; others keep their default columns.
        csv: How text logs are written.
        bag: What of a bag is read.
    """

    time: str = "t"
    time_unit: str = "s"
    signals: Mapping[str, SignalMap] = field(default_factory=dict)
    csv: CsvFormat = CsvFormat()
    bag: BagFormat = BagFormat()


def load_columns(path: str | Path) -> ColumnMap:
    """Read a COLUMNS.toml.

    Args:
        path: The file.

    Returns:
        What it says.

    Raises:
        InputError: If the file is not usable.
        UnknownNameError: On a key, unit or side that is not known.
    """
    path = Path(path)
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"Cannot read the map '{path}': {error.strerror}.") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path.name} is not valid TOML: {error}.") from error
    check_keys(content, ("time", "csv", "bag", *JOINT_SIGNALS), path.name)
    for key, table in content.items():
        if not isinstance(table, dict):
            raise InputError(f"{path.name}: '{key}' must be a table: {key} = {{...}}.")
    time = content.get("time", {})
    check_keys(time, ("column", "unit"), f"time of {path.name}")
    return ColumnMap(
        time=_text(time, "column", "t", f"{path.name}: time"),
        time_unit=_one_of(time, "unit", TIME_UNITS, f"time unit in {path.name}"),
        signals={
            name: _signal(name, content[name], path.name)
            for name in JOINT_SIGNALS
            if name in content
        },
        csv=_csv(content.get("csv", {}), path.name),
        bag=_bag(content.get("bag", {}), path.name),
    )


def _signal(name: str, table: dict, where: str) -> SignalMap:
    place = f"{name} of {where}"
    # Only a position has a zero of its own.
    zero = ("zero",) if name in ("q", "q_ref") else ()
    check_keys(table, ("columns", "unit", "side", "sign", *zero), place)
    columns = table.get("columns")
    if not _is_list(columns, str) or not columns:
        raise InputError(f"{place}: needs columns = ['...', ...], joint 1 first.")
    sign = table.get("sign", [])
    if not _is_list(sign, int | float) or any(s not in (1, -1) for s in sign):
        raise InputError(f"{place}: sign must be a list of 1 and -1.")
    zeros = table.get("zero", [])
    if not _is_list(zeros, int | float) or not all(map(math.isfinite, zeros)):
        raise InputError(f"{place}: zero must be a list of numbers.")
    for key, values in (("sign", sign), ("zero", zeros)):
        if values and len(values) != len(columns):
            raise InputError(
                f"{place}: {key} has {len(values)} entries for {len(columns)} columns."
            )
    return SignalMap(
        columns=tuple(columns),
        unit=_one_of(table, "unit", UNITS[name], f"unit in {place}"),
        side=_one_of(table, "side", ("link", "motor"), f"side in {place}"),
        sign=tuple(map(float, sign)),
        zero=tuple(map(float, zeros)),
    )


def _csv(table: dict, where: str) -> CsvFormat:
    place = f"csv of {where}"
    check_keys(table, ("separator", "decimal", "skip"), place)
    separator, skip = table.get("separator"), table.get("skip", 0)
    if separator is not None and not (
        isinstance(separator, str) and len(separator) == 1
    ):
        raise InputError(f"{place}: separator must be one character.")
    decimal = _one_of(table, "decimal", (".", ","), f"decimal in {place}")
    if decimal == separator:
        raise InputError(f"{place}: separator and decimal are both '{decimal}'.")
    if not isinstance(skip, int) or isinstance(skip, bool) or skip < 0:
        raise InputError(f"{place}: skip must be a number of lines.")
    return CsvFormat(separator, decimal, skip)


def _bag(table: dict, where: str) -> BagFormat:
    place = f"bag of {where}"
    check_keys(table, ("topic", "joints", "time"), place)
    joints = table.get("joints", [])
    if not _is_list(joints, str) or len(set(joints)) < len(joints):
        raise InputError(f"{place}: joints must be a list of names, joint 1 first.")
    topic = _text(table, "topic", "", place) or None
    time = _one_of(table, "time", ("header", "record"), f"time in {place}")
    return BagFormat(topic, tuple(joints), time)


def _one_of(table: dict, key: str, valid: Mapping | tuple, what: str) -> str:
    """Return one of the valid texts; the first is the default."""
    return check_name(table.get(key, next(iter(valid))), valid, what)


def _text(table: dict, key: str, default: str, what: str) -> str:
    value = table.get(key, default)
    if not isinstance(value, str):
        raise InputError(f"{what}: {key} must be a text in quotes.")
    return value


def _is_list(value: object, kind: type) -> bool:
    return isinstance(value, list) and all(
        isinstance(v, kind) and not isinstance(v, bool) for v in value
    )
