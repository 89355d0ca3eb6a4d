"""What a diagnosis leaves behind for the next one: its model, and how sure that is.

A model that is adopted is to the next diagnosis what a baseline is: its values are
given, its effects are declared, and its posterior is the prior of what may have changed
since. Where no posterior was kept, its values are given and their scale is estimated.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from residual.diagnosis.baseline.drift import free_to_drift
from residual.diagnosis.examine import Examined
from residual.errors import InputError
from residual.evidence.background import sizes_of
from residual.evidence.fit import Fit
from residual.evidence.priors import posterior_of
from residual.model.model import Model
from residual.model.nominal import GIVEN, Logs, Nominal
from residual.model.term import with_slots
from residual.recording import Array


def learnt(examined: Examined, fitted: Fit, augmented: Model) -> Nominal:
    """Return what is known of an arm after a diagnosis.

    Args:
        examined: The diagnosis.
        fitted: Its fit, with the names that stand.
        augmented: The model of that fit, without tables.

    Returns:
        The augmented model, tables included, with its posterior. What was there for
        friction to fade with during the logs is gone: it is no part of the arm.
    """
    model = augmented
    if examined.logs.background:
        model = examined.model(fitted, like=augmented, tables=True)
    covariance = posterior_of(fitted, len(model.coefficients()))
    model, covariance = _without_fading(examined.nominal, model, covariance)
    return Nominal(
        model,
        (None,) * len(model.terms),
        covariance=covariance,
        baseline_unexplained=examined.adequacy.structured,
        usual=sizes_of(examined.logs.background),
    )


def given_values(model: Model) -> Nominal:
    """Return a model as the nominal one, where nobody knows how sure it is."""
    return Nominal(model, (GIVEN,) * len(model.terms))


def on_logs(known: Nominal, logs: Logs) -> Nominal:
    """Return what is known of an arm as the nominal model of new logs.

    The friction of all joints may have drifted together, as since a baseline.

    Args:
        known: What is known.
        logs: The logs to be held against it.
    """
    model = replace(known.model, speed_floor=logs.speed_floor, clock=logs.clock)
    now = replace(known, model=model)
    return now if now.covariance is None else free_to_drift(now, logs)


def to_record(known: Nominal) -> dict:
    """Return what is known as plain values; of the model without its robot."""
    model = known.model.to_record()
    del model["robot"]
    lower = np.tril_indices(len(known.covariance))
    return {
        "model": model,
        "covariance": known.covariance[lower].tolist(),
        "unexplained": known.baseline_unexplained.tolist(),
        "usual": None if known.usual is None else known.usual.tolist(),
    }


def from_record(record: Mapping, robot: Mapping) -> Nominal:
    """Return what is known, of its record and that of its robot.

    Raises:
        InputError: If the record is damaged.
    """
    try:
        model = Model.from_record({**record["model"], "robot": robot})
        usual = record["usual"]
        return Nominal(
            model,
            (None,) * len(model.terms),
            covariance=_square(record["covariance"], len(model.coefficients())),
            baseline_unexplained=np.array(record["unexplained"], dtype=float),
            usual=None if usual is None else np.array(usual, dtype=float),
        )
    except (KeyError, TypeError, ValueError, IndexError) as error:
        raise InputError(
            f"What is known of an adopted model is damaged: {error!r}."
        ) from error


def _square(lower: list, size: int) -> Array:
    out = np.zeros((size, size))
    out[np.tril_indices(size)] = lower
    return out + np.tril(out, -1).T


def _without_fading(
    nominal: Nominal, model: Model, covariance: Array
) -> tuple[Model, Array]:
    count = len(nominal.model.terms)
    gone = range(count - nominal.fading, count)
    if not gone:
        return model, covariance
    keep = list(range(len(model.inertial)))
    for i, (_, own) in enumerate(with_slots(model.terms, len(model.inertial))):
        keep += [] if i in gone else range(own.start, own.stop)
    terms = tuple(t for i, t in enumerate(model.terms) if i not in gone)
    return replace(model, terms=terms), covariance[np.ix_(keep, keep)]
