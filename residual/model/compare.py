"""The error of several models on unseen logs, and the curves behind it."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import stdtrit

from residual.model.lookup import AnyModel, remove_tables, replace_model
from residual.model.model import Model
from residual.recording import Array, Recording
from residual.signals.splitting import (
    choose_spread_pieces,
    compute_piece_overlap,
    exceed_split_length,
    group_pieces_by_log,
    split_long_logs,
)
from residual.signals.track import FilterSettings, Track, build_tracks, interpolate_torque

# Whether a model predicts worse than another beyond chance: one rule for all uses.
#
# The test of findings, the gate of adoption, and the headline use it. A rise of an error
# counts from a twentieth on, if paired blocks of two seconds show it at p < 0.01; for a
# log with fewer than eight such pairs the size alone decides.

WORSE = 1.05  # times the error
SURE = 0.99  # one-sided, over paired blocks
PAIRED, FEW = 2, 8  # seconds of a block; blocks
SMALL = 1e-3  # of a joint's torque: smaller differences are within model accuracy


def compute_error_rise(after: Array, before: Array) -> float:
    """Return the relative rise of an error; 0 if by chance.

    Args:
        after: Squared errors per second. Shape (seconds,).
        before: The same of the other model. Shape (seconds,).
    """
    ratio = float(np.sqrt(after.sum() / max(before.sum(), 1e-300)))
    rose = ratio > WORSE and is_error_significant(after, before)
    return ratio - 1 if rose else 0.0


def is_error_significant(after: Array, before: Array, confidence: float = SURE) -> bool:
    """Whether paired blocks of two seconds show that one error is larger.

    Args:
        after: Squared errors per second. Shape (seconds,).
        before: The same of the other model. Shape (seconds,).
        confidence: One-sided confidence.
    """
    change = _blocks(after) - _blocks(before)
    # A block in which a joint stands still is ignored.
    change = change[_blocks(after) + _blocks(before) > 0]
    if len(change) < FEW:
        return bool(change.sum() > 0)
    scatter = change.std(ddof=1) * np.sqrt(len(change))
    return bool(change.sum() > stdtrit(len(change) - 1, confidence) * scatter)


def compute_joint_error_rises(
    after: Array, before: Array, power: Array, min_share: float = SMALL
) -> Array:
    """Return the relative rise of each joint's error; 0 if by chance. (dof,).

    Args:
        after: Squared errors per second [N^2 m^2]. Shape (seconds, dof).
        before: The same of the other model. Shape (seconds, dof).
        power: Squared torque on the same rows [N^2 m^2]; a joint without is not logged.
            Shape (dof,).
        min_share: Least rise, as a share of that torque.
    """
    now, then = np.sqrt(after.sum(axis=0)), np.sqrt(before.sum(axis=0))
    large = now - then > min_share * np.sqrt(power)
    clear = (power > 1e-12 * power.max(initial=0.0)) & large
    pairs = zip(after.T, before.T, clear, strict=True)
    return np.array([compute_error_rise(a, b) if on else 0.0 for a, b, on in pairs])


def _blocks(seconds: Array) -> Array:
    """Sums of two seconds each; a last single second joins the block before."""
    count = max(len(seconds) // PAIRED, 1)
    starts = np.arange(count) * PAIRED
    return np.add.reduceat(seconds, starts) if len(seconds) else seconds


@dataclass(frozen=True, eq=False, slots=True)
class LogPrediction:
    """Measured torque against the prediction of each model on one held-out log."""

    id: str  # label of the recording
    t: Array  # time from the first sample [s], (n,)
    tau: Array  # measured torque, identification filter applied [N m], (n, dof)
    # Filtered prediction of each model: keys nominal, identified, augmented, and plsr
    # where the rest was corrected [N m], (n, dof).
    tau_hat: Mapping[str, Array]
    moving: Array  # whether that joint moves. Shape (n, dof), bool


@dataclass(frozen=True, eq=False, slots=True)
class FindingScatter:
    """The torque of one finding on one joint, over its explaining variable."""

    name: str  # name of the effect
    joint: int  # joint number from 1
    variable: str  # label of the horizontal axis, with its unit: "q2 [rad]"
    x: Array  # values of that variable, (k,)
    residual: Array  # measured minus model torque without this effect [N m], (k,)
    fitted: Array  # contribution of the effect [N m], (k,)
    log: Array  # label of the log of each sample. Shape (k,), str; the fit logs only


BLOCK = 1.0  # s: longer than the autocorrelation of noise


@dataclass(frozen=True, eq=False, slots=True)
class HeldOutLog:
    """One prepared held-out log."""

    recording: Recording  # the log
    track: Track  # its signals at its own rate


def prepare_held_out(logs: Sequence[Recording], model: Model) -> tuple[HeldOutLog, ...]:
    """Prepare held-out logs with the signal path of a model.

    Long ones are cut into pieces, at the rate of the features.
    """
    pieces = split_long_logs(logs, model.filters.torque)
    long = exceed_split_length(logs)
    floor = model.speed_floor
    tracks, _ = build_tracks(pieces, model.filters, floor, full_rate=not long)
    return tuple(map(HeldOutLog, pieces, tracks))


@dataclass(frozen=True, eq=False, slots=True)
class ErrorSums:
    """Sums behind the relative error 100·||tau - tau_hat||/||tau|| of one model."""

    # Squared error and squared torque per kind of sample: "raw", "filtered", "moving"
    # [N^2 m^2], (dof,).
    miss: Mapping[str, Array]
    power: Mapping[str, Array]
    alike: bool = True  # whether all joints have one unit

    def per_joint(self, kind: str) -> Array:
        """Relative error of each joint [%], NaN where there is no torque. (dof,)."""
        power = self.power[kind]
        some = power > 1e-12 * max(float(power.max()), 1e-30)
        return 100 * np.sqrt(self.miss[kind] / np.where(some, power, np.nan))

    def without(self, joints: Sequence[int]) -> "ErrorSums":
        """The sums without some joints (from 0)."""
        keep = np.ones(len(self.miss["raw"]))
        keep[list(joints)] = 0.0
        miss, power = ({k: v * keep for k, v in part.items()} for part in (self.miss, self.power))
        return replace(self, miss=miss, power=power)

    def overall(self, kind: str) -> float:
        """Relative error over all joints, Frobenius norm [%].

        Torques and forces have no common norm: for an arm with both kinds of joints it
        is the root mean square of the joints' errors.
        """
        if not self.alike:
            return float(np.sqrt(np.nanmean(self.per_joint(kind) ** 2)))
        power = float(self.power[kind].sum())
        return float(100 * np.sqrt(self.miss[kind].sum() / power)) if power else np.nan


def compute_model_errors(
    models: Mapping[str, AnyModel], held_out: Sequence[HeldOutLog], filters: FilterSettings
) -> tuple[dict[str, ErrorSums], tuple[LogPrediction, ...]]:
    """Errors of every model on the held-out logs, and the curves behind them.

    Raw errors are taken on torque as logged, at its own samples, the edges dropped
    and the mean kept. Filtered errors pass both sides through the identification
    filter; moving errors are filtered ones on rows where that joint moves.
    """
    dof = held_out[0].recording.dof if held_out else 0
    kinds = ("raw", "filtered", "moving")
    sums = {
        name: {part: {k: np.zeros(dof) for k in kinds} for part in ("miss", "power")}
        for name in models
    }
    proofs, first = [], {}
    for witness in held_out:
        curves = {}
        for name, model in models.items():
            torque = model.torque_on(witness.track)
            curves[name] = witness.track.filter(torque)
            _accumulate(sums[name], witness, torque, curves[name], filters.edge)
        label, track = witness.recording.id, witness.track
        inner, start = track.valid, first.setdefault(label, track.t[0])
        t = (track.t - start)[:: track.step][inner]
        hats = {k: v[inner] for k, v in curves.items()}
        proofs.append(LogPrediction(label, t, track.tau[inner], hats, track.moving[inner]))
    alike = all(len(set(remove_tables(m).robot.prismatic)) == 1 for m in models.values())
    errors = {name: ErrorSums(s["miss"], s["power"], alike) for name, s in sums.items()}
    joined = []  # of all pieces of each log
    for numbers in group_pieces_by_log([p.id for p in proofs]):
        pieces = [proofs[i] for i in numbers]
        hats = [p.tau_hat for p in pieces]
        joined.append(
            replace(
                pieces[0],
                t=np.concatenate([p.t for p in pieces]),
                tau=np.concatenate([p.tau for p in pieces]),
                tau_hat={k: np.concatenate([h[k] for h in hats]) for k in hats[0]},
                moving=np.concatenate([p.moving for p in pieces]),
            )
        )
    return errors, tuple(joined)


def compute_moving_error(model: Model, held_out: Sequence[HeldOutLog]) -> Array:
    """Squared filtered error on moving rows, per second [N^2 m^2]. (seconds, dof).

    For long logs on evenly spread pieces.
    """
    out = []
    for witness in _sketch(held_out):
        track = witness.track
        torque = track.filter(model.torque_on(track))
        miss = ((track.tau - torque) * track.moving) ** 2
        t = track.t[:: track.step]
        starts = np.searchsorted(t, np.arange(t[0], t[-1], BLOCK))
        out.append(np.add.reduceat(miss, np.unique(starts), axis=0))
    return np.concatenate(out)


def find_worse_joints(
    models: Mapping[str, AnyModel], held_out: Sequence[HeldOutLog]
) -> tuple[int, ...]:
    """Joints (from 1) on which "augmented" is worse than "identified" beyond chance."""
    after, before = (
        compute_moving_error(models[name], held_out) for name in ("augmented", "identified")
    )
    larger = compute_joint_error_rises(after, before, compute_moving_power(held_out))
    return tuple(int(j) + 1 for j in np.flatnonzero(larger))


def compute_moving_power(held_out: Sequence[HeldOutLog]) -> Array:
    """Squared filtered torque on the same rows [N^2 m^2]. Shape (dof,)."""
    torques = (w.track.tau * w.track.moving for w in _sketch(held_out))
    return sum((tau**2).sum(axis=0) for tau in torques)


def _sketch(held_out: Sequence[HeldOutLog]) -> list[HeldOutLog]:
    seconds = [witness.track.seconds for witness in held_out]
    return [held_out[i] for i in choose_spread_pieces(seconds)]


def _accumulate(sums: dict, witness: HeldOutLog, torque, filtered, edge: float) -> None:
    log, track = witness.recording, witness.track
    at = interpolate_torque(torque, track, log)
    if not track.entire:  # what its neighbours have too
        edge = compute_piece_overlap(track.cutoff, track.rate)
    inside = (log.t >= log.t[0] + edge) & (log.t <= log.t[-1] - edge)
    pairs = {
        "raw": (log.tau[inside], at[inside]),
        "filtered": (track.tau[track.valid], filtered[track.valid]),
        "moving": (track.tau * track.moving, filtered * track.moving),
    }
    for kind, (tau, tau_hat) in pairs.items():
        sums["miss"][kind] += ((tau - tau_hat) ** 2).sum(axis=0)
        sums["power"][kind] += (tau**2).sum(axis=0)


WHOLE, EDITED = "model", "edited"

Edits = Sequence[tuple[str, tuple[int, ...]]]


@dataclass(frozen=True, eq=False, slots=True)
class Prediction:
    """The prediction of a model on logs."""

    # "model", and "edited" if effects were removed.
    models: Mapping[str, AnyModel]
    logs: tuple[Recording, ...]  # the logs
    # Of each log, the torque of each model at its samples, not filtered [N m], (n,
    # dof).
    torque: tuple[Mapping[str, Array], ...]
    # Errors of each model over all logs, against the measured torque.
    errors: Mapping[str, ErrorSums]
    cutoff: float  # of the identification filter [Hz]


def predict_logs(model: AnyModel, logs: Sequence[Recording], without: Edits = ()) -> Prediction:
    """Compute the torque of a model on logs, also with effects removed.

    Args:
        without: Name of each effect to remove, and joints from 1; () for all of that
            name.

    Raises:
        InputError: If the model does not have such an effect there.
    """
    models: dict[str, AnyModel] = {WHOLE: model}
    if without:
        models[EDITED] = remove_effects(model, without)
    base = remove_tables(model)
    ready = prepare_held_out(logs, base)
    errors, _ = compute_model_errors(models, ready, base.filters)
    torque = [{name: m.predict(log) for name, m in models.items()} for log in logs]
    cutoff = min(entry.track.cutoff for entry in ready)
    return Prediction(models, tuple(logs), tuple(torque), errors, cutoff)


def remove_effects(model: AnyModel, without: Edits) -> AnyModel:
    """Return a model without some effects; its tables are unchanged."""
    edited = remove_tables(model)
    for name, joints in without:
        edited = edited.without(name, joints or None)
    return replace_model(model, edited)
