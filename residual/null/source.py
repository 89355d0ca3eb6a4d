"""What null recordings are made after: motion, true model and noise of real logs."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.examine import examine
from residual.diagnosis.null_record import Key, key_of
from residual.evidence.colour import autocovariance
from residual.evidence.design import Design
from residual.evidence.fit import Fit
from residual.evidence.priors import inertial_precision
from residual.evidence.rules import Rules
from residual.model.model import Model
from residual.model.nominal import (
    Logs,
    Nominal,
    declared_names,
    prepare_logs,
    start_nominal,
)
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.direction import SMOOTH, Standstill
from residual.signals.pieces import session_clock, sketch_of
from residual.signals.track import Filters, encoder_noise, smooth

FARTHEST = 0.3  # of the inertial parameters: a prior that is wider is as good as none
HIDDEN = 20.0  # displacements that a mask must be wide for its filter to leak none


@dataclass(frozen=True, eq=False, slots=True)
class Source:
    """What null recordings are made after.

    Attributes:
        recordings: The logs; of long ones pieces that are evenly spread.
        logs: The same, ready.
        nominal: The user's model.
        truth: Its structure with the parameters that the logs show.
        scale: Relative scale of the rigid part that they show.
        widths: Relative sd that they show of values given, by the effect's name.
        noise: Autocovariance of the torque's noise at the rows [N^2 m^2]. (lags, dof).
        left: What the fit left of each log, 0 where masked [N m]. Each (m, dof).
        encoder: Noise of the angles per log [rad]. Shape (logs, dof).
        key: What a null of these holds for.
    """

    recordings: tuple[Recording, ...]
    logs: Logs
    nominal: Nominal
    truth: Model
    scale: float
    widths: Mapping[str, float] | None
    noise: Array
    left: tuple[Array, ...]
    encoder: Array
    key: Key


def source(
    robot: Robot,
    recordings: Sequence[Recording],
    declared: Sequence[str] | None = None,
) -> Source:
    """Measure on logs what null recordings of them need: a diagnosis of them.

    What it names is no part of the truth, yet explained, so that it is no noise.

    Args:
        declared: Effects that the model has; None for the robot's own list.
    """
    names, filters = declared_names(robot, declared), Filters()
    clock = session_clock(recordings)
    asked = prepare_logs(robot, recordings, clock, filters)
    # Of long logs the draws are made after seven minutes.
    recordings = sketch_of(recordings)
    logs = prepare_logs(robot, recordings, clock, filters)
    nominal = start_nominal(logs, names)
    made = examine(logs, nominal, Rules(), _quiet)
    whole = made.model(made.fit)
    truth = replace(
        whole,
        terms=whole.terms[: len(nominal.model.terms)],
        standstill=_out_of_sight(whole, logs),
    )
    return Source(
        recordings=tuple(recordings),
        logs=made.logs,
        nominal=nominal,
        truth=truth,
        scale=made.task.prior.scale,
        widths=made.task.prior.widths,
        noise=autocovariance(made.task.design, made.fit),
        left=_left(made.task.design, made.fit),
        encoder=np.array([encoder_noise(r, filters) for r in recordings]),
        key=key_of(asked, nominal),
    )


def _left(design: Design, fitted: Fit) -> tuple[Array, ...]:
    """What a fit leaves of each log, joint by joint, as logged. Each (m, dof)."""
    joints = []
    for j in range(design.dof):
        left = design.residual(j, fitted.ids, fitted.theta)
        joints.append(design.series(j, left))
    return tuple(np.column_stack(lines) for lines in zip(*joints, strict=True))


def null_recordings(
    source: Source, rng: np.random.Generator
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Recordings of the true model: as they are, and with the encoders' noise.

    Both without noise of the torque, which is added behind the filter.
    """
    clean, read = [], []
    for recording, sd in zip(source.recordings, source.encoder, strict=True):
        q = smooth(recording, source.logs.filters)
        own = replace(recording, q=q, qd=None, qdd=None, q_ref=None)
        own = replace(own, tau=source.truth.predict(own))
        clean.append(own)
        read.append(replace(own, q=q + sd * rng.normal(size=q.shape)))
    return tuple(clean), tuple(read)


def redrawn(source: Source, rng: np.random.Generator) -> Nominal:
    """The nominal model around the truth, as far off as the logs say.

    Coefficients of which nothing is given start from zero, as the user's do.

    Args:
        source: The truth, and how far off the user's model was.
    """
    nominal, truth = source.nominal, source.truth
    size = len(truth.inertial)
    scale = min(source.scale, FARTHEST)
    lower = np.linalg.cholesky(inertial_precision(source.logs.robot) / scale**2)
    parts = [truth.inertial + np.linalg.solve(lower.T, rng.normal(size=size))]
    for term, was, given in zip(
        truth.terms, nominal.model.terms, nominal.given, strict=True
    ):
        width = None if given is None else source.widths[term.effect.name]
        chance = rng.normal(size=len(term.theta))
        around = term.theta * (1 + min(width or 0.0, FARTHEST) * chance)
        parts.append(was.theta if given is None else around)
    return replace(
        nominal, model=nominal.model.with_coefficients(np.concatenate(parts))
    )


def _out_of_sight(model: Model, logs: Logs) -> tuple[Standstill, ...]:
    """Each joint's standstill, if need be shorter: no more of it than the mask hides.

    Bristles that still turn round where rows count are presliding, which has a name.
    Behind a mask of width w a joint has gone its standstill speed times w at least.
    """
    way = logs.filters.margin / logs.span.cutoff * logs.speed_floor / HIDDEN
    shapes = model.standstill or (SMOOTH,) * len(way)
    return tuple(
        replace(s, size=min(s.size, float(w))) if s.kind == "bristle" else SMOOTH
        for s, w in zip(shapes, way, strict=True)
    )


def _quiet(stage: str, share: float) -> None:
    """Progress that nobody watches."""
