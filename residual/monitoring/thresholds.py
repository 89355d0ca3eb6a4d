"""The thresholds of monitor, in one place (docs/monitoring.md).

Where no reason stands beside a value, `benchmarks/run.py monitoring` holds it: it counts what is
missed, and false alarms.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MonitoringThresholds:
    """What decides whether a sensor is as it was."""

    # Rows: windows of fixed length (Savitzky and Golay 1964).
    half: float = 0.03  # s: half a window
    step: float = 0.016  # s: between two rows
    order: int = 3  # of the polynomial: fits what a servo does within 60 ms
    gap: float = 1.5  # sample periods: more is a gap
    shortest: float = 1.0  # s

    # What is looked at.
    slow: float = 3.0  # standstill thresholds below which friction is not known
    memory: float = 0.1  # s after standing in which it is not either
    spread: int = 2  # samples on both sides of a spike
    # s over which errors are collected. On four arms (171 to 174) a second window of
    # 1 s found no fault that this one did not, nor did levels of noise.
    window: float = 0.25
    still: float = 1.0  # s: readings that rest longer in good order tell nothing by it

    # Limits.
    block: float = 2.0  # s: maxima of blocks so long are independent, nearly
    tail: float = 0.2  # of the blocks are over the threshold
    sure: float = 1.645  # one-sided 95 % of a normal variable
    margin: float = 1.5  # times the largest value that healthy runs showed
    # Collected errors depend on the motion more than a few healthy runs can show: an
    # error of the model that grows with torque, and tracking, more than a bias. On 9
    # simulated arms 1.25 for all gave 13 false alarms in 2.3 h, these values 1; of 81
    # lost scales 7 instead of 6 were found after more than a second.
    wider_bias: float = 1.25
    wider_motion: float = 1.5

    # Names of alarms.
    together: float = 0.1  # s in which the surest kind is awaited
    later: float = 0.6  # s in which collected errors are
    quiet: float = 1.0  # s without a crossing after which an alarm is over
    back: float = 2.0  # s before an alarm in which an error may have begun to grow


MONITOR = MonitoringThresholds()
