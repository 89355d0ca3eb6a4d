"""The numbers of the one criterion, beside those that it shares with the program."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class BlockRules:
    """What decides a name and its probability by blocks."""

    block_seconds: float = 2.0  # from which errors of two blocks are independent [s]
    min_blocks: int = 8  # blocks at least
    max_blocks: int = 48  # blocks at most
    min_block_rows: int = 10  # moving rows without which a joint has no vote in a block
    prior_blocks: float = 15.0  # blocks that independent noise counts as
    false_chance: float = 0.001  # chance of one false name in a whole diagnosis
    min_share: float = 0.02  # of a joint's left-out error or torque: worth a name
    left_out_slack: float = 2.0  # nats that left-out blocks may lose
    curve_knots: int = 10  # of a free curve
    curve_ratio: float = 1.25  # times its left-out error: what a name may leave
    # of what it explains beside a curve of its joint: what a constant must alone
    constant_share: float = 0.75
    min_quick_nats: float = 2.0  # by a quick look: less gets no other
    clear_deviations: float = 2.0  # of a paired gain that is no chance
    same_deviations: float = 2.0  # of a paired loss: scales that predict as well
    same_share: float = 0.05  # of the left-out error, likewise
    hopeless_share: float = 0.3  # of the left-out error: no sharper scale is tried
    class_share: float = 0.05  # of what a name gains: what a swap-in may lose
    class_looks: int = 8  # candidates that may stand in for a name
    sure_probability: float = 0.9  # from which a name is sure
    even_nats: float = 12.0  # evidence at which a name is as likely as not
    odds_slope: float = 5.4  # of the log odds of a name over ln(nats)


RULES = BlockRules()
