"""What chance alone brings about: the record of a calibrated null, and its use.

Recordings in which nothing is missing are made and searched (`residual.method.nulls`).
How large their evidence gets says what evidence is worth on this robot, with such logs
and such noise; where one of them is named something, that is a false alarm.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from residual.effects import registry
from residual.errors import InputError, listed
from residual.evidence.priors import TINY
from residual.evidence.rules import RULES
from residual.model.nominal import Logs, Nominal


@dataclass(frozen=True, slots=True)
class Key:
    """What a null was made for."""

    robot: str  # hash of the robot's content
    declared: tuple[str, ...]  # effects that the model has, in alphabetical order
    candidates: tuple[str, ...]  # effects that were looked for
    clock: bool  # whether the order of the logs in time is known
    cutoff: float  # identification cut-off [Hz]
    duration: float  # length of all fit logs together [s]
    # Torque noise of each joint, measured above the filter [N m].
    noise: tuple[float, ...]
    speed: tuple[float, ...]  # 95 % quantile of speed of each joint [rad/s]
    moving: tuple[float, ...]  # share of the rows that count, of each joint

    def mismatch(self, other: "Key") -> str | None:
        """Return why a null of this key does not hold for other logs, or None."""
        exact = {
            "robot": "another robot, or another description of it",
            "declared": "other declared effects",
            "candidates": "another vocabulary of effects",
            "clock": "logs whose order in time is known, or these are such",
        }
        for name, words in exact.items():
            if getattr(self, name) != getattr(other, name):
                return words
        factors = {
            "cutoff": (RULES.like_cutoff, "another cut-off of the filter"),
            "duration": (RULES.like, "another duration of the logs"),
            "noise": (RULES.like, "another level of torque noise"),
            "speed": (RULES.like, "other speeds"),
        }
        for name, (factor, words) in factors.items():
            mine, theirs = (np.atleast_1d(getattr(k, name)) for k in (self, other))
            if np.any(np.abs(np.log(mine / theirs)) > np.log(factor) + 1e-9):
                return f"{words} ({listed(mine, '.3g')}, here {listed(theirs, '.3g')})"
        apart = np.abs(np.subtract(self.moving, other.moving))
        if np.any(apart > RULES.like_share):
            return f"other motion: joint {int(apart.argmax()) + 1} moves more or less"
        return None


def key_of(logs: Logs, nominal: Nominal) -> Key:
    """What a null that is made of these logs holds for."""
    tracks, span = logs.tracks, logs.span
    rms = np.sqrt(np.mean(np.concatenate([t.tau for t in tracks]) ** 2, axis=0))
    noise = np.sqrt(np.mean([t.torque_noise**2 for t in tracks], axis=0))
    moving = np.concatenate([t.moving for t in tracks]).mean(axis=0)
    noise = np.maximum(noise, np.maximum(RULES.noise_floor * rms, TINY))
    return Key(
        robot=logs.robot.content_hash,
        declared=tuple(sorted(nominal.names)),
        candidates=tuple(registry()),
        clock=logs.clock is not None,
        cutoff=_short(span.cutoff),
        duration=_short(sum(float(t.t[-1] - t.t[0]) for t in tracks)),
        noise=tuple(map(_short, noise)),
        speed=tuple(map(_short, np.maximum(span.speed, 1e-3))),
        moving=tuple(map(_short, moving)),
    )


def _short(value: float) -> float:
    """Three digits: a key is read by people too."""
    return float(f"{value:.3g}")


@dataclass(frozen=True, eq=False)
class Null:
    """A calibrated null."""

    id: str  # id of its record, or name of its file
    key: Key  # what it was made for
    nats: tuple[float, ...]  # per draw, the largest evidence of any candidate [nats]
    net: tuple[float, ...]  # the same less the price of the choice [nats]
    # Per draw, whether the whole search and gate named something.
    named: tuple[bool, ...]
    block: tuple[int, ...]  # per draw, which recording of encoder noise it shares
    seed: int  # seed of the draws
    scale: float | None  # relative scale by which the nominal model was redrawn
    # Version of the method that searched the draws; "" where the record does not say.
    method: str = ""

    def p_value(self, nats: float) -> float:
        """Chance of as much evidence where nothing is missing.

        (1 + draws with as much) / (1 + draws)        (Davison & Hinkley 1997, eq. 4.11)
        """
        return float((1 + np.sum(np.array(self.nats) >= nats)) / (1 + len(self.nats)))

    @cached_property
    def loud(self) -> float:
        """Evidence, price paid, that 95 % of the draws stay below [nats]."""
        return float(np.quantile(self.net, RULES.null_quantile))

    def threshold(self, least: float) -> float:
        """The evidence that a name needs: the rule's, or more where chance has it."""
        return max(least, self.loud)

    def alarms(self, threshold: float) -> int:
        """Draws in which something was named with at least that evidence."""
        return int(np.sum(np.array(self.named) & (np.array(self.net) >= threshold)))

    def beyond(self, net: float) -> float:
        """Chance of more evidence than that, by an exponential tail.

        Fitted to the excess of the largest fifth of the draws, for what lies beyond
        the largest: an extrapolation.
        """
        values = np.array(self.net)
        start = np.quantile(values, 1 - RULES.null_tail)
        if net <= start:
            return float(np.mean(values >= net))
        above = values[values > start] - start
        mean = max(float(above.mean()), 1e-9) if len(above) else 1e-9
        return float(RULES.null_tail * np.exp(-(net - start) / mean))

    @property
    def independent(self) -> float:
        """As how many independent draws these count.

        Draws of one block share their encoder noise and resemble one another by the
        intra-class correlation r of their evidence: n / (1 + (m - 1) r) for m a block.
        """
        ranks = np.argsort(np.argsort(self.net)).astype(float)
        groups = [ranks[np.array(self.block) == b] for b in sorted(set(self.block))]
        size, count = len(ranks) / len(groups), len(groups)
        if size <= 1 or count < 2:
            return float(len(ranks))
        between = sum(len(g) * (g.mean() - ranks.mean()) ** 2 for g in groups)
        within = sum(((g - g.mean()) ** 2).sum() for g in groups)
        between, within = between / (count - 1), within / max(len(ranks) - count, 1)
        alike = (between - within) / max(between + (size - 1) * within, 1e-300)
        return float(len(ranks) / (1 + (size - 1) * np.clip(alike, 0, 1)))

    def rate(self, threshold: float) -> tuple[float, float, float]:
        """False-alarm rate at a threshold with its 95 % interval (Wilson 1927)."""
        n, p = self.independent, self.alarms(threshold) / len(self.net)
        z = 1.96
        middle, whole = p + z * z / (2 * n), 1 + z * z / n
        half = z * np.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        low, high = max(0.0, middle - half) / whole, min(1.0, (middle + half) / whole)
        return p, float(low), float(high)

    def sentence(self, least: float) -> str:
        """Which null was used, and the false-alarm rate that it states."""
        threshold = self.threshold(least)
        p, low, high = self.rate(threshold)
        return (
            f"null {self.id}: {self.alarms(threshold)} of {len(self.net)} recordings "
            f"with nothing missing were given a name, a false-alarm rate of "
            f"{100 * p:.1f} % (95 %: {100 * low:.1f} to {100 * high:.1f} %); a name "
            f"needs {threshold:.1f} nats, 95 % of them stay below {self.loud:.1f}"
        )


def choose_null(null: Null | Sequence[Null] | None, key: Key) -> Null | None:
    """The null that holds for some logs.

    Raises:
        InputError: If the one that is wanted was made for something else.
    """
    if not isinstance(null, Null):
        return next((n for n in null or () if not n.key.mismatch(key)), None)
    why = null.key.mismatch(key)
    if why:
        raise InputError(
            f"The null {null.id} was calibrated for {why}. Make one for these logs: "
            "modelgap calibrate-null LOG ... --robot R."
        )
    return null


def null_sentences(null: Null | None, least: float) -> tuple[list[str], list[str]]:
    """What a diagnosis says of its null: warnings and notes."""
    if null:
        return [null.sentence(least)], []
    constant = (
        f"the evidence threshold is a constant, {least:g} nats: no null was "
        "calibrated for this robot, plan and noise (modelgap calibrate-null), so no "
        "p-value can be given"
    )
    return [], [constant]


def to_record(null: Null) -> dict:
    """A null as JSON can hold it."""
    key = {f.name: getattr(null.key, f.name) for f in fields(Key)}
    own = ("nats", "net", "named", "block", "seed", "scale", "method")
    return {"key": key, **{name: getattr(null, name) for name in own}}


def from_record(record: Mapping, id: str) -> Null:
    """The way back."""
    try:
        key = {f.name: record["key"][f.name] for f in fields(Key)}
        key = {k: tuple(v) if isinstance(v, list) else v for k, v in key.items()}
        draws = [tuple(record[name]) for name in ("nats", "net", "named", "block")]
        rest = record["seed"], record["scale"], record.get("method", "")
        null = Null(id, Key(**key), *draws, *rest)
    except (KeyError, TypeError) as error:
        raise InputError(
            f"{id} is no null: {error}. Make one with modelgap calibrate-null."
        ) from error
    if not null.net or len({len(d) for d in draws}) > 1:
        raise InputError(f"{id} is no null: its lists differ in length, or are empty.")
    return null
