"""The thresholds of the check of logs, in one place (docs/check.md).

benchmarks/check.py holds them: it counts the faults that are missed, and the sound logs
that are accused.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Rules:
    """Limits of the decisions; nats are log evidence."""

    # One rule for all that evidence decides: what a fault gains over the log as it is
    # given, and how far a robot file must bend to it, its worst joint left out.
    odds: float = 10.0  # nats against each thing that is not as the map says
    doubt: float = 30.0  # nats: a fault is suspected; sound logs stay below
    certain: float = 60.0  # nats: the reading given is excluded
    suffers: float = 5.0  # share of the gain that one channel may lose
    one_joint: float = 40.0  # nats of bending at most: two joints may hide an effect
    broken: float = 150.0  # nats of bending: another arm, for certain

    # Single samples and values that stand.
    spike: float = 12.0  # times what samples do but for one in a hundred
    most_spikes: float = 0.002  # share of samples: more are not single ones
    frozen_time: float = 0.3  # s
    jump: float = 0.01  # rad by which a frozen angle comes back
    coarse_torque: float = 0.08  # of the torque's rms
    coarse_angle: float = 0.4  # of the acceleration's rms
    moves: float = 0.02  # rad that a joint moves, by angle, reference or velocity
    held_left: float = 0.8  # of a held joint's torque, beside all that it feels
    held_beyond: float = 2.0  # times what a held joint may feel

    # Time, as loggers of arms keep it.
    slowest_rate: float = 4.0  # samples per second
    fastest_rate: float = 20_000.0
    any_rate: float = 1e6  # no torque is logged faster, and no clock is off by less
    gap: float = 5.0  # steps
    uneven: float = 0.3  # of a step
    clock_speed: float = 20.0  # of a joint's speed limit: no arm is so fast

    # Velocities against angles.
    velocity_same: float = 0.95  # correlation with its own angle's change
    velocity_alike: float = 0.02  # relative, of slopes that are one number
    velocity_off: float = 0.1  # relative, of a slope that is not one

    # Limits of the robot file.
    range_angle: float = 0.2  # rad beyond the range
    range_limit: float = 1.5  # of speed and torque: files are a little too strict
    range_fast: float = 10.0  # of the speed limit: no arm does
    range_far: float = 3.0  # of the range: no arm does
    excursion: float = 5.0  # of a real limit, over several samples: no arm does

    # The robot file, and what a motion shows.
    widest: float = 3.0  # radius of gyration in reaches
    earth: tuple[float, float] = (9.6, 10.0)  # m/s^2
    shortest: float = 7.5  # s of motion, all logs together
    one_way: float = 0.02  # share of a path that does not count as a way back
    travel: float = 0.05  # rad: below it a joint stands
    together: float = 0.998  # correlation of two speeds about zero

    # Gravity.
    tilted: float = 0.1745  # rad, 10 degrees: below it is an effect, a tilted base

    # Shares of the model in single torques, whatever their units.
    shows: float = 0.3  # explained at least
    sharp: float = 0.25  # deviation of a share at most
    poor: float = 0.7  # explained at most, as given
    # Times: grippers and loads reach 2 on the joint that they load least, and less in
    # the mean of those that carry the arm.
    unit_off: float = 2.5
    unit_certain: float = 5.0
    unlike: float = 4.0  # shares of a right joint in its unit are nearer to one
    removed_alike: float = 1.6  # inertia without weight, times that of the file
    tells: float = 0.03  # of the strongest torque: a wrist's factor is anything
    factors_alike: float = 1.1  # factors so near to each other are one
    weight_gone: float = 0.2  # of the weight; time that is doubled leaves a quarter

    # Torque that is a command.
    follows: float = 0.01  # of its size: no arm's model is so near
    follows_away: float = 3.0  # times what is left, by the motion itself
    repeated_share: float = 0.3  # of the rows of a log


CHECK = Rules()
