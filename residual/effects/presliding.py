"""Friction that yields like a spring before it slides (Dahl 1968).

Its column is the state of the bristles less the direction of motion, so that together
with the Coulomb friction of the model, friction takes some displacement to reverse.
"""

from residual.effects.base import (
    BRISTLE,
    Effect,
    EffectTrait,
    ExportedLaw,
    ShapeRefinement,
    append_shape,
    build_joint_columns,
    dissipates,
)
from residual.signals.track import compute_dahl_state


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
    columns=build_joint_columns(
        lambda s, j, shape: [compute_dahl_state(s.q[:, j], *shape) - s.sign[:, j]]
    ),
    traits=EffectTrait.MEMORY | EffectTrait.FRICTION,
    rides_on="coulomb",
    from_values=append_shape,
    shapes=_shapes,
    refine=ShapeRefinement("ratio", 0.6),
    possible=dissipates,
    least_seen=((0.006,),),  # rad
    portable=ExportedLaw(("a[0] * (bristle(m, q, s[0]) - sign)",), memory=BRISTLE),
)
