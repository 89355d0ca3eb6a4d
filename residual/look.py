"""Logs made ready to be searched, and the model that features are seen with."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from residual.candidates import Candidates
from residual.design import Design
from residual.effects.base import Span
from residual.encoder import shaken
from residual.evidence import Fit, Prior
from residual.model import Model, Term
from residual.nominal import build_nominal
from residual.prior import Nominal, priors, relative_prior
from residual.recording import Recording
from residual.robot import Robot
from residual.search import Rules, Task, start
from residual.signals import Filters, Track, prepare

ROUGH_SCALE = 0.1  # prior of the first fit, which only feeds model-based features


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


def ready(
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


def first_look(logs: Logs, nominal: Nominal, named: Model | None = None) -> Design:
    """Nominal columns, and features seen with a model that fits these logs roughly.

    Args:
        logs: The logs.
        nominal: The model to be doubted.
        named: A model to see features with instead, such as one with what was named.
    """
    states = [nominal.model.observe(t) for t in logs.tracks]
    design = Design(list(zip(logs.tracks, states, strict=True)), nominal.model)
    if named is None:
        if nominal.covariance is None:
            prior = relative_prior(design, nominal, ROUGH_SCALE)
        else:
            (prior,) = priors(design, nominal)
        named = as_model(nominal, _rough_fit(design, prior))
    look_with(design, logs, named)
    return design


def _rough_fit(design: Design, prior: Prior) -> Fit:
    return start(Task(design, prior, Candidates((), {}), Rules()))


def look_with(design: Design, logs: Logs, named: Model) -> None:
    """From now on let features read the torque of that model."""
    rigid = [s.regressor for s in design.states]
    states = zip(logs.tracks, rigid, strict=True)
    design.look([named.observe(t, r) for t, r in states])


def physical(model: Model) -> Model:
    """Only what has a physical parameter in it: loads, friction levels, rotors.

    A feature that reads the model's torque must not carry the shape of another finding:
    a torque gain times a found warm-up would explain the warm-up.
    """
    terms = tuple(t for t in model.terms if t.effect.is_parameter)
    return replace(model, terms=terms)


def as_model(nominal: Nominal, fitted: Fit) -> Model:
    """Nominal model moved by a fit's coefficients, its members added as terms."""
    base = nominal.model
    count = len(base.coefficients())
    moved = base.with_coefficients(base.coefficients() + fitted.theta[:count])
    found = tuple(
        Term(g.effect, g.joints, g.shape, fitted.of(g)) for g in fitted.members
    )
    return replace(moved, terms=(*moved.terms, *found))
