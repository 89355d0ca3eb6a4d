"""What anyone could see who knows the truth: the power of a perfect name.

The same case is recorded twice, with what it hides and without, from the same random
streams. What the two differ by is the torque of the hidden effect in its own form and
shape, whatever author it has; an encoder's error is the torque that a model gets wrong
by it. That is one column with one free coefficient. How much evidence it wins over the
best fit of the nominal parameters, on the rows, noise and priors of a diagnosis, no
search can win more: an effect that stays under the threshold of a name is below what
these logs show.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residual.diagnosis.search import Candidates, Task, lowers_error, spares_model
from residual.effects import registry
from residual.effects.base import Effect, Placed, State
from residual.evidence.design import Design, Group
from residual.evidence.fit import Fit, fit
from residual.evidence.priors import priors
from residual.evidence.rules import RULES
from residual.model.model import Model
from residual.model.nominal import declared_names, prepare_logs, start_nominal
from residual.recording import Array, Recording
from residual.robot.robot import Robot
from residual.signals.splitting import session_clock
from residual.signals.track import Filters, Track


@dataclass(frozen=True, slots=True)
class Power:
    """What one who is told the form and the shape reaches."""

    # Evidence of the true column over none, the price of one of the vocabulary's names
    # taken off [nats]
    nats: float
    # Whether that passes for a name: the threshold of the evidence, and the error of
    # some joint falls by enough, or parameters are spared beyond belief
    sees: bool


def power(
    robot: Robot, hidden: Sequence[Recording], *others: Sequence[Recording]
) -> Power:
    """Return the power of a perfect name on the fit logs of a case.

    Others are the same motions and noise of the same arm: without the effect in
    question, then without one more each; those are known beside it.
    """
    filters, clock = Filters(), session_clock(hidden)
    every = (hidden, *others)
    logs, *plain = (prepare_logs(robot, r, clock, filters) for r in every)
    nominal = start_nominal(logs, declared_names(robot, None))
    design = Design(logs.tracks, nominal.model)
    tracks = [own.tracks for own in (logs, *plain)]
    begins = [nominal.model.observe(t).t[0] for t in logs.tracks]
    lines = []
    for i in range(len(others)):
        pairs = zip(every[i], every[i + 1], strict=True)
        gaps = [
            true_torque(nominal.model, pair, own)
            for pair, own in zip(
                pairs, zip(tracks[i], tracks[i + 1], strict=True), strict=True
            )
        ]
        lines.append(dict(zip(begins, gaps, strict=True)))
    return gained(design, priors(design, nominal), *lines)


def true_torque(
    model: Model, recordings: tuple[Recording, Recording], tracks: tuple[Track, Track]
) -> Array:
    """Return what a case hides of the torque of one log [N m]. Shape (n, dof).

    Of what a model misses with it and without it, the difference: the arm in the
    physics engine does not move quite alike in both.
    """
    misses = [
        _at(track.t, log.t, log.tau) - model.torque_on(track)
        for log, track in zip(recordings, tracks, strict=True)
    ]
    return misses[0] - misses[1]


def gained(
    design: Design,
    every: Sequence,
    lines: Mapping[float, Array],
    *beside: Mapping[float, Array],
) -> Power:
    """Return the power of one column whose torque is given, in the likeliest prior.

    Torque at the rate of features by the session time of a log's first sample [N m], of
    shapes (n, dof); beside it the same of what is known to be there, too.
    """
    wanted = [Placed(_truth(own), (), ()) for own in (lines, *beside)]
    group, *known = design.add(wanted)
    tasks = [Task(design, prior, Candidates((), {}), RULES) for prior in every]
    with_it = [_fitted(task, (group, *known)) for task in tasks]
    # Rows are counted by what the better model leaves, as everywhere.
    counted = np.max([fitted.counted for fitted in with_it], axis=0)
    big, small = (
        [_fit(t, members, counted) for t in tasks]
        for members in ((group, *known), known)
    )
    price = np.log(sum(len(e.candidates(design.dof)) for e in registry().values()))
    # The prior that a search would settle on: the likeliest, with the name or without.
    dear = price + RULES.per_name
    worth = [max(b.score - dear, s.score) for b, s in zip(big, small, strict=True)]
    i = int(np.argmax(worth))
    nats = float(big[i].score - small[i].score - price)
    sees = nats >= RULES.threshold and (
        lowers_error(tasks[i], big[i], small[i])
        or spares_model(tasks[i], group, nats, big[i], small[i])
    )
    return Power(round(nats, 2), sees)


def _truth(lines: Mapping[float, Array]) -> Effect:
    def columns(state: State, joints: tuple, shape: tuple) -> Array:
        return lines[state.t[0]][:, :, None]

    return Effect("truth", "what is hidden", {"share": "1"}, columns, scope="global")


def _fitted(task: Task, members: Sequence[Group]) -> Fit:
    start = task.start()
    return task.settle(task.fit(members, start)) if members else start


def _fit(task: Task, members: Sequence[Group], counted: Array) -> Fit:
    return fit(task.design, task.prior, members, counted, rounds=6)


def _at(t: Array, own: Array, values: Array) -> Array:
    return np.column_stack([np.interp(t, own, column) for column in values.T])
