"""Settle a model: the standstill of each joint that suits the fit logs."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from residual.effects.base import State
from residual.model.model import Model
from residual.recording import Array
from residual.signals.direction import CHOICES, SMOOTH, Standstill
from residual.signals.track import Track

WORTH = 0.98  # share of the usual choice's squared error that another must get under


def with_standstill(model: Model, tracks: Sequence[Track]) -> Model:
    """Choose each joint's behaviour at standstill by the fit logs' whole error.

    The torque is linear in the share that is held at standstill, so that share has a
    closed form for each kind.
    """
    seen = [(track, model.observe(track)) for track in tracks]
    tried = [_held(model, seen, shape) for shape in CHOICES]
    miss = np.array([m for m, _ in tried])
    order = np.argmin(miss, axis=0)
    usual = CHOICES.index(SMOOTH)
    chosen = []
    for j, i in enumerate(order):
        pick = int(i) if miss[i, j] < WORTH * miss[usual, j] else usual
        chosen.append(replace(CHOICES[pick], hold=float(tried[pick][1][j])))
    return replace(model, standstill=tuple(chosen))


def _held(
    model: Model, seen: Sequence[tuple[Track, State]], shape: Standstill
) -> tuple[Array, Array]:
    """Squared error at the best share held, and that share. Shapes (dof,), (dof,)."""
    dof = model.robot.dof
    own, mixed, power = np.zeros(dof), np.zeros(dof), np.zeros(dof)
    for track, state in seen:
        sides = [
            model.torque_seen(model.seen_by(state, (side,) * dof))
            for side in (replace(shape, hold=0.0), shape)
        ]
        none, full = np.split(track.filter(np.concatenate(sides, axis=1)), 2, axis=1)
        gap, step = (track.tau - none)[track.inner], (full - none)[track.inner]
        own += (gap**2).sum(axis=0)
        mixed += (gap * step).sum(axis=0)
        power += (step**2).sum(axis=0)
    share = np.clip(mixed / np.maximum(power, 1e-30), 0, 1).round(2)
    share[power <= 1e-12 * own] = 1.0
    return own - 2 * share * mixed + share**2 * power, share
