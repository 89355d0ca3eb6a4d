"""The thresholds of the check of logs, in one place (docs/check.md).

`benchmarks/run.py check` measures them: it counts the faults that the check misses, and the
sound logs that it accuses.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CheckThresholds:
    """Limits of the decisions; nats are log evidence."""

    # One rule for all decisions by evidence: the gain of a fault over the log as given, and
    # the strain of the robot file without its worst joint.
    # Log odds against each deviation from the map; other arrangements are tried above.
    odds_nats: float = 10.0
    suspect_nats: float = 30.0  # sound logs stay below
    # Gravity is certain from `suspect_nats` on: on sound arms another direction of it
    # gains 5 nats at most.
    certain_nats: float = 60.0
    one_joint_nats: float = 40.0  # largest strain: two joints may have an effect

    least_rest: float = 0.02  # of a torque: smallest error of any file
    rough_rest: float = 0.08  # of a torque: largest residual of a rough file
    share_sd: float = 0.4  # relative, effect of loads and losses on a torque
    gain_ratio: float = 1.6  # of one torque's factor: below it is an effect

    # Single samples and constant values.
    spike_ratio: float = 12.0  # times the 99 % quantile of the signal's deviations
    spike_share: float = 0.002  # share of samples above which they are not single outliers
    outlier_share: float = 1e-3  # of the largest value of the signal: less is no outlier
    bit_share: float = 0.02  # of the same: a larger step is no sensor quantization
    frozen_s: float = 0.3
    torque_step_ratio: float = 0.08  # of the torque's rms
    angle_step_ratio: float = 0.4  # of the acceleration's rms
    moving_rad: float = 0.02  # motion of a joint, by angle, reference or velocity
    held_residual_share: float = 0.8  # of a held joint's torque

    # Time, in typical logs of arms.
    slowest_hz: float = 4.0
    fastest_hz: float = 20_000.0
    gap_steps: float = 5.0
    uneven_steps: float = 0.3
    clock_speed_ratio: float = 20.0  # of a joint's speed limit: no arm is faster

    # Velocities against angles.
    velocity_correlation: float = 0.95  # with the change of the joint's own angle
    velocity_spread: float = 0.02  # relative, of equal slopes

    # Limits of the joints.
    range_rad: float = 0.2  # beyond the range
    limit_ratio: float = 1.5  # of speed and torque: files are a little too strict
    # Of a limit, over several samples: no arm exceeds it. Of all torques: no file errs so.
    certain_ratio: float = 5.0

    # Information in a motion.
    shortest_s: float = 7.5  # of motion, all logs together
    one_way_share: float = 0.02  # of a path: a shorter way back does not count
    lockstep_correlation: float = 0.998  # of two speeds near zero
    tilted_rad: float = 0.1745  # 10 degrees: below it is an effect, a tilted base

    # Ratio of single torques to the model, whatever their units.
    explained_least: float = 0.3  # share of the torque that the model explains
    explained_well: float = 0.7  # the same, of a joint without a fault
    ratio_sd: float = 0.25  # largest relative deviation of a ratio
    # Grippers and loads reach 2 on the joint that they load least, and less in the mean
    # of the joints that carry the arm.
    unit_ratio: float = 1.8
    weak_joint_share: float = 0.03  # of the strongest torque: the ratio of a wrist is uncertain
    factor_spread: float = 1.1  # factors closer than this are equal

    # Commanded torque.
    command_residual: float = 0.01  # of its size: no model of a measured arm is closer
    command_ratio: float = 3.0  # of the residual on the motion to that on the reference
    repeated_share: float = 0.3  # of the rows of a log


CHECK = CheckThresholds()
