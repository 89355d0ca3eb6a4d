"""The thresholds of monitor, in one place (docs/monitoring.md).

Where no reason stands beside a value, benchmarks/plsr.py holds it: it counts what is
missed, and false alarms.
"""

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True)
class Rules:
    """What decides whether a sensor is as it was."""

    # Rows: windows of fixed length (Savitzky and Golay 1964).
    half: float = 0.03  # s: half a window
    step: float = 0.016  # s: between two rows
    order: int = 3  # of the polynomial: fits what a servo does within 60 ms
    gap: float = 1.5  # sample periods: more is a gap
    shortest: float = 1.0  # s

    # Where a model is not to be trusted.
    slow: float = 3.0  # standstill thresholds below which friction is not
    memory: float = 0.1  # s after standing in which it is not either
    pull: float = 1e-3  # share of the rows that the belief in the model weighs

    # The cycles of a program.
    same: float = 2e-3  # rad to its own past that a wanted position has a cycle later
    shortest_cycle: float = 0.5  # s
    repeating: float = 0.5  # of the rows that move: others are alike at any lag
    moving: float = 0.1  # of the rows must move

    # Scores of sensors.
    spread: int = 2  # samples on both sides of a spike
    windows: tuple[float, float] = (0.25, 1.0)  # s: matched features are collected
    explained: float = 0.8  # of the errors' variance that components are kept for
    outside: float = 0.05  # of a calibrated range by which a state may be outside
    still: float = 1.0  # s: readings that rest longer in good order tell nothing by it
    # These scores depend on the motion more than a few good runs can show: on arms that
    # did not set these factors, a program that is a little unusual was one alarm per
    # cycle.
    wider: dict[str, float] = field(
        default_factory=lambda: {"model": 1.25, "cycle": 1.15, "errors": 1.5}
    )

    # Limits.
    tail: float = 0.2  # of the blocks are over the threshold
    sure: float = 1.645  # one-sided 95 % of a normal variable
    margin: float = 1.5  # times the largest value that good runs showed

    # Names of alarms.
    together: float = 0.1  # s in which the surest kind is awaited
    later: float = 0.6  # s in which the best matched feature is
    quiet: float = 1.0  # s without a crossing after which an alarm is over
    complex: float = 1.25  # by which an encoder has to explain more than a torque


MONITOR = Rules()
