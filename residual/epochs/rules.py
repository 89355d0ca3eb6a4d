"""Thresholds of the comparison of two epochs, in one place (docs/used_arms.md)."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Watching:
    """What a watch goes by.

    Attributes:
        rows: Rows of a bin in which a joint moves.
        windows: Lengths of the windows [bins], ascending.
        uncertain: Most directions of the nuisance that are kept uncertain.
        memory: Time over which the slow of an arm keeps its course [s].
        pause: Longest time that an arm does not cool within [s].
        fresh: Behind a longer pause an arm has cooled: by how much its course differs
            more, as a factor on deviations.
        quick: Least that the slow changes with the motion, as a share of the deviation
            between healthy runs.
        warmth: Least deviation of friction between runs, as a share.
        offset: The same of the constant, as a share of torque rms.
        free: Torque of each nuisance column that healthy runs are to tell, one
            deviation, as a share of torque rms.
        quiet: Bins of motion without a crossing after which an alarm is over.
        patience: Least and most bins that an alarm waits for its name to be sure.
        short: Longest window whose name may change soon [bins]; longer ones wait for
            no least.
        sure: Evidence by which the best name has to lead for that [nats], and as a
            part of its own.
        enough: Part of the evidence of the best window that the shortest needs, which
            says since when.
        as_well: Part of the evidence of the best name that another needs to be told.
    """

    rows: int = 31
    windows: tuple[int, ...] = (2, 4, 10, 20, 40)
    uncertain: int = 12
    memory: float = 100.0
    pause: float = 90.0
    fresh: float = 3.0
    quick: float = 0.1
    warmth: float = 0.02
    offset: float = 0.003
    free: float = 0.1
    quiet: int = 20
    patience: tuple[int, int] = (2, 4)
    short: int = 4
    sure: tuple[float, float] = (10.0, 0.3)
    enough: float = 0.8
    as_well: float = 0.5

    @property
    def longest(self) -> int:
        """Bins of the longest window."""
        return self.windows[-1]


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
        watch: What a watch of a stream goes by, which compares its rows with such an
            epoch.
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
    watch: Watching = Watching()
