"""Recordings in which nothing is missing, made after real ones, and searched.

The motion is the logged one, smoothed; the torque is that of the identified model.
Encoder and torque noise are redrawn as they were measured, and the nominal model is
redrawn around the truth as far off as it was found to be, so that its prior is tried
too. Every other draw has, in place of noise, what the fit itself left of the logs, in
blocks that are moved and turned over: a model is never quite the arm, and what it
leaves is not as harmless as noise. Several draws of torque noise share one of encoder
noise: what costs time is the columns, and they depend on the angles alone.
"""

from dataclasses import dataclass, replace

import numpy as np

from residual.diagnosis.candidates import Candidates, every_candidate
from residual.diagnosis.gate import passed, simplest
from residual.diagnosis.prior_scale import select
from residual.diagnosis.search import Task, _shortlist
from residual.evidence.colour import coloured
from residual.evidence.design import Design
from residual.evidence.fit import Fit, System, fit, gain, possible
from residual.evidence.priors import Space
from residual.evidence.rules import Rules
from residual.evidence.states import first_design
from residual.model.nominal import Logs, Nominal, prepare_logs
from residual.null.source import Source, null_recordings, redrawn
from residual.recording import Array

ALL = -1e9  # nats
BLOCK = 2.0  # s: longer than noise remembers, shorter than a motion


@dataclass(frozen=True, slots=True)
class Draw:
    """What one null recording showed (`null.Null`)."""

    nats: float
    net: float
    named: bool


def block(source: Source, seed: int, index: int, count: int) -> tuple[Draw, ...]:
    """Draws of torque noise and nominal that share one draw of encoder noise.

    Args:
        index: Number of the block; its own random numbers.
    """
    rng = np.random.default_rng([seed, index])
    logs, hiss = _noisy(source, rng)
    nominal = redrawn(source, rng)
    design = first_design(logs, nominal)
    candidates = every_candidate(design, nominal, logs.span, logs.clock is not None)
    out = [_searched(design, nominal, candidates)]
    for turn in range(1, count):
        make = _blocks if turn % 2 else _hiss
        another, fresh = redrawn(source, rng), make(source, logs, rng)
        moved = nominal.model.coefficients() - another.model.coefficients()
        target = design.stacked([b - a for a, b in zip(hiss, fresh, strict=True)])
        for j, change in enumerate(target):
            place, have = design.present(j, design.nominal)
            change += design.target[j] + design.columns(j, place) @ moved[have]
        out.append(_searched(design.with_target(target), another, candidates))
    return tuple(out)


def _searched(design: Design, nominal: Nominal, candidates: Candidates) -> Draw:
    """The whole choice of prior, search and gate; and the loudest of all candidates."""
    chosen = select(Space(design, nominal), candidates, Rules())
    task, named = chosen.task, False
    if chosen.fit.members:
        _, tested = passed(task, simplest(task, chosen.fit))
        named = bool(tested)
    nats, net = loudest(task, task.start())
    return Draw(nats, net, named)


def loudest(task: Task, base: Fit) -> tuple[float, float]:
    """Largest evidence of any one candidate on top of a fit, and less its price [nats].

    Whether it lowers the error by enough is not asked: a name must do that too.
    """
    open_rules = replace(task.rules, threshold=ALL)
    nats, net = [ALL], [ALL]
    own = System.of(task.design, task.prior, base.members)
    for group in _shortlist(replace(task, rules=open_rules), base, None, own):
        members = (*base.members, group)
        trial = fit(task.design, task.prior, members, task.design.rows / 4)
        trial = replace(trial, counted=base.counted)
        value, big, _ = gain(task.design, task.prior, trial, base)
        if possible(task.design, big, group):
            nats.append(float(value))
            net.append(float(value - task.candidates.cost(group)))
    return max(nats), max(net)


def _noisy(source: Source, rng: np.random.Generator) -> tuple[Logs, list[Array]]:
    """The logs of a block, ready, and the torque noise that is in them."""
    _, read = null_recordings(source, rng)
    old = source.logs
    logs = prepare_logs(old.robot, read, old.clock, old.filters)
    hiss = _hiss(source, logs, rng)
    tracks = tuple(
        replace(new, tau=new.tau + noise, torque_noise=was.torque_noise)
        for new, noise, was in zip(logs.tracks, hiss, old.tracks, strict=True)
    )
    return replace(logs, tracks=tracks), hiss


def _blocks(source: Source, logs: Logs, rng: np.random.Generator) -> list[Array]:
    """What the fit left, in blocks from other places, as often upside down.

    All joints move together: what one drive does to the next stays. Friction acts
    against the motion, and gears are as good forwards as backwards: so the sign may
    turn, and the time it comes at is not its cause.
    """
    whole = np.concatenate(source.left)
    rows = max(round(BLOCK * logs.tracks[0].rate / logs.tracks[0].step), 2)
    out = []
    for track in logs.tracks:
        parts = []
        for _ in range(-(-len(track.tau) // rows)):
            start = rng.integers(max(len(whole) - rows, 1))
            parts.append(rng.choice((-1.0, 1.0)) * whole[start : start + rows])
        out.append(np.concatenate(parts)[: len(track.tau)])
    return out


def _hiss(source: Source, logs: Logs, rng: np.random.Generator) -> list[Array]:
    return [coloured(source.noise, len(t.tau), rng) for t in logs.tracks]
