"""level z of another contact, whose bristles yield further."""

import numpy as np

from sim.effects.base import Effect, Trait, any_joint, deflection, row
from sim.engine import laws


def _law(state, p):
    ways = np.full(state.q.shape[1], p["displacement"])
    return p["level"] * deflection(state.q, ways)


EFFECT = Effect(
    name="presliding",
    parameters={"level": "N m", "displacement": "rad"},
    above={"level": 0.0, "displacement": 0.0},
    traits=frozenset({Trait.RARE}),
    # level z = level sgn(qd) + level (z - sgn(qd)), and the first is that friction.
    also=("coulomb",),
    where=any_joint,
    draw=lambda rng, sizes: {
        "level": sizes.coulomb,
        "displacement": rng.uniform(0.003, 0.03),
    },
    friction=row(laws.BRISTLE, "level", "displacement"),
    law=_law,
)
