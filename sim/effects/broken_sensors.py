"""Sensors that break during a run; the diagnosis has no names for them.

A jump of an encoder and a fallen torque constant are effects with an onset. The drive
itself works, and the controller reads the encoder but not the torque sensor.
"""

import numpy as np

from sim.effects.base import Effect, PlantEffectTrait, draw_any_joint, draw_sign

SLACK = 1e-9  # s: an onset on a step acts on that step


def _spikes(tau, t, onset, p):
    """One at the onset and then every `interval`, `width` long, with changing sign."""
    count, into = np.divmod(t - onset + SLACK, p["interval"])
    way = np.where(count % 2 == 0, 1.0, -1.0) * (into < p["width"])
    return tau + p["size"] * way[:, None]


_SENSOR = {"traits": frozenset({PlantEffectTrait.SENSOR}), "where": draw_any_joint}

EFFECTS = (
    Effect(
        name="x_fault_frozen",
        parameters={},
        traits=frozenset({PlantEffectTrait.SENSOR, PlantEffectTrait.FROZEN}),
        where=draw_any_joint,
        draw=lambda rng, sizes: {},
    ),
    Effect(
        name="x_fault_drift",
        parameters={"rate": "rad/s"},
        **_SENSOR,
        draw=lambda rng, sizes: {"rate": draw_sign(rng) * np.deg2rad(rng.uniform(0.02, 0.2))},
        drift=lambda p: p["rate"],
    ),
    Effect(
        name="x_fault_torque_bias",
        parameters={"torque": "N m"},
        **_SENSOR,
        draw=lambda rng, sizes: {"torque": draw_sign(rng) * rng.uniform(0.1, 0.2) * sizes.torque},
        report=lambda tau, t, onset, p: tau + p["torque"],
    ),
    Effect(
        name="x_fault_torque_gain",
        parameters={"gain": "1"},
        above={"gain": -1.0},
        **_SENSOR,
        draw=lambda rng, sizes: {"gain": -rng.uniform(0.2, 0.4)},
        report=lambda tau, t, onset, p: tau * (1.0 + p["gain"]),
    ),
    Effect(
        name="x_fault_torque_spikes",
        parameters={"size": "N m", "interval": "s", "width": "s"},
        # A spike is one sample of 250 Hz.
        defaults={"interval": 0.5, "width": 0.004},
        above={"interval": 0.0, "width": 0.0},
        **_SENSOR,
        draw=lambda rng, sizes: {"size": draw_sign(rng) * rng.uniform(0.5, 1.0) * sizes.torque},
        report=_spikes,
    ),
)
