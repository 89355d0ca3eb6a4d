"""Group 1: one step on random states, and whether the torques of a run add up."""

from itertools import combinations

import numpy as np
import pinocchio as pin

from benchmarks.figures import Figures, figure
from benchmarks.plant_parts.runs import ROBOT, drawn, drive, reference
from sim.catalogue import kinds
from sim.effects.base import Moving
from sim.engine.bullet import World
from sim.plant import tables as at
from sim.plant.arm import Phase, build_arm, channels_of, new_state, phases
from sim.plant.sensors import read
from sim.plant.step import advance
from sim.plant.stepping import pushed
from sim.records import PlantSpec

_SOFT = ("elasticity", "backlash")
_RIGID = tuple(name for name in kinds() if name not in _SOFT)


def identity_figures(seeds: int, quick: bool) -> Figures:
    """Measure identities: rigid combinations, elastic ones, and channel sums.

    Rigid: every single effect, every pair and all at once. The miss is, with the
    acceleration that Bullet made, motor torque minus rigid, rotor, friction and
    explicit torques.

    Args:
        quick: Whether to take every sixth pair only.
    """
    states, pairs = 20, list(combinations(_RIGID, 2))[:: 6 if quick else 1]
    rigid = [(), *((n,) for n in _RIGID), *pairs, _RIGID]
    soft = [(s, *rest) for s in _SOFT for rest in [(), *((n,) for n in _RIGID)]]
    soft += [_SOFT, (*_SOFT, *_RIGID)]
    misses = {
        "rigid": [_worst(names, s, states)[0] for names in rigid for s in range(seeds)],
        "elastic": [
            _worst(names, s, states)[1] for names in soft for s in range(seeds)
        ],
    }
    sums = [
        _sum_miss(names) for names in (("payload", "stribeck"), _SOFT, tuple(kinds()))
    ]
    return {
        "identity_rigid": figure(
            max(misses["rigid"]), 1e-9, len(misses["rigid"]) * states, unit="N m"
        ),
        "identity_elastic_link": figure(
            max(misses["elastic"]), 1e-6, len(misses["elastic"]) * states, unit="N m"
        ),
        "channel_sum": figure(max(sums), 1e-9, len(sums), unit="N m"),
    }


def _worst(names: tuple[str, ...], seed: int, states: int) -> tuple[float, float]:
    """Return the largest miss of all torques, and of the link side alone [N m]."""
    effects = drawn(names, seed)
    arm = build_arm(ROBOT, PlantSpec(effects, seed=seed))
    series = np.full((states, 50), 0.7)
    # From their onset on all effects act; the last phase has them all.
    phase = phases(arm, states, 1e-3, series)[-1]
    state, rng = new_state(arm, 0.0), np.random.default_rng(seed)
    rows = np.zeros((states, at.CHANNELS + len(channels_of(effects)), ROBOT.dof))
    worst = np.zeros(2)
    with World(phase.model, 1e-3) as world:
        for k in range(states):
            q, qd = rng.uniform(-1, 1, (2, 6)) * [[1.5], [3.0]]
            twist = rng.uniform(-5e-3, 5e-3, 6)
            state.motors[:] = q + twist, qd + rng.uniform(-0.2, 0.2, 6), np.zeros(6)
            rows[k, at.Q], rows[k, at.QD] = q, qd
            # Nearly what holds it, so that some joints stick and others slide.
            rows[k, at.DRIVE] = rng.uniform(-1, 1, 6) * [60, 60, 40, 8, 8, 4]
            worst = np.maximum(worst, _step(phase, state, rows, k, world))
    return float(worst[0]), float(worst[1])


def _step(
    phase: Phase, state: at.State, rows: np.ndarray, k: int, world: World
) -> list[float]:
    model, data, packed = (
        phase.model,
        phase.model.createData(),
        at.pack(phase.constants),
    )
    now, zero = rows[k], np.zeros(model.nv)
    q, qd = now[at.Q].copy(), now[at.QD].copy()
    read(k, packed.joints, state.motors, q, rows)
    hold = pin.rnea(model, data, q, qd, zero)
    now[at.DRIVE] += hold
    body = np.vstack([pin.crba(model, data, q), hold])
    outside = sum(pushed(phase, Moving(model, data, q, qd)).values(), start=zero)
    world.reset(q, qd)
    link = advance(k, body, outside, packed, state, rows)
    world.step(link)
    rigid = pin.rnea(model, data, q, qd, (world.state()[1] - qd) / packed.dt)
    total = rigid + now[at.ROTOR] + now[at.FRICTION] - outside
    total = total + now[at.CHANNELS :].sum(axis=0)
    return [np.abs(total - now[at.MOTOR]).max(), np.abs(rigid - link).max()]


def _sum_miss(names: tuple[str, ...]) -> float:
    """Return how far the channels of a whole run are from the torque of the motors."""
    trace = drive(drawn(names, 1), reference("fourier", 5.0), 1)
    rows = trace.rows
    total = trace.rigid(1) + rows[:, at.ROTOR] + rows[:, at.FRICTION]
    total = total + rows[:, at.CHANNELS :].sum(axis=1)
    return float(np.abs(total - rows[:, at.MOTOR]).max())
