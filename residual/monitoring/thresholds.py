"""The thresholds of monitor, in one place (docs/monitoring.md).

Values without a reason are set by `benchmarks/run.py monitoring`, which counts missed faults
and false alarms.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class MonitoringThresholds:
    """Thresholds of the decision whether a sensor is healthy."""

    # Rows: windows of fixed length (Savitzky and Golay 1964).
    half: float = 0.03  # s: half a window
    step: float = 0.016  # s: between two rows
    order: int = 3  # order of the polynomial: fits the motion of a servo within 60 ms
    gap: float = 1.5  # sample periods: more is a gap
    shortest: float = 1.0  # s

    # Indicators.
    slow: float = 3.0  # multiples of the standstill threshold below which friction is unknown
    memory: float = 0.1  # s after standstill during which it is unknown too
    spread: int = 2  # samples on both sides of a spike
    # s over which errors are averaged. On four arms (171 to 174) a second window of
    # 1 s found no fault that this one did not, nor did levels of noise.
    window: float = 0.25
    still: float = 1.0  # s: if healthy readings are unchanged longer, this indicator is unused

    # Limits.
    block: float = 2.0  # s: maxima of blocks of this length are nearly independent
    tail: float = 0.2  # of the blocks are over the threshold
    sure: float = 1.645  # one-sided 95 % of a normal variable
    margin: float = 1.5  # times the largest value in healthy runs
    # Averaged errors depend on the motion more than a few healthy runs can show: a model
    # error that grows with torque, and tracking, more than a bias. On 9
    # simulated arms 1.25 for all gave 13 false alarms in 2.3 h, these values 1; of 81
    # lost scales 7 instead of 6 were found after more than a second.
    wider_bias: float = 1.25
    wider_motion: float = 1.5

    # Names of alarms.
    together: float = 0.1  # s of waiting for the most specific kind
    later: float = 0.6  # s of waiting for averaged errors
    quiet: float = 1.0  # s without an exceedance after which an alarm ends
    back: float = 2.0  # s before an alarm in which an error may have started to grow


MONITOR = MonitoringThresholds()
