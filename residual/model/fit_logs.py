"""Logs made ready to be searched, and the model that features are seen with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.effects.base import Span
from residual.model.nominal import Nominal, build_nominal
from residual.recording import Recording
from residual.robot.robot import Robot
from residual.signals.encoder_noise import shaken
from residual.signals.track import Filters, Track, prepare


@dataclass(frozen=True, eq=False, slots=True)
class Logs:
    """Fit logs, ready: signals, session clock and how far they move the arm.

    ``shaken`` are the same with one more helping of the noise of their angles.
    """

    robot: Robot
    tracks: tuple[Track, ...]
    clock: float | None
    span: Span
    speed_floor: np.ndarray
    filters: Filters
    shaken: tuple[Track, ...]


def prepare_logs(
    robot: Robot,
    recordings: Sequence[Recording],
    clock: float | None,
    filters: Filters,
) -> Logs:
    """Prepare the signals of the fit logs."""
    tracks, floor = prepare(recordings, filters)
    q = np.concatenate([t.q for t in tracks])
    qd = np.concatenate([t.qd for t in tracks])
    tau = np.concatenate([t.tau for t in tracks])
    last = max(t.t[-1] for t in tracks)
    span = Span(
        speed=np.quantile(np.abs(qd), 0.95, axis=0),
        travel=np.ptp(q, axis=0),
        duration=0.0 if clock is None else float(last - clock),
        cutoff=min(t.cutoff for t in tracks),
        torque=np.quantile(np.abs(tau), 0.995, axis=0),
    )
    moved = shaken(recordings, tracks, filters, floor)
    return Logs(robot, tracks, clock, span, floor, filters, moved)


def start_nominal(logs: Logs, names: Sequence[str]) -> Nominal:
    """The user's model, on the clock and thresholds of these logs."""
    nominal = build_nominal(
        logs.robot, names, logs.span, logs.speed_floor, logs.filters
    )
    return replace(nominal, model=replace(nominal.model, clock=logs.clock))
