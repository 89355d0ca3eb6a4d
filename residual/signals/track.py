"""From logged samples to kinematics, filtered torque and the rows that count.

Torque and every regressor column pass the same zero-phase filter (parallel filtering,
Gautier 1997), so that the filter does not bias the dynamics. Rows near a reversal or
inside a dwell are masked: friction at standstill may take any value up to breakaway, so
no function of the motion predicts it. Predictions still need a value, chosen per joint:
the sign of creep, that of the last motion (a bristle that holds), or zero
(`StandstillFriction`).
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from residual.recording import Array, Recording, apply_drive
from residual.signals.filters import filter_low_pass
from residual.signals.splitting import (
    compute_piece_overlap,
    flag_repeated_ids,
    release_mapped_memory,
)


@dataclass(frozen=True, slots=True)
class StandstillFriction:
    """The direction of motion near zero speed."""

    # "smooth": tanh(qd / (size · floor)). "bristle": Dahl's state of that displacement
    # [rad] (Dahl 1968), where 0 is the plain sign of velocity.
    kind: Literal["smooth", "bristle"] = "smooth"
    size: float = 0.25  # number of its kind
    hold: float = 1.0  # share of it that remains at standstill, 0 to 1
    reach: float = 1.0  # speed below which it counts as standstill here, in floors


SMOOTH = StandstillFriction()
CHOICES = (
    SMOOTH,
    StandstillFriction("smooth", 1.0),
    StandstillFriction("smooth", 4.0),
    *(
        StandstillFriction("bristle", d, reach=r)
        for d in (0.0, 3e-5, 1e-4, 3e-4, 1e-3, 1e-2)
        for r in (1.0, 4.0)
    ),
)


def compute_friction_direction(
    q: Array, qd: Array, speed_floor: float, shape: StandstillFriction
) -> Array:
    """Direction of motion of one joint, -1 to 1, with its behaviour at standstill.

    Args:
        speed_floor: Speed under which the joint counts as standing [rad/s].
    """
    if shape.kind == "smooth":
        out = np.tanh(qd / (shape.size * speed_floor))
    elif shape.size == 0.0:
        out = np.sign(qd)
    else:
        out = compute_dahl_state(q, shape.size)
    if shape.hold == 1.0:
        return out
    return np.where(np.abs(qd) < shape.reach * speed_floor, shape.hold, 1.0) * out


def compute_dahl_state(q: Array, displacement: float) -> Array:
    """Dahl's state by its exact solution over each step of position, start at rest.

    Each step is z -> fade z + (1 - fade) goal. Two successive steps combine into one of
    the same form, so log2(n) rounds of a parallel scan give every sample its full past.
    From -1 to 1; it yields over the displacement [rad].
    """
    step = np.diff(q)
    fade = np.exp(-np.abs(step) / displacement)
    state = np.where(step > 0, 1.0, -1.0) * (1 - fade)
    reach = 1
    while reach < len(step) and fade.any():
        state[reach:] += fade[reach:] * state[:-reach]
        fade[reach:] *= fade[:-reach]
        fade[:reach] = 0.0  # at rest before
        reach *= 2
    return np.concatenate([np.zeros(min(len(q), 1)), np.clip(state, -1, 1)])


def compute_friction_directions(
    q: Array, qd: Array, speed_floors: Array, shapes: tuple[StandstillFriction, ...]
) -> Array:
    """Direction of motion of every joint. Shapes (n, dof), (dof,), one per joint."""
    pairs = zip(q.T, qd.T, speed_floors, shapes, strict=True)
    return np.column_stack([compute_friction_direction(*p) for p in pairs])


# Edge and margin (`FilterSettings`) of a torque computed from a drive's chain: errors of
# the chain exceed those of friction near standstill.
DRIVEN_EDGE, DRIVEN_MARGIN = 0.2, 0.2
ROWS = 4.2  # rows per period of the cut-off: some 33 a second at 8 Hz
SEED = 0  # seed of the redrawn noise: a diagnosis is reproducible


@dataclass(frozen=True, slots=True)
class FilterSettings:
    """Cut-offs and margins of the signal path."""

    kinematics: float = 12.0  # Low-pass on positions [Hz]
    # Low-pass on torque and regressor, the identification filter [Hz].
    torque: float = 8.0
    rate: float = 110.0  # rate at which features are built [Hz]
    edge: float = 0.5  # time dropped at both ends of a log [s]
    # Mask half-width around standstill, in periods of the torque filter.
    margin: float = 0.8
    # Standstill threshold, as a share of the 95 % quantile of speed.
    speed: float = 0.02

    def cutoff(self, rate: float) -> float:
        """Identification cut-off for a log of this rate [Hz]."""
        return min(self.torque, 0.08 * rate)


@dataclass(frozen=True, eq=False, slots=True)
class Track:
    """One log on a uniform grid, prepared for features."""

    id: str  # label of the recording
    rate: float  # sample rate of the kinematics [Hz]
    t: Array  # times on the log's own clock [s], (n,)
    # Filtered kinematics [rad, rad/s, rad/s^2], (n, dof).
    q: Array
    qd: Array
    qdd: Array
    cutoff: float  # Cut-off of the identification filter [Hz]
    step: int  # decimation from features to rows
    tau: Array  # filtered torque of each row [N m], (m, dof)
    # Row is outside of edges and gaps, and no joint is masked. Shape (m,), bool.
    valid: Array
    moving: Array  # row is used for that joint. Shape (m, dof), bool
    torque_noise: Array  # White-noise level of torque after the filter [N m], (dof,)
    enabled: Array | None = None  # share of a drive that is on, (n, dof); None for on
    entire: bool = True  # it is not a piece of a longer log

    @property
    def seconds(self) -> float:
        """How long it is [s]."""
        return len(self.t) / self.rate

    def filter(self, columns: Array) -> Array:
        """Pass feature columns through the identification filter and decimate.

        From the feature rate to the rows. Shape (n, ...) to (m, ...).
        """
        return filter_low_pass(columns, self.cutoff, self.rate, self.step)


@dataclass(frozen=True, eq=False, slots=True)
class _Uniform:
    """A recording resampled on its median rate."""

    rate: float
    t: Array
    q: Array
    tau: Array
    gap: Array
    masked: Array  # joint's torque is unknown there, (n, dof) or (n, 1), bool
    enabled: Array | None  # share of a drive that is on, (n, dof)
    driven: bool  # torque is computed from a drive's chain


def estimate_sample_rate(t: Array) -> float:
    """Median sample rate, rounded to a whole number within 10 % [Hz]."""
    rate = 1 / float(np.median(np.diff(t)))
    nearest = round(rate)
    return float(nearest) if nearest and abs(rate - nearest) < 0.1 else rate


def build_tracks(
    recordings: Sequence[Recording],
    filters: FilterSettings,
    speed_floor: Array | None = None,
    full_rate: bool = False,
) -> tuple[tuple[Track, ...], Array]:
    """Filter, differentiate and mask several logs with common speed thresholds.

    Args:
        speed_floor: Standstill thresholds of other logs [rad/s]. Shape (dof,); None to
            compute them from these logs.

    Returns:
        One track per log, and the standstill thresholds [rad/s]. Shape (dof,).
    """
    pieces = flag_repeated_ids([r.id for r in recordings])
    signals = _signals(recordings, filters, full_rate, again=any(pieces))
    if speed_floor is None:
        # 2 % of a joint's typical speed, or its noise: that of the encoder in the stop band,
        # propagated through the kinematic filter and the derivative.
        speeds, noise = [], 0.0
        for u, (q, qd, _) in signals():
            speeds.append(qd)
            cutoff = min(filters.kinematics, 0.12 * u.rate)
            step = -(-len(u.q) // len(q))
            density = np.std(u.q[::step] - q, axis=0) * np.sqrt(cutoff / (u.rate / 2))
            noise = np.maximum(noise, 2 * np.pi * cutoff / np.sqrt(3) * density)
        speed = np.quantile(np.abs(np.concatenate(speeds)), 0.95, axis=0)
        speed_floor = np.maximum.reduce(
            [filters.speed * speed, 3 * noise, np.full_like(speed, 1e-3)]
        )
    tracks = tuple(
        _track(r.id, u, m, filters, speed_floor, full_rate, piece)
        for r, piece, (u, m) in zip(recordings, pieces, signals(), strict=True)
    )
    return tracks, speed_floor


def _signals(
    recordings: Sequence[Recording], filters: FilterSettings, full_rate: bool, again: bool
) -> Callable[[], Iterable]:
    """Return a function that yields each log resampled, with its kinematics.

    Args:
        again: Recompute them each time: two passes over pieces of a long log take less
            memory than all of it.
    """

    def resampled() -> Iterable:
        for recording in recordings:
            uniform = _resample(recording)
            step = 1 if full_rate else _thinning(uniform.rate, filters)
            yield uniform, _kinematics(uniform, filters, step)
            if again:
                release_mapped_memory(recording)

    if again:
        return resampled
    once = list(resampled())
    return lambda: once


def filter_motion(
    recording: Recording, filters: FilterSettings, step: int = 1
) -> tuple[Array, Array, tuple[Array, Array, Array]]:
    """Return times, angles and filtered kinematics of a log, evenly spaced.

    Returns:
        Shapes (n,), (n, dof), and (n, dof) each of q, qd and qdd.
    """
    uniform = _resample(recording)
    motion = _kinematics(uniform, filters, step)
    return uniform.t[::step], uniform.q[::step], motion


def resample_recording(recording: Recording, filters: FilterSettings) -> Recording:
    """Return a log at the rate of its features.

    An anti-aliasing filter far above the cut-offs is applied; gaps are kept. It has only
    times, angles and torques.
    """
    uniform = _resample(recording)
    first = _thinning(uniform.rate, filters)
    t, q, tau = recording.t, recording.q, recording.tau
    if first > 1:
        cutoff = 0.4 * uniform.rate / first
        there = ~uniform.gap[::first]
        t = uniform.t[::first][there]
        q = filter_low_pass(uniform.q, cutoff, uniform.rate, first)[there]
        tau = _thinned(uniform, first)[there]
    return Recording(recording.id, recording.robot, t, q, tau)


def _even_times(times: Array) -> tuple[float, Array]:
    """Return the rate [Hz] of some times, and evenly spaced ones."""
    rate = estimate_sample_rate(times)
    t = np.arange(times[0], times[-1] + 0.5 / rate, 1 / rate)
    return rate, t[t <= times[-1] + 1e-9]


def _resample(log: Recording) -> _Uniform:
    rate, t = _even_times(log.t)
    late = (np.diff(log.t) > 6 / rate).astype(float)
    gap = np.interp(t, log.t[1:], late) > 0
    q, tau = (interpolate_signals(t, log.t, x) for x in (log.q, log.tau))
    masked, enabled = np.zeros((len(t), 1), bool), None
    if log.masked is not None:  # everything between two masked samples is masked
        masked = interpolate_signals(t, log.t, log.masked) > 0.5
    if log.enabled is not None:
        enabled = interpolate_signals(t, log.t, log.enabled)
    return _Uniform(rate, t, q, tau, gap, masked, enabled, log.drive is not None)


def interpolate_signals(times: Array, sampled: Array, values: Array) -> Array:
    """Interpolate signals linearly at other times [s]. Shape (m, k)."""
    return np.column_stack([np.interp(times, sampled, column) for column in values.T])


def _kinematics(u: _Uniform, filters: FilterSettings, step: int) -> tuple[Array, Array, Array]:
    """Filtered angles and their derivatives, at every k-th sample."""
    cutoff = min(filters.kinematics, 0.12 * u.rate)
    if step > 1:  # only kept samples are computed
        q, qd, qdd = (filter_low_pass(u.q, cutoff, u.rate, step, order=k) for k in range(3))
        return q, qd, qdd
    q = filter_low_pass(u.q, cutoff, u.rate)
    qd = np.gradient(q, 1 / u.rate, axis=0)
    return q, qd, np.gradient(qd, 1 / u.rate, axis=0)


def _thinning(rate: float, filters: FilterSettings) -> int:
    """Samples of a log per sample of its features."""
    return max(1, round(rate / filters.rate))


def _track(
    label: str,
    u: _Uniform,
    motion: tuple[Array, Array, Array],
    filters: FilterSettings,
    speed_floor: Array,
    full_rate: bool,
    piece: bool,
) -> Track:
    """Prepare a log or a piece of one; rows beyond its part belong to other pieces."""
    first = 1 if full_rate else _thinning(u.rate, filters)
    rate = u.rate / first
    cutoff = filters.cutoff(u.rate)
    step = max(1, round(rate / (ROWS * cutoff)))
    q, qd, qdd = motion
    still = (np.abs(qd) < speed_floor) | u.gap[::first, None]
    still |= np.diff(np.sign(qd), axis=0, prepend=np.sign(qd[:1])) != 0
    edge, margin = filters.edge, filters.margin
    if u.driven:
        edge, margin = DRIVEN_EDGE, DRIVEN_MARGIN
    half = int(np.ceil(margin / cutoff * rate))
    masked = dilate_mask(u.masked, first // 2)[::first]
    still |= masked
    still = dilate_mask(still, half)
    inner = ~dilate_mask(u.gap, (2 * half + 1) * first // 2)[:: first * step]
    edge = max(2, round(edge * rate / step))
    inner[:edge] = inner[-edge:] = False
    if piece:
        over = compute_piece_overlap(cutoff, u.rate)
        at = (np.arange(len(inner)) * step / rate).round(6)
        inner &= (at >= over - 1e-6) & (at < len(u.t) / u.rate - over - 1e-6)
    # Noise after the filter, from the torque above 2.5 cut-offs, assumed to be white.
    nyquist = u.rate / 2
    low = min(2.5 * cutoff, 0.5 * nyquist)
    high = u.tau - filter_low_pass(u.tau, low, u.rate)
    variance = (np.median(np.abs(high), axis=0) / 0.6745) ** 2
    noise = np.sqrt(variance / (1 - low / nyquist) * (cutoff / nyquist))
    return Track(
        id=label,
        rate=rate,
        t=u.t[::first],
        q=q,
        qd=qd,
        qdd=qdd,
        cutoff=cutoff,
        step=step,
        tau=filter_low_pass(_thinned(u, first), cutoff, rate, step),
        valid=inner & ~dilate_mask(masked, half)[::step].any(axis=1),
        moving=~still[::step] & inner[:, None],
        torque_noise=noise,
        enabled=None if u.enabled is None else u.enabled[::first],
        entire=not piece,
    )


def _thinned(u: _Uniform, first: int) -> Array:
    """Torque at the feature rate, so that it passes the same filter as the features.

    An anti-aliasing filter far above the identification cut-off comes first.
    """
    if first == 1:
        return u.tau
    return filter_low_pass(u.tau, 0.4 * u.rate / first, u.rate, first)


def filter_torque(t: Array, tau: Array, masked: Array, track: Track) -> tuple[Array, Array]:
    """Filter another torque of a log like that of its track, with its masked rows.

    Args:
        t: Times of the samples of the track [s]. Shape (n,).
        tau, masked: Torque [N m] and whether it is unknown. Shapes (n, dof).

    Returns:
        Shapes (m, dof).
    """
    rate, grid = _even_times(t)
    off = interpolate_signals(grid, t, masked) > 0.5
    u = _Uniform(rate, grid, tau, interpolate_signals(grid, t, tau), off, off, None, True)
    first = round(u.rate / track.rate)
    half = int(np.ceil(FilterSettings().margin / track.cutoff * track.rate))
    masked = dilate_mask(dilate_mask(u.masked, first // 2)[::first], half)
    tau = filter_low_pass(_thinned(u, first), track.cutoff, track.rate, track.step)
    return tau, np.broadcast_to(masked[:: track.step], tau.shape)


def dilate_mask(mask: Array, half_width: int) -> Array:
    """Dilate a mask by a number of samples on both sides. Shape as given."""
    count = np.cumsum(mask, axis=0)
    count = np.pad(count, [(1, 0)] + [(0, 0)] * (mask.ndim - 1))
    at = np.arange(len(mask))
    last = np.minimum(at + half_width + 1, len(mask))
    return count[last] > count[np.maximum(at - half_width, 0)]


def interpolate_torque(torque: Array, track: Track, recording: Recording) -> Array:
    """Torque on a track's grid, interpolated at the recording's times. Shape (n, dof)."""
    if torque.shape[0] == len(recording.t) and np.allclose(track.t, recording.t):
        return torque
    return interpolate_signals(recording.t, track.t, torque)


def add_angle_noise(
    recordings: Sequence[Recording], tracks: Sequence[Track], filters: FilterSettings
) -> tuple[Track, ...]:
    """Return the logs with redrawn noise added to their angles.

    Args:
        tracks: The prepared logs: their rows, and a measured torque, are kept.
    """
    rng, out = np.random.default_rng(SEED), []
    for r, track in zip(recordings, tracks, strict=True):
        # From frequencies above the filter, assumed to be white; by the median, to ignore jerks
        # of the motion.
        _, angles, (low, _, _) = filter_motion(r, filters)
        rate = estimate_sample_rate(r.t)
        passed_on = min(filters.kinematics, 0.12 * rate) / (rate / 2)
        level = np.median(np.abs(angles - low), axis=0) / 0.6745
        noise = level / np.sqrt(1 - passed_on) * rng.normal(size=r.q.shape)
        thin = round(rate / track.rate)
        _, _, (q, qd, qdd) = filter_motion(replace(r, q=r.q + noise), filters, thin)
        moved = replace(track, q=q, qd=qd, qdd=qdd)
        if r.drive is not None:
            tau = apply_drive(replace(r, q=r.q + noise), r.drive).tau - r.tau
            tau, _ = filter_torque(r.t, tau, np.zeros(tau.shape, bool), track)
            moved = replace(moved, tau=track.tau + tau)
        out.append(moved)
    return tuple(out)


def keep_measured_rows(measured: Sequence[Track], shaken: Sequence[Track]) -> tuple[Track, ...]:
    """Replace the measured angles by others, on the same rows."""
    return tuple(
        replace(t, tau=m.tau, valid=m.valid, moving=m.moving)
        for m, t in zip(measured, shaken, strict=True)
    )


STEPS = 5.0  # least rms of a torque, in steps of its sensor
NOISES = 2.0  # the same, in units of its noise after the filter, in motion


def find_unresolved_torques(recordings: Sequence[Recording], tracks: Sequence[Track]) -> Array:
    """Return which joints have only quantization or noise as torque. (dof,), bool.

    A torque of that size has no meaningful error in per cent: a zero prediction is as
    good as any.

    Args:
        recordings: The logs.
        tracks: Their signals, in the same order.
    """
    tau = np.concatenate([r.tau for r in recordings])
    rms = np.sqrt((tau**2).mean(axis=0))
    steps = np.array([_step(column) for column in tau.T])
    coarse = (rms > 0) & (rms < STEPS * steps)
    power = sum(((t.tau * t.moving) ** 2).sum(axis=0) for t in tracks)
    rows = sum(t.moving.sum(axis=0) for t in tracks)
    noise = np.mean([t.torque_noise**2 for t in tracks], axis=0)
    return coarse | ((rows > 0) & (power < NOISES**2 * noise * rows))


def _step(values: Array) -> float:
    """Least difference of two values; 0 if there are too many for a quantized signal."""
    levels = np.unique(values)
    if not 1 < len(levels) < len(values) / 10:
        return 0.0
    return float(np.diff(levels).min())
