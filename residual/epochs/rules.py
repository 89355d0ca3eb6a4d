"""Thresholds of the comparison of two epochs, in one place (docs/used_arms.md)."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Rules:
    """What decides whether something changed.

    Attributes:
        threshold: Evidence that a change must win [nats].
        share: Least torque of a named change, as a share of the joint's torque rms.
        beside: The same of a change beside a larger one, as a share of that: no large
            change is modelled better.
        tie: Between names that are so close the simpler is taken [nats].
        crude: The same as a share of the evidence: no column is quite what an arm does.
        link: What it costs to say that a link has changed its weight, where a load at
            the flange would do [nats].
        large: Torque of a change from which on it shifts what depends on the torque
            that a gear carries, as a share of the joint's torque rms.
        equivalent: What is within so much of the best is not told from it [nats].
        most: Most changes to name.
        block: Length of the blocks that errors are taken to be independent between [s].
        parts: Parts that an epoch of fewer than three logs is cut into.
        floor: Least factor by which single logs are taken to differ, where an epoch
            has fewer than three logs, as a factor on standard deviations.
        restless: The same where it has three or more.
        unknown: Evidence that a free curve of the change must win [nats].
        unknown_share: Least torque of it, as a share of the joint's torque rms.
        warmth: What friction of a joint may differ by from log to log where nothing
            is known of it, as a share.
        give: Torque that each column of what any arm has may differ by between its
            joint fit and any one joint, as a share of torque rms.
        uneven: By what part of the warmth of all joints one may differ from it.
        ramp: What it may differ by from the middle of a log to its end, as a share.
        lean: What of friction may be more one way than the other, as a share.
        gain: By what the drive of a joint may misreport a large change, as a share.
        slow: Rows that are taken to be as good as one, where nothing is known.
        joined: Most effects of its own that a joint may have in both epochs.
        worth: Evidence that each of them must win [nats].
        most_seconds: Length of an epoch from which on a part of it is looked at [s].
        seconds: How much of it, evenly spread [s].
    """

    threshold: float = 3.0
    share: float = 0.01
    beside: float = 0.06
    tie: float = 2.0
    crude: float = 0.05
    link: float = 3.0
    large: float = 0.04
    equivalent: float = 6.0
    most: int = 4
    block: float = 2.0
    parts: int = 3
    floor: float = 1.2
    restless: float = 1.0
    unknown: float = 6.0
    unknown_share: float = 0.025
    warmth: float = 0.01
    give: float = 0.03
    uneven: float = 0.45
    ramp: float = 0.02
    lean: float = 0.1
    gain: float = 0.05
    slow: float = 6.0
    joined: int = 8
    worth: float = 10.0
    most_seconds: float = 300.0
    seconds: float = 280.0
