"""From the columns of a log to SI units at the link side, and what was understood."""

from collections.abc import Iterable
from dataclasses import dataclass
from datetime import datetime

import numpy as np

from residual.errors import InputError
from residual.robot.robot import Robot
from warehouse.logs.check import Doubt
from warehouse.logs.columns import LOGGED_UNITS, UNITS, SignalMap

Array = np.ndarray


def to_link_side(name: str, raw: Array, signal: SignalMap, robot: Robot) -> Array:
    """Convert one signal of all joints.

    Positions and their derivatives: scale * unit * sign * (reading - zero), then from
    motor to joint by the inverse of the transmission. Torques: from motor to joint by
    its transpose, since both sides carry the same power.

    Args:
        name: "q", "qd", "qdd", "q_ref" or "tau".
        raw: Readings. Shape (n, dof).
        robot: Gears and torque per logged unit.

    Returns:
        Values in SI units, link side. Shape (n, dof).

    Raises:
        InputError: If the robot lacks a gear ratio or torque per unit that is needed.
    """
    values = raw
    if signal.zero:
        values = values - np.array(signal.zero)
    factor = UNITS[name][signal.unit]
    if factor != 1 or signal.sign:
        values = values * (factor * np.array(signal.sign or 1.0))
    if signal.scale:
        values = values * np.array(signal.scale)
    if name == "tau":
        return _torque(values, signal, robot)
    if signal.side == "motor":
        return np.linalg.solve(_transmission(name, robot), values.T).T
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
    # torque_per_unit holds at the link already; only couplings are left to apply.
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


def channels_of(name: str, signal: SignalMap) -> list[tuple[str, str, str, str]]:
    """Return channel, column, unit and what is done to it, joint by joint."""
    out = []
    for i, column in enumerate(signal.columns):
        done = ["from motor side"] if signal.side == "motor" else []
        if signal.sign and signal.sign[i] < 0:
            done.append("sign turned")
        if signal.scale and signal.scale[i] != 1:
            done.append(f"times {signal.scale[i]:.6g}")
        if signal.zero and signal.zero[i]:
            done.append(f"zero at {signal.zero[i]:g}")
        out.append((f"{name}{i + 1}", column, signal.unit, ", ".join(done)))
    return out


def describe(name: str, signal: SignalMap) -> str | None:
    """Return in words what was converted, None for nothing."""
    units = [unit for unit, factor in UNITS[name].items() if factor == 1]
    parts = []
    if signal.unit not in units or signal.unit in LOGGED_UNITS:
        parts.append(f"{signal.unit} to {units[0]}")
    if signal.side == "motor":
        parts.append("motor to link side")
    if any(s < 0 for s in signal.sign):
        turned = [str(i) for i, s in enumerate(signal.sign, start=1) if s < 0]
        parts.append(f"sign turned on joint {', '.join(turned)}")
    if any(value != 1 for value in signal.scale):
        parts.append(f"times {', '.join(f'{value:.6g}' for value in signal.scale)}")
    if any(signal.zero):
        parts.append("zero moved")
    return f"{name}: {', '.join(parts)}" if parts else None


@dataclass(frozen=True, slots=True)
class Understood:
    """What was read, what was not, and what was converted.

    Attributes:
        id: Label of the recording.
        file: File as the user wrote it, without the window.
        window: Window as the user wrote it, None for the whole log.
        rows: Number of samples.
        rate: Mean sample rate [Hz].
        duration: From the first to the last sample [s].
        used: Columns read.
        ignored: Columns not read.
        conversions: Every change of unit, side, sign or zero, in words.
        warnings: What is odd but usable.
        notes: What was understood of the file beyond its columns.
        channels: Channel, column, unit and what else is done to it, one by one.
        doubts: Why the samples can be none of this arm; empty for a usable log.
        recorded_at: When the first sample was taken, UTC; None where that is not said.
    """

    id: str
    file: str
    window: str | None
    rows: int
    rate: float
    duration: float
    used: tuple[str, ...]
    ignored: tuple[str, ...]
    conversions: tuple[str, ...]
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()
    channels: tuple[tuple[str, str, str, str], ...] = ()
    doubts: tuple[Doubt, ...] = ()
    recorded_at: datetime | None = None

    @property
    def text(self) -> str:
        """One line for the terminal."""
        size = f"{self.rows} samples, {self.rate:.4g} Hz, {self.duration:.4g} s"
        parts = [f"{self.id}: {size}", f"read {shorten(self.used)}"]
        if self.ignored:
            parts.append(f"ignored {shorten(self.ignored)}")
        parts += [*self.conversions, *self.notes]
        return "; ".join(parts)


def shorten(columns: Iterable[str]) -> str:
    """Return names in one line: q1 q2 q3 tau1 tau2 as "q1..3 tau1..2"."""
    words: list[str] = []
    first, last = "", ("", None)  # of the word that the next number may go on from
    for name in columns:
        stem, number = _split(name)
        # Goes on where the last word ended: q1..3 and q4 are q1..4.
        if number is not None and last == (stem, number - 1):
            words[-1] = f"{first}..{number}"
        else:
            words.append(name)
            first = name
        last = stem, number
    return " ".join(words)


def _split(name: str) -> tuple[str, int | None]:
    stem = name.rstrip("0123456789")
    digits = name[len(stem) :]
    # A leading zero would be lost: "J01" stays as it is.
    if not 0 < len(digits) < 10 or not stem or digits != str(int(digits)):
        return name, None
    return stem, int(digits)
