"""A log that was spoiled on purpose, and helpers that all faults use."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.check_parts.arms import Host
from residual.recording import Recording
from residual.robot.dynamics import inverse_dynamics

Array = np.ndarray
Table = dict[str, Array]
SIGNALS = ("t", "q", "qd", "tau")
_TOLD_APART = 0.1  # of a joint's torque: two readings that differ by less are one


@dataclass(frozen=True, eq=False, slots=True)
class Spoiled:
    """Logs with one fault, and the truth beside them.

    Attributes:
        kind: What was done to them.
        joints: Where, from 1; () for all.
        tables: Signals of each log by name.
        right: The same as a right repair reads them; empty where none can.
        urdf: Text of the robot file that is given.
        toml: Text of the robot.toml that is given, "" for none.
        also: Other kinds that are as right.
    """

    kind: str
    joints: tuple[int, ...]
    tables: Sequence[Table]
    right: Sequence[Table] = ()
    urdf: str = ""
    toml: str = ""
    also: tuple[str, ...] = field(default=())


Fault = Callable[[Host, int, np.random.Generator], "Spoiled | None"]


def table_of(log: Recording) -> Table:
    """Return the signals of a log."""
    return {k: v for k in SIGNALS if (v := getattr(log, k)) is not None}


def tables_of(host: Host) -> list[Table]:
    """Return the signals of all clean logs of an arm."""
    return [table_of(log) for log in host.logs]


def changed(tables: Sequence[Table], change: Callable[[Table], Mapping]) -> list[Table]:
    """Return tables with some signals replaced."""
    return [table | dict(change(table)) for table in tables]


def some(rng: np.random.Generator, dof: int, count: int) -> tuple[int, ...]:
    """Draw joints, from 1 and in order."""
    return tuple(sorted(int(j) + 1 for j in rng.choice(dof, count, replace=False)))


def turned(dof: int, joints: Sequence[int]) -> Array:
    """Return factors of -1 at some joints, else 1."""
    return np.array([-1.0 if j + 1 in joints else 1.0 for j in range(dof)])


def told_apart(
    host: Host, angles: Callable, torques: Callable, logged: float = 0.0
) -> bool:
    """Whether two readings of a log differ by what the nominal model says of them.

    An arm is the mirror image of itself where the angles of some joints, and their
    torques, are turned: nobody can tell one reading from the other there.

    Args:
        angles: What one reading does to positions. (n, dof) to (n, dof).
        torques: What the other does to torques, so that both were the same.
        logged: Share of the logged torque, friction and all, that they have to differ
            by on some joint too.
    """
    log = host.logs[0]
    step = max(1, len(log.t) // 1000)
    q, t = log.q[::step], log.t[::step]
    own = _model_torque(host, t, q)
    read = _model_torque(host, t, angles(q))
    size = np.sqrt(np.mean(own**2, axis=0)) + 1e-9
    apart = np.sqrt(np.mean((torques(own) - read) ** 2, axis=0))
    seen = apart / (np.std(torques(log.tau[::step]), axis=0) + 1e-9)
    return bool((apart / size).max() > _TOLD_APART and seen.max() > logged)


def _model_torque(host: Host, t: Array, q: Array) -> Array:
    qd = np.gradient(q, t, axis=0)
    return inverse_dynamics(host.robot.model, q, qd, np.gradient(qd, t, axis=0))
