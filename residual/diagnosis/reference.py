"""The yardstick that anyone has at hand: plain least squares, on the same logs.

All inertial parameters, the drive's rotor, Coulomb and viscous friction and a constant
torque of every joint, all free, every joint's error weighed alike. A diagnosis that
predicts worse than that is not worth its names, so it is held against it on the
held-out logs.
"""

from residual.effects import registry
from residual.effects.base import Trait
from residual.evidence.design import Design
from residual.evidence.fit import System, smallest_change
from residual.evidence.priors import SCALES, relative_prior
from residual.model.model import Model
from residual.model.nominal import (
    DEFAULT_DECLARED,
    Logs,
    start_nominal,
    with_standstill,
)


def plain_fit(logs: Logs) -> Model:
    """Fit a robot's logs by plain least squares."""
    constant = (e.name for e in registry().values() if Trait.CONSTANT in e.traits)
    nominal = start_nominal(logs, (*DEFAULT_DECLARED, *constant))
    design = Design(logs.tracks, nominal.model)
    whole = System.of(design, relative_prior(design, nominal, SCALES[-1]), ())
    least = smallest_change(whole.gram.sum(axis=0), whole.cross.sum(axis=0))
    model = nominal.model.with_coefficients(nominal.model.coefficients() + least)
    return with_standstill(model, logs.sketch)
