"""A second look at what is far larger than was expected of it.

The prior of an effect's size is a mixture: what is usual, and anything. Where an effect
comes out many deviations beyond the usual, it is looked at on its own scale, for the
price of that choice.
"""

from dataclasses import replace

import numpy as np

from residual.evidence.design import Group
from residual.evidence.fit import Fit

FAR = 3.0  # deviations of the usual prior, on average over the coefficients
PRICE = float(np.log(20))  # nats: one effect in twenty is not of usual size


def widened(fitted: Fit, group: Group) -> Group | None:
    """Return a group with the prior of its own size; None where it is usual."""
    if group.parts:
        return None
    theta, count = fitted.of(group), len(group.ids)
    size = float(theta @ group.precision @ theta) / count
    if size < FAR**2:
        return None
    return replace(
        group,
        precision=group.precision / size,
        log_det=group.log_det - count * np.log(size) - 2 * PRICE,
    )
