"""All thresholds of a diagnosis, in one record.

docs/method.md explains the first of them. Numerical tolerances, and grids of scales and
sizes, are defined where they are used.
"""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class EvidenceThresholds:
    """Thresholds for naming effects, and for reports on them and on the residual."""

    # Decisions on a name, its probability or a flag.
    block_seconds: float = 2.0  # length from which errors of two blocks are independent
    min_blocks: int = 8  # least number of blocks
    max_blocks: int = 48  # largest number of blocks
    min_block_rows: int = 10  # least number of moving rows of a joint in a block
    prior_blocks: float = 15.0  # weight of independent noise, in blocks

    # prior size of an effect's torque, as a share of torque rms
    prior_torque_share: float = 0.3
    noise_floor: float = 0.003  # of torque rms: least noise of any log
    min_rows: float = 5.0  # least weight of a joint
    # times the largest logged torque, if no limit is given
    unknown_limit_factor: float = 2.0
    # of the torque noise: less torque from noise of the angles is ignored
    shaken_share: float = 0.1
    # scale: a rougher nominal model does not allow naming a payload; of the first
    # fit, which only feeds model-based features
    rough_scale: float = 0.1

    # chance of one false name in a whole diagnosis
    false_chance: float = 0.001
    min_share: float = 0.02  # of a joint's left-out error or torque: large enough for a name
    left_out_slack: float = 2.0  # allowed loss of left-out blocks, nats
    curve_knots: int = 10  # of a free curve
    # of the part explained by a curve of its joint: least share of a name alone
    explained_share: float = 0.75
    paired_deviations: float = 2.0  # of a significant paired difference
    ripple_order_ratio: float = 1.5  # ratio of orders from which two ripples are distinct

    same_share: float = 0.05  # of the left-out error: scales that predict as well
    # nats within which an alternative is not separated from the name
    class_nats: float = 6.0
    even_nats: float = 12.0  # evidence at which a name is as likely as not
    clean_even_nats: float = 8.0  # the same if only noise is left
    odds_slope: float = 5.4  # of the log odds of a name over ln(nats)
    sure_probability: float = 0.9  # from which a name is in the model
    min_probability: float = 0.5  # probability below which a name is not the likeliest

    # structured residual, as a share of torque rms, that is flagged
    flag_share: float = 0.05
    doubt_share: float = 0.015  # significant share of torque rms
    # significant multiple of the noise: complete models leave up to 1.15 times, a visible
    # dead zone of a sensor 2.7 and more
    doubt_noises: float = 2.0
    min_fall: float = 0.005  # least fall of a joint's error, as a share of torque rms

    # Shared part of two epochs, and differences between logs without a change.
    min_epoch_rows: float = 60  # least rows of a joint in each epoch for a comparison
    # of torque rms: allowed difference of a joint's column from the fit of all joints
    shared_share: float = 0.03
    friction_spread: float = 0.01  # of its friction: least spread of a joint
    warmth: float = 0.3  # of all friction: prior of warmth
    warmth_spread: float = 0.45  # of the warmth of all joints: spread of a single one
    ramp_share: float = 0.02  # of its friction, from the middle of a log to its end
    one_way_share: float = 0.1  # of the change of friction: asymmetry of directions
    gain_share: float = 0.05  # of a large change: share that a drive may misreport
    load_precision: float = 0.1  # times a typical load: an added one
    usual_joints: float = 2.0  # weight of the typical spread of friction, in joints or logs
    few_logs: int = 3  # least number of logs for estimating their differences
    few_logs_factor: float = 1.2  # least spread with fewer logs
    kept_ratios: float = 0.9  # quantile of the differences of logs, so that no single one decides
    changed_share: float = 0.025  # of torque rms: a change without a name
    usual_log_spread: float = 0.3  # of logs, in ln(squared error)
    usual_logs: float = 3.0  # weight of this, in logs
    drift_deviations: float = 3.0  # of significant warmth
    moved_share: float = 0.3  # of the warmth of all joints: a joint that changed with them
    unlike_refit_ratio: float = 2.0  # times a refit's error: a change not explained
    long_epoch: float = 300.0  # s above which only a part of an epoch is used
    kept_epoch: float = 280.0  # s, length of that part

    # Extent of the search.
    max_effects: int = 30  # largest number of effects to add
    max_exact_looks: int = 15  # candidates that are evaluated exactly per step
    min_quick_nats: float = 2.0  # evidence by screening below which a candidate is dropped
    # of the largest evidence by screening: weaker candidates are not evaluated exactly
    faint_share: float = 0.3
    hopeless_share: float = 0.3  # of the left-out error: limit for trying finer scales
    class_looks: int = 8  # candidates that may replace a name
    width_rounds: int = 3  # rounds over the widths of single kinds
    refit_rounds: int = 4  # iterations on the findings, before the second search
    steady_nats: float = 0.1  # change in nats at which these iterations end
    # share of torque rms from which an effect shifts columns of the model's torque
    large_torque_share: float = 0.05

    # Reports on a name, on held-out logs, on the residual.
    # of the information on a body: less remains next to another
    absorbed_share: float = 0.3
    # of a body: change that logs should separate from that of another
    body_change_share: float = 0.2
    # two stretches are a repeat if q differs by less than this share
    repeat_share: float = 0.02
    noise_chance: float = 1e-3  # significance level of a difference
    # of the information in one direction: largest part attributed to noise
    max_noise_information: float = 0.9
    confirmed_gain: float = 0.01  # gain above which a name counts as confirmed
    # share of moving rows below which a joint counts as standing
    standing_row_share: float = 0.02
    # times the error of the fit logs: the held-out motion is different
    held_out_error_ratio: float = 4.0
    held_out_error_share: float = 0.03  # of torque, for it to matter
    # standard errors of a gain by more plausible parameters only
    spared_deviations: float = 2.0
    # the same above four, corrected for the number of links
    link_zero_chance: float = 6.3e-5
    link_deviations: float = 4.0  # standard deviations, as for a name
    impossible_deviations: float = 5.0  # standard deviations from a possible body
    # ratio of errors that makes the verdict "none" doubtful
    refit_error_ratio: float = 1.3
    # of the power of the joint: friction that may be zero
    min_driving_power: float = 0.02
    min_shown_share: float = 0.7  # of an effect: least part that held-out motion must confirm
    max_shown_share: float = 1.4  # of it: largest part allowed
    # of a joint's torque: too small for held-out motion
    silent_torque_share: float = 1e-3
    # times the smallest size: a name should be certain
    confusable_size_factor: float = 3.0
    determined_share: float = 0.5  # of the standard deviation before the logs
    # of the torque of a joint: smaller effects get no figure
    plotted_torque_share: float = 0.005
    # of the joint's torque rms: typical of gears and drives
    usual_torque_share: float = 0.03
    usual_joint_share: float = 0.5  # share of the joints that must have it
    usual_min_joints: int = 3  # least number of joints
    # of a level: yielding part that is listed first; one contact has both alike
    rides_share: float = 0.5
    background_share: float = 0.1  # of the largest torque of a finding
    min_value_change: float = 0.05  # of a value: smaller changes are not reported
    value_change_chance: float = 0.01  # chance of one false entry in a table
    curve_chance: float = 0.05  # of a curve among surrogates
    # share of the residual below which a curve is not reported
    min_curve_share: float = 0.1
    max_curves: int = 3  # per joint
    # turns per period by which a line must differ from a harmonic
    off_harmonic_turns: float = 0.1

    @property
    def named_nats(self) -> float:
        """Evidence from which an effect is certain enough to be named [nats]."""
        odds = self.sure_probability / (1 - self.sure_probability)
        return float(self.even_nats * odds ** (1 / self.odds_slope))


THRESHOLDS = EvidenceThresholds()
