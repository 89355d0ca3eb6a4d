"""Hidden effects: torque of each as a function of the true state.

Every function takes (State, parameters) and returns the torque that it adds on the
joints of the effect, shape (n, k). Payload and torque gain are not additive and live in
`sim.synthetic.body` and `sim.synthetic.plant`; so do the effects of
`sim.synthetic.disguise`, which are not drawn here but given.
"""

from collections.abc import Callable, Mapping

import numpy as np

from sim.synthetic.effects import elastic, forms, friction, unnamed
from sim.synthetic.state import State

Torque = Callable[[State, Mapping], np.ndarray]

ADDITIVE: dict[str, Torque] = {
    "viscous": friction.viscous,
    "coulomb": friction.coulomb,
    "coulomb_asymmetry": friction.coulomb_asymmetry,
    "viscous_asymmetry": friction.viscous_asymmetry,
    "quadratic_viscous": friction.quadratic_viscous,
    "power_viscous": friction.power_viscous,
    "stribeck": friction.stribeck,
    "load_friction": friction.load_friction,
    "position_friction": friction.position_friction,
    "coupled_friction": friction.coupled_friction,
    "warmup": friction.warmup,
    "presliding": friction.presliding,
    "rotor_inertia": elastic.rotor_inertia,
    "offset": elastic.offset,
    "spring": elastic.spring,
    "balancer": elastic.balancer,
    "ripple": elastic.ripple,
    "x_vibration": unnamed.vibration,
    "x_cogging_sum": unnamed.cogging_sum,
    "x_random_walk": unnamed.random_walk,
    "x_square_wave": unnamed.square_wave,
    "x_friction_jump": unnamed.friction_jump,
}
# Another form of a named effect, by its name: the effects that it may be taken for.
FORMS: dict[str, tuple[str, ...]] = {
    "lorentzian": ("stribeck",),
    "lugre": ("stribeck", "presliding"),
    "hyperbolic_warmup": ("warmup",),
    "soft_limit": ("saturation",),
    "cubic_cable": ("spring",),
    "one_way_viscous": ("viscous_asymmetry",),
}
# soft_limit acts on the whole torque, as payload and torque_gain do.
LAWS: dict[str, Torque] = {
    **ADDITIVE,
    "lorentzian": forms.lorentzian,
    "lugre": forms.lugre,
    "hyperbolic_warmup": forms.hyperbolic_warmup,
    "cubic_cable": forms.cubic_cable,
    "one_way_viscous": forms.one_way_viscous,
}
NOT_ADDITIVE = ("payload", "torque_gain")
GIVEN = ("presliding",)  # not drawn here
NAMED = (
    tuple(n for n in ADDITIVE if not n.startswith("x_") and n not in GIVEN)
    + NOT_ADDITIVE
)
UNNAMED = tuple(n for n in ADDITIVE if n.startswith("x_"))
