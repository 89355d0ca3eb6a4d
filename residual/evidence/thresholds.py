"""The thresholds of a diagnosis, all that there are, in one record.

docs/method.md says where the first of them come from. Numerical tolerances, and grids
of scales and sizes, stay where they are used.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EvidenceThresholds:
    """What names an effect, and what is said of it and of the rest."""

    # What decides a name, its probability or a flag.
    block_seconds: float = 2.0  # length from which errors of two blocks are independent
    min_blocks: int = 8  # blocks at least
    max_blocks: int = 48  # blocks at most
    min_block_rows: int = 10  # moving rows without which a joint has no vote in a block
    prior_blocks: float = 15.0  # blocks that independent noise counts as

    # prior size of an effect's torque, as a share of torque rms
    prior_torque_share: float = 0.3
    noise_floor: float = 0.003  # of torque rms: no log is believed to be cleaner
    min_rows: float = 5.0  # that a joint counts for at least
    # times the largest logged torque, where no limit is given
    unknown_limit_factor: float = 2.0
    # of the noise of the torque: less torque made by noise of the angles is nothing
    shaken_share: float = 0.1
    # scale: a nominal worse than this is too rough to blame a payload; of the first
    # fit, which only feeds model-based features
    rough_scale: float = 0.1

    # chance of one false name in a whole diagnosis
    false_chance: float = 0.001
    min_share: float = 0.02  # of a joint's left-out error or torque: worth a name
    left_out_slack: float = 2.0  # nats that left-out blocks may lose
    curve_knots: int = 10  # of a free curve
    # of what a curve of its joint explains: what a name must alone
    explained_share: float = 0.75
    paired_deviations: float = 2.0  # of a paired difference that is no chance
    ripple_order_ratio: float = 1.5  # ratio of orders from which two ripples are two

    same_share: float = 0.05  # of the left-out error: scales that predict as well
    # nats within which an alternative cannot be told from the name
    class_nats: float = 6.0
    even_nats: float = 12.0  # evidence at which a name is as likely as not
    clean_even_nats: float = 8.0  # the same where nothing but noise is left
    odds_slope: float = 5.4  # of the log odds of a name over ln(nats)
    sure_probability: float = 0.9  # from which a name is in the model
    min_probability: float = 0.5  # probability under which a name is not the likeliest

    # structured residual, as a share of torque rms, that is flagged
    flag_share: float = 0.05
    doubt_share: float = 0.015  # share of torque rms that is not nothing
    # times the noise that is not nothing: complete models keep up to 1.15 times, a dead
    # zone of a sensor that shows at all 2.7 and more
    doubt_noises: float = 2.0
    min_fall: float = 0.005  # least fall of a joint's error, as a share of torque rms

    # What two epochs share, and what logs of an arm differ by without a change.
    min_epoch_rows: float = 60  # rows of each epoch without which a joint is not compared
    # of torque rms: what a column of one joint may differ by from the fit of all joints
    shared_share: float = 0.03
    friction_spread: float = 0.01  # of its friction: what a joint differs by at least
    warmth: float = 0.3  # of all friction: what warmth may move
    warmth_spread: float = 0.45  # of the warmth of all joints, by which one may differ
    ramp_share: float = 0.02  # of its friction, from the middle of a log to its end
    one_way_share: float = 0.1  # of what friction moves by: more one way than the other
    gain_share: float = 0.05  # of a large change: what a drive may misreport of it
    load_precision: float = 0.1  # of that of a usual load: one that is hung on
    usual_joints: float = 2.0  # joints, or logs, that what is usual of friction counts as
    few_logs: int = 3  # logs from which their differences are known
    few_logs_factor: float = 1.2  # least unrest where they are fewer
    kept_ratios: float = 0.9  # of the differences of logs: no single one decides
    changed_share: float = 0.025  # of torque rms: a change without a name
    usual_log_spread: float = 0.3  # of logs, in ln(squared error)
    usual_logs: float = 3.0  # logs that this counts as
    drift_deviations: float = 3.0  # of warmth that is no chance
    moved_share: float = 0.3  # of the warmth of all joints: one that moved with them
    unlike_refit_ratio: float = 2.0  # times a refit's error: a change not explained
    long_epoch: float = 300.0  # s from which a part of an epoch is looked at
    kept_epoch: float = 280.0  # s of that part

    # How much is tried.
    max_effects: int = 30  # most effects to add
    max_exact_looks: int = 15  # candidates that get an exact look per step
    min_quick_nats: float = 2.0  # by a quick look: less gets no other
    # of the most evidence by a quick look: fainter candidates get no exact look
    faint_share: float = 0.3
    hopeless_share: float = 0.3  # of the left-out error: no sharper scale is tried
    class_looks: int = 8  # candidates that may stand in for a name
    width_rounds: int = 3  # looks at the widths of single kinds
    refit_rounds: int = 4  # at what was named, before the second search
    steady_nats: float = 0.1  # nats by which one more look at it changes nothing
    # share of torque rms from which an effect shifts what reads the model's torque
    large_torque_share: float = 0.05

    # What is said of a name, of held-out logs, of the rest.
    # of what the logs hold of a body: less is left of it beside another
    absorbed_share: float = 0.3
    # of a body: what logs should tell from a change of another
    body_change_share: float = 0.2
    # two stretches are a repeat if q differs by less than this share
    repeat_share: float = 0.02
    noise_chance: float = 1e-3  # under which a difference is no chance
    # of the information in one direction that is taken for noise at most
    max_noise_information: float = 0.9
    confirmed_gain: float = 0.01  # gain above which a name counts as confirmed
    # share of moving rows under which a joint counts as standing
    standing_row_share: float = 0.02
    # times the error of the fit logs: the held-out motion is another
    held_out_error_ratio: float = 4.0
    held_out_error_share: float = 0.03  # of torque, where it counts
    # standard errors of a gain that only spares parameters
    spared_deviations: float = 2.0
    # the same beyond four: of all links one is always the worst
    link_zero_chance: float = 6.3e-5
    link_deviations: float = 4.0  # deviations, as of a name
    impossible_deviations: float = 5.0  # standard deviations from what a body can be
    # times: an error that casts doubt on finding nothing
    refit_error_ratio: float = 1.3
    # of the power that the joint moves: friction that may be zero
    min_driving_power: float = 0.02
    min_shown_share: float = 0.7  # of an effect: what held-out motion must show of it
    max_shown_share: float = 1.4  # of it: what that may show at most
    # of a joint's torque: what held-out motion can say nothing of
    silent_torque_share: float = 1e-3
    # times the smallest size: where a name should be sure
    confusable_size_factor: float = 3.0
    determined_share: float = 0.5  # of the standard deviation before the logs
    # of the torque of a joint: less of an effect is not worth a picture
    plotted_torque_share: float = 0.005
    # of the joint's torque rms: what gears and drives have anyway
    usual_torque_share: float = 0.03
    usual_joint_share: float = 0.5  # of the joints that must have it
    usual_min_joints: int = 3  # joints at least
    # of a level: what must yield of it to be said first; one contact makes both alike
    rides_share: float = 0.5
    background_share: float = 0.1  # of the largest torque of a finding
    min_value_change: float = 0.05  # of a value: less is no news
    value_change_chance: float = 0.01  # of one false word in a whole table
    curve_chance: float = 0.05  # of a curve among surrogates
    # share of the leftover under which a curve is not worth telling
    min_curve_share: float = 0.1
    max_curves: int = 3  # per joint
    # turns by which a line must miss a whole number of them in a period
    off_harmonic_turns: float = 0.1

    @property
    def named_nats(self) -> float:
        """Evidence from which a name is sure enough to be named [nats]."""
        odds = self.sure_probability / (1 - self.sure_probability)
        return float(self.even_nats * odds ** (1 / self.odds_slope))


THRESHOLDS = EvidenceThresholds()
