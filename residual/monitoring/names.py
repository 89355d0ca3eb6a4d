"""From scores over their limits to alarms with a channel and the name of a fault.

A fault shows in several scores: an encoder that jumps moves the arm, which takes
torque on its neighbours too. The first to cross opens the alarm. Its name is that of
the surest kind that crosses within the next moment: a frozen number, then a jump, then
spikes; else the matched feature that explains most of what is left of the torque.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residual.monitoring.rules import MONITOR
from residual.monitoring.scores import Channel, Scale, Scores, blamed
from residual.recording import Array

_MATCHED = ("model", "cycle")
_SURE = ("frozen", "still", "jump", "spikes")


@dataclass(frozen=True, slots=True)
class Alarm:
    """One alarm.

    Attributes:
        time: When it was raised, on the clock of the log [s].
        joint: Joint from 1.
        sensor: "encoder" or "torque".
        fault: frozen, jump, spikes, torque bias, gain drop, bias (of an encoder), or
            deviation, where errors are large and no name fits.
        kind: Score that named it.
        score: That score over its limit, above 1.
        until: When the last score fell below its limit [s].
    """

    time: float
    joint: int
    sensor: str
    fault: str
    kind: str
    score: float
    until: float


@dataclass(frozen=True, slots=True)
class _Crossing:
    time: float
    kind: str
    ratio: float
    value: float
    channel: Channel


def events(
    scores: Sequence[Scores],
    limits: Mapping[str, Array],
    errors: tuple[Array, Scale, int],
) -> tuple[Alarm, ...]:
    """Join crossings to alarms, and name them.

    Args:
        limits: Limit of each column, by kind; a kind without is not watched.
        errors: The block of errors, what is usual of it, and the number of joints.
    """
    known = {s.kind: s for s in scores if s.kind in limits}
    crossings = [c for s in known.values() for c in _crossings(s, limits[s.kind])]
    crossings.sort(key=lambda c: c.time)
    out: list[Alarm] = []
    while crossings:
        group = _one(crossings)
        crossings = crossings[len(group) :]
        best = _best(group)
        channel = _channel(best, known[best.kind], group[0].time, errors)
        told = (channel.joint, channel.sensor, channel.fault)
        out.append(Alarm(group[0].time, *told, best.kind, best.ratio, group[-1].time))
    return tuple(out)


def _crossings(scores: Scores, limits: Array) -> list[_Crossing]:
    ratio = scores.values / limits
    rows, columns = np.nonzero(ratio > 1.0)
    return [
        _Crossing(
            float(scores.t[i]),
            scores.kind,
            float(ratio[i, c]),
            float(scores.values[i, c]),
            scores.channels[c],
        )
        for i, c in zip(rows, columns, strict=True)
    ]


def _one(crossings: Sequence[_Crossing]) -> list[_Crossing]:
    """Take the crossings of one alarm from the front."""
    group, start = [crossings[0]], crossings[0].time
    sure = crossings[0].kind in _SURE
    for crossing in crossings[1:]:
        if crossing.time - group[-1].time > MONITOR.quiet:
            break
        if crossing.kind in _SURE:
            # While a vague alarm lasts, a sure one is news.
            if not sure and crossing.time > start + MONITOR.together:
                break
            sure = True
        group.append(crossing)
    return group


def _explains(crossing: _Crossing) -> float:
    """Return how much a feature explains; all are in the same unit, that of noise.

    An encoder turns the torques of several joints. Where it does no better than one
    torque sensor alone, it only looks like that sensor.
    """
    return crossing.value / (
        MONITOR.complex if crossing.channel.sensor == "encoder" else 1.0
    )


def _best(group: Sequence[_Crossing]) -> _Crossing:
    """Return the crossing that names an alarm."""
    start = group[0].time
    soon = [c for c in group if c.time <= start + MONITOR.together]
    later = [c for c in group if c.time <= start + MONITOR.later and c.kind in _MATCHED]
    sure = [c for kind in _SURE for c in soon if c.kind == kind]
    if sure:
        return max((c for c in sure if c.kind == sure[0].kind), key=lambda c: c.ratio)
    return max(later or group[:1], key=_explains)


def _channel(
    best: _Crossing, scores: Scores, start: float, errors: tuple[Array, Scale, int]
) -> Channel:
    """Return what an alarm points to.

    Of the features of one sensor that explains most, whether it is over its limit or
    not: limits differ, and a bias and a gain are alike for a moment. They are compared
    on windows that lie after the alarm: half a window of either looks like neither.
    """
    if best.channel.joint == 0:
        block, scale, dof = errors
        row = int(np.searchsorted(scores.t, best.time))
        return Channel(*blamed(block[row], scale, dof), "deviation")
    if best.kind not in _MATCHED:
        return best.channel
    rows = (scores.t >= start + MONITOR.windows[0]) & (
        scores.t <= start + MONITOR.later
    )
    place = (best.channel.joint, best.channel.sensor)
    short = scores.channels[: len(scores.channels) // len(MONITOR.windows)]
    same = [i for i, c in enumerate(short) if (c.joint, c.sensor) == place]
    if not rows.any():
        return best.channel
    explained = np.square(scores.values[rows][:, same]).sum(axis=0)
    return short[same[int(explained.argmax())]]
