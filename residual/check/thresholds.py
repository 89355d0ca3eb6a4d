"""The thresholds of the check of logs, in one place (docs/check.md).

`benchmarks/run.py check` measures them: it counts the faults that the check misses, and the
sound logs that it accuses.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class CheckThresholds:
    """Limits of the decisions; nats are log evidence."""

    # One rule for all that evidence decides: what a fault gains over the log as it is
    # given, and how far a robot file must bend to the log, its worst joint left out.
    # Against each deviation from the map; other arrangements are tried from there on.
    odds_nats: float = 10.0
    suspect_nats: float = 30.0  # sound logs stay below
    # Gravity is certain from `suspect_nats` on: on sound arms another direction of it
    # gains 5 nats at most.
    certain_nats: float = 60.0
    one_joint_nats: float = 40.0  # bending at most: two joints may hide an effect

    least_rest: float = 0.02  # of a torque: no file is nearer
    rough_rest: float = 0.08  # of a torque: what a rough file may leave
    share_sd: float = 0.4  # relative, of what loads and losses leave of a torque
    gain_ratio: float = 1.6  # of one torque's factor: below it is an effect

    # Single samples and constant values.
    spike_ratio: float = 12.0  # times the 99 % quantile of the signal's deviations
    spike_share: float = 0.002  # of the samples: more are not single ones
    outlier_share: float = 1e-3  # of the largest of its signal: less is no outlier
    bit_share: float = 0.02  # of the same: a larger step is no bit of a sensor
    frozen_s: float = 0.3
    torque_step_ratio: float = 0.08  # of the torque's rms
    angle_step_ratio: float = 0.4  # of the acceleration's rms
    moving_rad: float = 0.02  # a joint moves, by angle, reference or velocity
    held_residual_share: float = 0.8  # of a held joint's torque

    # Time, as loggers of arms keep it.
    slowest_hz: float = 4.0
    fastest_hz: float = 20_000.0
    gap_steps: float = 5.0
    uneven_steps: float = 0.3
    clock_speed_ratio: float = 20.0  # of a joint's speed limit: no arm is so fast

    # Velocities against angles.
    velocity_correlation: float = 0.95  # with the change of the joint's own angle
    velocity_spread: float = 0.02  # relative, of slopes that are one number

    # Limits of the joints.
    range_rad: float = 0.2  # beyond the range
    limit_ratio: float = 1.5  # of speed and torque: files are a little too strict
    # Of a limit, over several samples: no arm does. Of all torques: no file is off so.
    certain_ratio: float = 5.0

    # What a motion shows.
    shortest_s: float = 7.5  # of motion, all logs together
    one_way_share: float = 0.02  # of a path that does not count as a way back
    lockstep_correlation: float = 0.998  # of two speeds about zero
    tilted_rad: float = 0.1745  # 10 degrees: below it is an effect, a tilted base

    # Ratio of single torques to the model, whatever their units.
    explained_least: float = 0.3  # share of the torque that the model explains
    explained_well: float = 0.7  # the same, of a joint without a fault
    ratio_sd: float = 0.25  # relative deviation of a ratio at most
    # Grippers and loads reach 2 on the joint that they load least, and less in the mean
    # of the joints that carry the arm.
    unit_ratio: float = 1.8
    weak_joint_share: float = 0.03  # of the strongest torque: a wrist's ratio is unsure
    factor_spread: float = 1.1  # factors so near to each other are one

    # Torque that is a command.
    command_residual: float = 0.01  # of its size: no arm's model is so near
    command_ratio: float = 3.0  # of the residual on the motion to that on the reference
    repeated_share: float = 0.3  # of the rows of a log


CHECK = CheckThresholds()
