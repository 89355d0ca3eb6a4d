"""The checked log of one motion: measured signals only."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from residual.drive import Array, Drive, compute_drive_torque
from residual.errors import RecordingError


@dataclass(frozen=True, eq=False, slots=True, repr=False)
class Recording:
    """Samples of one motion.

    Attributes:
        id: Opaque label, unique among the logs of one diagnosis.
        robot: Name of the robot.
        t: Sample times on the log's own clock, strictly increasing [s]. Shape (n,).
        q: Joint positions, link side [rad]. Shape (n, dof).
        tau: Measured joint torques, link side [N m]. Shape (n, dof).
        qd: Measured velocities where logged [rad/s]. Shape (n, dof) or None.
        qdd: Measured accelerations where logged [rad/s^2]. Shape (n, dof) or None.
        q_ref: Reference positions where logged [rad]. Shape (n, dof) or None.
        enabled: 1 where a drive is on, 0 where it is off. Shape (n, dof) or None.
        masked: 1 where a joint's torque is unknown, so that no row of it is fitted or
            tested: a drive at its limit, a gap. Shape (n, dof) or None.
        drive: The drives from which tau is computed, None if it is measured.

    Raises:
        RecordingError: On a wrong shape, a value that is not finite, or a time that
            does not increase.
    """

    id: str
    robot: str
    t: Array
    q: Array
    tau: Array
    qd: Array | None = None
    qdd: Array | None = None
    q_ref: Array | None = None
    enabled: Array | None = None
    masked: Array | None = None
    drive: Drive | None = None

    def __post_init__(self) -> None:
        for field in fields(self)[2:-1]:
            value = getattr(self, field.name)
            if value is None:
                continue
            array = value if _kept_safe(value) else np.array(value, dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, field.name, array)
            self._check(field.name, array)
        steps = np.diff(self.t)
        if len(steps) and steps.min() <= 0:
            row = int(np.argmax(steps <= 0)) + 1
            raise RecordingError(
                f"{self.id}: time must increase; sample {row} is at {self.t[row]:g} s "
                f"after {self.t[row - 1]:g} s. Remove repeated or reordered samples."
            )

    def __repr__(self) -> str:
        return (
            f"Recording({self.id}: {self.robot}, {len(self.t)} samples of {self.dof} "
            f"joints, {self.duration:.1f} s)"
        )

    def _check(self, name: str, array: Array) -> None:
        expected = (len(self.t),) if name == "t" else (len(self.t), self.dof)
        if array.shape != expected:
            raise RecordingError(f"{self.id}: {name} has shape {array.shape}, expected {expected}.")
        if not np.isfinite(array).all():
            row = int(np.argwhere(~np.isfinite(array))[0][0])
            raise RecordingError(
                f"{self.id}: {name} is NaN or infinite at sample {row}. "
                "Cut the log there with a window (FILE@start:end) or repair it."
            )

    @property
    def dof(self) -> int:
        """Number of joints."""
        return np.shape(self.q)[1]

    @property
    def duration(self) -> float:
        """Time from the first to the last sample [s]."""
        return float(self.t[-1] - self.t[0])


def _kept_safe(value: object) -> bool:
    """Whether an array is read-only, so that a part of a log needs no copy."""
    if not isinstance(value, np.ndarray) or value.dtype != float:
        return False
    while isinstance(value, np.ndarray):
        if value.flags.writeable:
            return False
        value = value.base
    return True


def apply_drive(recording: Recording, drive: Drive) -> Recording:
    """Return a log with the torque of its drives, masked where they are at their limit.

    Args:
        recording: With a goal (q_ref). Other masked rows are kept.
    """
    driven = recording.q_ref, recording.q, recording.t, recording.enabled
    masked = np.zeros(recording.q.shape, bool)
    if recording.masked is not None:
        masked |= recording.masked > 0
    if recording.drive is not None:
        masked &= ~compute_drive_torque(recording.drive, *driven)[1]
    tau, at_limit = compute_drive_torque(drive, *driven)
    return replace(recording, tau=tau, masked=masked | at_limit, drive=drive)


def compute_speed_quantile(recording: Recording, stride: int, share: float) -> Array:
    """Return a quantile of the speed of a log [rad/s]. (dof,).

    Speeds are computed over several samples, to reduce noise.
    """
    t, q = recording.t[::stride], recording.q[::stride]
    speed = np.abs(np.diff(q, axis=0) / np.diff(t)[:, None])
    return np.quantile(speed, share, axis=0)


def compute_usual_speeds(recordings: Sequence[Recording], share: float) -> Array:
    """Return the largest such speed of any log, over tenths of a second. (dof,)."""
    speeds = []
    for r in recordings:
        stride = round(0.1 / float(np.median(np.diff(r.t))))
        speeds.append(compute_speed_quantile(r, max(1, min(stride, len(r.t) // 4)), share))
    return np.max(speeds, axis=0)
