"""Friction that yields like a spring before it slides (Dahl 1968).

Its column is the state of the bristles less the direction of motion, so that with the
Coulomb friction of the model it makes friction that takes some way to turn round.
"""

from residual.effects.base import (
    BRISTLE,
    Effect,
    Refinement,
    Trait,
    dissipates,
    formula,
    local,
    shaped,
)
from residual.signals.track import bristle


def _shapes(span, j):
    """Displacements beyond the mask around a reversal."""
    ways = (0.003, 0.006, 0.012, 0.025, 0.05)
    return tuple((w,) for w in ways if w < 0.1 * span.travel[j])


EFFECT = Effect(
    name="presliding",
    noun="pre-sliding friction",
    sentence="dry friction that yields like a spring before it slides",
    equation=(
        "z' = qd * (1 - z * sgn(qd)) / displacement; tau = level * (z - sgn(qd)), "
        "on top of level * sgn(qd)"
    ),
    parameters={"level": "N m", "displacement": "rad"},
    columns=local(lambda s, j, shape: [bristle(s.q[:, j], *shape) - s.sign[:, j]]),
    traits=Trait.MEMORY | Trait.FRICTION,
    rides_on="coulomb",
    from_values=shaped,
    shapes=_shapes,
    refine=Refinement("ratio", 0.6),
    possible=dissipates,
    least_seen=((0.006,),),  # rad
    portable=formula("a[0] * (bristle(m, q, s[0]) - sign)", memory=BRISTLE),
)
