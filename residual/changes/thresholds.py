"""Thresholds of the comparison of two epochs, in one place (docs/changes.md)."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class ChangeThresholds:
    """What decides whether something changed."""

    min_nats: float = 3.0  # evidence that a change must win [nats]
    # Least torque of a named change, as a share of the joint's torque rms.
    min_torque_share: float = 0.01
    # The same of a change beside a larger one, as a share of that: no large change is
    # modelled better.
    min_share_of_largest: float = 0.06
    tie_nats: float = 2.0  # between names that are so close the simpler is taken [nats]
    # The same as a share of the evidence: no column is quite what an arm does.
    crude_share: float = 0.05
    # What it costs to say that a link has changed its weight, where a load at the
    # flange would do [nats].
    nats_per_link: float = 3.0
    # Torque of a change from which on it shifts what depends on the torque that a gear
    # carries, as a share of the joint's torque rms.
    large_torque_share: float = 0.04
    # What is within so much of the best is not told from it [nats].
    equivalent_nats: float = 6.0
    max_changes: int = 4  # most changes to name
    # Times the error of a joint after a refit of the second epoch, beyond which what
    # is named does not explain the change. True loads on other days' friction leave
    # 1.3 to 1.8 times, a body on the wrong link six to twelve.
    max_error_ratio: float = 2.0
    # Length of the blocks that errors are taken to be independent between [s].
    block_seconds: float = 2.0
    parts: int = 3  # parts that an epoch of fewer than three logs is cut into
    # Least factor by which single logs are taken to differ, where an epoch has fewer
    # than three logs, as a factor on standard deviations.
    few_logs_factor: float = 1.2
    logs_factor: float = 1.0  # the same where it has three or more
    unknown_nats: float = (
        6.0  # evidence that a free curve of the change must win [nats]
    )
    # Least torque of it, as a share of the joint's torque rms.
    unknown_torque_share: float = 0.025
    # What friction of a joint may differ by from log to log where nothing is known of
    # it, as a share.
    friction_spread: float = 0.01
    # Torque that each column of what any arm has may differ by between its joint fit
    # and any one joint, as a share of torque rms.
    nuisance_torque_share: float = 0.03
    # By what part of the warmth of all joints one may differ from it.
    warmth_spread_share: float = 0.45
    # What it may differ by from the middle of a log to its end, as a share.
    ramp_share: float = 0.02
    asymmetry_share: float = (
        0.1  # what of friction may be more one way than the other, as a share
    )
    # By what the drive of a joint may misreport a large change, as a share.
    gain_share: float = 0.05
    # Rows that are taken to be as good as one, where nothing is known.
    rows_per_independent: float = 6.0
    max_joined: int = 8  # most effects of its own that a joint may have in both epochs
    joined_nats: float = 10.0  # evidence that each of them must win [nats]
    # Length of an epoch from which on a part of it is looked at [s].
    long_seconds: float = 300.0
    kept_seconds: float = 280.0  # how much of it, evenly spread [s]
