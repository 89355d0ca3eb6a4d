"""Early warning of sensors that fail: calibrated on good runs, then watching others.

The paper wants it (G2017, abstract) and leaves it open. T2 and SPE of its indicator
space see no fault at all; what sees them are errors: measured minus wanted position,
torque minus that of the model, and their change from one cycle of a program to the
next. ``calibrate`` learns what is usual of them, ``Monitor.watch`` tells what is not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace

import numpy as np

from residual.errors import InputError, shown
from residual.model.model import Model
from residual.monitoring.rows import beyond, rows_of, states_of
from residual.monitoring.rules import MONITOR
from residual.monitoring.scores import Channel, Scale, Scores, blamed, fit, sight_of
from residual.monitoring.usual import all_scores, limits_of, peaks_of, rest_of, usual
from residual.quantity import plain
from residual.recording import Array, Recording
from residual.signals.track import sample_rate

_MATCHED = ("model", "cycle")
_SURE = ("frozen", "still", "jump", "spikes")


# From scores over their limits to alarms with a channel and the name of a fault.
#
# A fault shows in several scores: an encoder that jumps moves the arm, which takes
# torque on its neighbours too. The first to cross opens the alarm. Its name is that of
# the surest kind that crosses within the next moment: a frozen number, then a jump,
# then spikes; else the matched feature that explains most of what is left of the
# torque.


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

    @property
    def explains(self) -> float:
        """How much a feature explains; all are in the same unit, that of noise.

        An encoder turns the torques of several joints. Where it does no better than
        one torque sensor alone, it only looks like that sensor.
        """
        encoder = self.channel.sensor == "encoder"
        return self.value / (MONITOR.complex if encoder else 1.0)


def events(
    scores: Sequence[Scores],
    limits: Mapping[str, Array],
    errors: Array,
    scale: Scale,
) -> tuple[Alarm, ...]:
    """Join crossings to alarms, and name them; a kind without limits is not watched."""
    known = {s.kind: s for s in scores if s.kind in limits}
    crossings = []
    for s in known.values():
        ratio = s.values / limits[s.kind]
        for i, c in zip(*np.nonzero(ratio > 1.0), strict=True):
            size = float(ratio[i, c]), float(s.values[i, c])
            crossings.append(_Crossing(float(s.t[i]), s.kind, *size, s.channels[c]))
    crossings.sort(key=lambda c: c.time)
    out: list[Alarm] = []
    while crossings:
        group = _one(crossings)
        crossings = crossings[len(group) :]
        best = _best(group)
        channel = _channel(best, known[best.kind], group[0].time, errors, scale)
        told = (channel.joint, channel.sensor, channel.fault)
        out.append(Alarm(group[0].time, *told, best.kind, best.ratio, group[-1].time))
    return tuple(out)


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


def _best(group: Sequence[_Crossing]) -> _Crossing:
    """Return the crossing that names an alarm."""
    start = group[0].time
    soon = [c for c in group if c.time <= start + MONITOR.together]
    later = [c for c in group if c.time <= start + MONITOR.later and c.kind in _MATCHED]
    sure = [c for kind in _SURE for c in soon if c.kind == kind]
    if sure:
        return max((c for c in sure if c.kind == sure[0].kind), key=lambda c: c.ratio)
    return max(later or group[:1], key=lambda c: c.explains)


def _channel(
    best: _Crossing, scores: Scores, start: float, errors: Array, scale: Scale
) -> Channel:
    """Return what an alarm points to.

    Of the features of one sensor that explains most, whether it is over its limit or
    not: limits differ, and a bias and a gain are alike for a moment. They are compared
    on windows that lie after the alarm: half a window of either looks like neither.
    """
    if best.channel.joint == 0:
        dof = scale.residual.shape[1]
        row = int(np.searchsorted(scores.t, best.time))
        return Channel(*blamed(errors[row], scale, dof), "deviation")
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


LEAST_RUNS = 3


@dataclass(frozen=True, eq=False, slots=True)
class Monitor:
    """What is usual on a robot in good order, and the limits of that."""

    model: Model  # expects the torque; its coefficients are fitted to the good runs
    theta: Array  # those coefficients, (p,)
    rate: float  # rate of the logs [Hz]
    per_hour: float  # false alarms wanted at most, all kinds together
    hours: float  # length of the good runs [h]
    scale: Scale  # what is usual of errors
    limits: dict[str, Array]  # limit of each score, by kind, (c,)
    # Range of q, qd, qdd in the good runs, (3, dof) each.
    lowest: Array
    highest: Array
    referenced: bool = True  # the wanted position is logged, and looked at

    def watch(self, recording: Recording) -> tuple[Alarm, ...]:
        """Return the alarms of a log, in the order of time.

        Raises:
            InputError: If it is of another robot or rate, or too short.
        """
        scores, errors = self._scores(recording)
        return events(scores, self.limits, errors, self.scale)

    def scores(self, recording: Recording) -> tuple[Scores, ...]:
        """Return all scores of a log, each column over its limit; 1 is an alarm."""
        known = (s for s in self._scores(recording)[0] if s.kind in self.limits)
        return tuple(replace(s, values=s.values / self.limits[s.kind]) for s in known)

    def novelty(self, recording: Recording) -> Array:
        """Return how much of a log is where no good run was: a warning, no fault.

        Returns:
            Share of the rows with position, speed or acceleration of the joint outside
            of what was calibrated. Shape (dof,).
        """
        rows = rows_of(self._matched(recording))
        return beyond(rows, self.lowest, self.highest, MONITOR.outside).mean(axis=0)

    def _scores(self, recording: Recording) -> tuple[list[Scores], Array]:
        recording = self._matched(recording)
        log = sight_of(self.model, recording)
        return all_scores(recording, log, self.theta, self.scale)

    def _matched(self, recording: Recording) -> Recording:
        check_log(recording, self.model, self.rate)
        if not self.referenced:
            return replace(recording, q_ref=None)
        if recording.q_ref is None:
            raise InputError(
                f"{recording.id} has no q_ref, the runs of the calibration have it. "
                "Log the reference, or calibrate on runs without it."
            )
        return recording


def calibrate(
    model: Model, recordings: Sequence[Recording], per_hour: float = 1.0
) -> Monitor:
    """Learn from runs of a robot in good order what is usual, and set limits.

    Each run is scored by what was learnt from the others, so that no limit is set on
    what it was fitted to.

    Args:
        model: Expects the torque; needs its ``speed_floor``.
        recordings: Good runs, such as will be watched later. At least three.
        per_hour: False alarms wanted at most, all kinds together [1/h].

    Raises:
        InputError: If there are fewer than three runs, or one does not fit the others.
    """
    rate = check_runs(model, recordings, per_hour)
    referenced = all(run.q_ref is not None for run in recordings)
    runs = [r if referenced else replace(r, q_ref=None) for r in recordings]
    logs = [sight_of(model, run) for run in runs]
    states = np.concatenate([states_of(log.rows) for log in logs])
    theta = fit(model, logs)
    thetas = [fit(model, logs, without=i) for i in range(len(logs))]
    rests = [rest_of(log, own) for log, own in zip(logs, thetas, strict=True)]
    scores: dict[str, list[Scores]] = {}
    for i, run in enumerate(runs):
        scale = usual(logs, rests, without=i)
        for score in all_scores(run, logs[i], thetas[i], scale)[0]:
            scores.setdefault(score.kind, []).append(peaks_of(score))
    # The false alarms are shared among the kinds of scores.
    limits = {
        kind: MONITOR.wider.get(kind, 1.0) * limits_of(own, per_hour / len(scores))
        for kind, own in scores.items()
    }
    # A reading without noise rests while its joint does, however long that is.
    still = limits["still"]
    limits["still"] = np.where(still > MONITOR.still * rate, np.inf, still)
    return Monitor(
        model=model,
        theta=theta,
        rate=rate,
        per_hour=per_hour,
        hours=sum(run.duration for run in runs) / 3600.0,
        scale=usual(logs, rests),
        limits=limits,
        lowest=states.min(axis=0),
        highest=states.max(axis=0),
        referenced=referenced,
    )


def check_log(recording: Recording, model: Model, rate: float) -> None:
    """Check that a log is of the robot and rate of a monitor."""
    dof = model.robot.dof
    if recording.dof != dof:
        raise InputError(
            f"{recording.id} has {recording.dof} joints, the monitor is for {dof}. "
            "Give a run of the same robot."
        )
    own = sample_rate(recording.t)
    if abs(own - rate) > 0.01 * rate:
        raise InputError(
            f"{recording.id} is logged at {own:g} Hz, the monitor is calibrated at "
            f"{rate:g} Hz. Calibrate it on runs of that rate."
        )


def check_runs(model: Model, runs: Sequence[Recording], per_hour: float) -> float:
    """Check that runs can set limits for a model, and how often these may err [1/h].

    Returns:
        The rate of the runs [Hz].
    """
    if len(runs) < LEAST_RUNS:
        raise InputError(
            f"{len(runs)} runs to calibrate on, expected at least {LEAST_RUNS}: limits "
            "are set on runs that were left out. Give more runs of the good robot."
        )
    if not 0 < per_hour < np.inf:
        raise InputError(f"{per_hour:g} false alarms per hour, expected more than 0.")
    if model.speed_floor is None:
        raise InputError("The model has no speed_floor; make it from logs first.")
    rate = sample_rate(runs[0].t)
    for run in runs:
        check_log(run, model, rate)
    return rate


FORM = 1
_ARRAYS = ("theta", "lowest", "highest")
_PLAIN = ("rate", "per_hour", "hours", "referenced")


def to_record(monitor: Monitor) -> dict:
    """Return a monitor whole, with its model.

    A limit that is never reached is null.
    """
    return {
        "form": FORM,
        "robot": monitor.model.robot.name,
        "model": monitor.model.to_record(),
        **{name: getattr(monitor, name) for name in _PLAIN},
        **{name: getattr(monitor, name).tolist() for name in _ARRAYS},
        "scale": {k: x.tolist() for k, x in asdict(monitor.scale).items()},
        "limits": plain(monitor.limits),
    }


def from_record(record: Mapping) -> Monitor:
    """Return the monitor of a record."""
    if record.get("form") != FORM or "model" not in record:
        raise InputError(
            f"A monitor of form {shown(record.get('form'))}, expected {FORM} with its "
            "model. Calibrate it again."
        )
    scale = Scale(**{f.name: np.array(record["scale"][f.name]) for f in fields(Scale)})
    limits = {k: np.array(limit, dtype=float) for k, limit in record["limits"].items()}
    return Monitor(
        model=Model.from_record(record["model"]),
        scale=scale,
        limits={k: np.where(np.isnan(x), np.inf, x) for k, x in limits.items()},
        **{name: record[name] for name in _PLAIN},
        **{name: np.array(record[name]) for name in _ARRAYS},
    )
