"""The thresholds of the check of logs, in one place (docs/check.md).

Where no reason stands beside a value, it is held by benchmarks/check.py, which counts
the faults that are missed, and those that healthy arms are accused of.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Rules:
    """What decides whether a log is what it says it is; nats are log evidence."""

    # Rows by which the physics of a log is judged.
    row_filter: float = 5.0  # Hz, on angles and torque
    row_rate: float = 60.0  # Hz
    most_rows: int = 360
    apart: float = 0.3  # s: rows nearer to each other count as one in evidence

    # Single samples. Of what samples do but for one in a hundred: noise of any shape
    # stays below.
    spike: float = 12.0
    most_spikes: float = 0.002  # share of samples: more are not single ones
    median_window: int = 7  # samples
    whole_turn: float = 0.3  # rad off it: what the joint moved meanwhile
    too_far: float = 10.0  # times the way that a joint can go in a step

    # Values that stand.
    frozen_time: float = 0.3  # s
    frozen_samples: int = 15
    usual_runs: float = 5.0  # times the runs that a signal has elsewhere
    jump: float = 0.01  # rad by which a frozen angle comes back
    clipped_run: int = 4  # samples at the limit
    clipped_runs: int = 2  # and how often
    fuller: float = 4.0  # times the samples of the levels below the limit
    coarse_torque: float = 0.08  # of the torque's rms
    coarse_angle: float = 0.4  # of the acceleration's rms
    coarse_cutoff: float = 12.0  # Hz at which accelerations are judged
    moves: float = 0.02  # rad that a joint moves, by angle, reference or velocity
    held_noise: float = 5.0  # times the torque's noise, sample by sample
    # What a held joint's torque has beside all that it feels: up to a half where other
    # friction and a load are hidden, more where friction holds it.
    held_left: float = 0.5
    held_most_left: float = 0.8
    rough_start: float = 0.05  # of the torque, to begin with
    fit_rounds: int = 4
    held_beyond: float = 1.5  # times what a held joint may feel
    held_far_beyond: float = 2.0

    # Time, as loggers of arms keep it.
    slowest_rate: float = 4.0  # samples per second
    fastest_rate: float = 20_000.0
    any_rate: float = 1e6  # no torque is logged faster, and no clock is off by less
    usual_rate: float = 300.0
    gap: float = 5.0  # steps
    uneven: float = 0.3  # of a step
    clock_speed: float = 20.0  # of a joint's speed limit: no arm is so fast
    clock_share: float = 0.95  # of the samples are slower

    # Velocities against angles.
    velocity_window: float = 0.2  # s
    velocity_same: float = 0.95  # correlation with its own angle's change
    velocity_alike: float = 0.02  # relative, of slopes that are one number
    velocity_off: float = 0.1  # relative, of a slope that is not one

    # Limits of the robot file.
    range_angle: float = 0.2  # rad beyond the range
    range_limit: float = 1.5  # of speed and torque: files are a little too strict
    range_fast: float = 10.0  # of the speed limit: no arm does
    range_far: float = 3.0  # of the range: no arm does
    excursion: float = 5.0  # of a real limit, over several samples: no arm does
    range_share: float = 0.99  # of the samples, so that single ones do not count
    range_stride: float = 0.1  # s over which a speed is taken
    zero_step: float = 0.3  # rad between the zeros that are tried
    most_zeros: int = 16
    zero_worth: float = 30.0  # nats that it gains where the columns are right

    # The robot file.
    densest: float = 1e3  # kg/m^3 of the cube of the reach: arms have 1 to 200
    thinnest: float = 1e-2  # kg/m^3: air weighs 1.2
    longest: float = 50.0  # m
    widest: float = 3.0  # radius of gyration in reaches
    earth: tuple[float, float] = (9.6, 10.0)  # m/s^2
    largest_gravity: float = 30.0  # m/s^2
    negative: float = 1e-3  # of the largest moment
    triangle: float = 0.7  # of the largest moment: files round, vendors simplify

    # What a motion shows.
    shortest: float = 7.5  # s of motion, all logs together
    one_way: float = 0.02  # share of a path that does not count as a way back
    travel: float = 0.05  # rad: below it a joint stands
    together: float = 0.998  # correlation of two speeds about zero

    # What a torque may be made of before a log is believed: priors, one deviation each.
    body: float = 0.3  # relative, of the inertial parameters
    load: float = 0.05  # of the arm's mass
    lever: float = 0.15  # of its reach
    strange: float = 0.005  # of the arm's mass: parts that no file has
    tilt: float = 0.1  # rad
    pull: float = 0.05  # of the arm's weight, at the flange
    least_size: float = 0.05  # of the strongest joint's torque
    # Of the strongest channel's rms: what wrists feel of the other joints' load.
    coupled: float = 0.01
    rough: float = 0.08  # what a rough model may leave of a torque
    exact: float = 1e-6  # of the nominal torque's mean square: no model is nearer

    # Readings of the columns.
    gear: float = 100.0  # a usual one: motors' torques are so much smaller
    odds: float = 10.0  # nats against each thing that is not as the map says
    rounds: int = 3
    certain: float = 50.0  # nats that the reading given loses against the repair
    # Other angles are many readings; one of them may suit an odd but healthy arm.
    certain_angles: float = 80.0
    suffers: float = 5.0  # share of the gain that one channel may lose
    worth: float = 30.0  # nats below which nothing is said
    gain: float = 20.0  # the same of all repairs together, less the odds
    # Nats by which a robot file must bend, its worst joint left out: with rough files
    # and hidden effects it is below 30, with the file of another arm it is above.
    bent: float = 28.0
    broken: float = 150.0
    bent_as_given: float = 70.0
    per_kind: float = 15.0  # for each further kind of mistake in one map
    one_joint: float = 40.0  # nats at most: two joints may hide an effect
    parts: int = 4  # in time
    part_fits: float = 0.25  # of the strain of the worst part

    # Gravity.
    tilted: float = 0.1745  # rad, 10 degrees: below it is an effect, a tilted base
    mounted: float = 25.0  # nats: sound arms reach 5, 15 degrees in half a minute 30
    mounted_explains: float = 0.5  # of what the file leaves is left, at most
    removed_explains: float = 0.75  # the same without weight: a load leaves more
    axis_worth: float = 2.0  # nats that an axis may lose to what is beside it
    turns_of_gravity: int = 12
    still: float = 2e-3  # rad
    bodies: tuple[float, ...] = (0.1, 0.3, 1.0)  # times ``body``, by evidence
    any_load: float = 3.0  # times ``load``
    stands_off: float = 0.3  # times ``tilt``: what upright arms stand off
    free_tilt: float = 3.0  # times ``tilt``

    # Clocks, single torques.
    times: tuple[float, ...] = (0.1, 0.5, 2.0, 10.0)  # true time over the one given
    world: float = 65.0  # nats: files that are off by half, not a third, reach 60
    # A rough file may be wrong in inertia and right in weight: time is rarely certain.
    certain_time: float = 150.0
    # What the fit leaves says how rough a model is; none is nearer than this to the
    # torque, or to the strongest joint's.
    scale_noise: float = 0.01
    scale_coupled: float = 0.001

    # Shares of weight, inertia and friction in a torque.
    fewest: int = 20  # moving rows of a joint
    turns: float = 0.05  # of the usual speed, where the sign of friction turns
    weightless: float = 1e-6  # of the heaviest joint's: an upright axis carries none
    shows: float = 0.3  # explained at least
    sharp: float = 0.25  # deviation of a share at most
    # Times: grippers and loads reach 2 on the joint that they load least, and less in
    # the mean of those that carry the arm.
    unit_off: float = 2.5
    unit_certain: float = 5.0
    unit_same: float = 2.5  # shares of a right unit are nearer to one on some joint
    unlike: float = 4.0  # shares of a right joint in its unit are nearer to one
    tells: float = 0.03  # of the strongest torque: a wrist's factor is anything
    factors_alike: float = 1.1  # factors so near to each other are one
    # One factor on all torques: joints that show it, how well, and its least size.
    common_joints: int = 3
    common_seen: float = 0.9  # explained at least
    common_sd: float = 0.05  # of the share
    common_off: float = 1.25
    weight_gone: float = 0.2  # of the weight; time that is doubled leaves a quarter
    joints_least: int = 2
    poor: float = 0.7  # explained at most, as given
    removed_alike: float = 1.6  # inertia without weight, times that of the file
    nearest: float = 0.02  # of a torque: no file is nearer
    good: float = 0.7  # at least, with two joints exchanged
    exchange_worth: float = 40.0  # nats
    exchange_certain: float = 80.0
    exchange_agrees: float = 5.0  # nats of the bent body, which sees it more weakly

    # Torque that was smoothed at its source: shares of the sampling rate between which
    # noise of a sensor is as strong, in segments so short that most hold no reversal.
    segment: int = 128  # samples
    near_band: tuple[float, float] = (0.12, 0.2)
    high_band: tuple[float, float] = (0.35, 0.47)
    fall: float = 20.0  # dB from one to the other: a filter of second order at least
    silent: float = 1e-4  # of the rms: below it no sensor's noise is

    # Torque that is a command.
    plan_filter: float = 25.0  # Hz: derivatives of a reference have no noise
    plan_rows: int = 900  # that are looked at
    plan_per_column: int = 4  # rows for each column at least
    plan_edge: float = 0.5  # s
    plan_slow: float = (
        0.1  # of the largest speed: nearer to a reversal friction differs
    )
    # Of its size: sensors have more noise, and no arm's model is so near.
    follows: float = 0.01
    follows_away: float = 3.0  # times what is left, by the motion itself
    repeats: float = 0.3  # share of the rows of a log
    repeats_least: int = 50  # rows that differ

    # Repairs of angles that references share.
    reference_same: float = 0.1  # of the angle's travel, as they are logged


CHECK = Rules()
