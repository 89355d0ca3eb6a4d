"""The states that features are seen with, and a fit as a model."""

from dataclasses import replace

from residual.evidence.design import Design
from residual.evidence.fit import Fit, start
from residual.evidence.priors import relative_prior
from residual.evidence.rules import RULES
from residual.model.model import Model
from residual.model.nominal import Logs, Nominal
from residual.model.term import Term


def first_design(logs: Logs, nominal: Nominal, named: Model | None = None) -> Design:
    """Nominal columns, and features seen with a model that fits these logs roughly.

    Args:
        named: A model to see features with instead, such as one with what was named.
    """
    design = Design(logs.tracks, nominal.model)
    if named is None:
        prior = relative_prior(design, nominal, RULES.first_scale)
        named = as_model(nominal, start(design, prior))
    design.show_torque(named)
    return design


def physical(model: Model) -> Model:
    """Only what has a physical parameter in it: loads, friction levels, rotors.

    A feature that reads the model's torque must not carry the shape of another finding:
    a torque gain times a found warm-up would explain the warm-up.
    """
    terms = tuple(t for t in model.terms if t.effect.is_parameter)
    return replace(model, terms=terms, tables=())


def as_model(nominal: Nominal, fitted: Fit) -> Model:
    """Nominal model moved by a fit's coefficients, its members added as terms."""
    base = nominal.model
    count = len(base.coefficients())
    moved = base.with_coefficients(base.coefficients() + fitted.theta[:count])
    found = tuple(
        Term(g.effect, g.joints, g.shape, fitted.of(g)) for g in fitted.members
    )
    return replace(moved, terms=(*moved.terms, *found))
