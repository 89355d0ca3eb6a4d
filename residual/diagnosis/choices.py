"""What a search may choose from: priors, each with the candidates that it allows."""

from residual.diagnosis.candidates import Candidates, collect
from residual.effects import registry
from residual.effects.base import Span
from residual.evidence.design import Design
from residual.evidence.fit import Prior
from residual.evidence.priors import forbidden, priors
from residual.model.nominal import Nominal


def every_candidate(
    design: Design, nominal: Nominal, span: Span, clocked: bool
) -> Candidates:
    """Append the columns of all effects that some prior allows.

    Args:
        design: Columns.
        nominal: The nominal model.
        span: How far the logs move the arm.
        clocked: Whether the order of the logs in time is known.
    """
    effects = [e for e in registry().values() if clocked or not e.needs_clock]
    barred = _barred(design, nominal)
    wanted = [e for e in effects if not all(e.name in b for _, b in barred)]
    return collect(design, wanted, span, design.dof)


def allowed(
    design: Design, nominal: Nominal, everything: Candidates
) -> list[tuple[Prior, Candidates]]:
    """Every prior with the candidates that may be named under it."""
    barred = _barred(design, nominal)
    return [(prior, everything.without(tuple(b))) for prior, b in barred]


def _barred(design: Design, nominal: Nominal) -> list[tuple[Prior, set]]:
    return [(p, forbidden(p, nominal)) for p in priors(design, nominal)]
