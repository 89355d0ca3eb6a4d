"""Torque of a model on logs, as it is and edited, beside what was measured."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from residual.model.compare import Errors, compare, prepare_held_out
from residual.model.corrected import Corrected
from residual.model.model import Model
from residual.recording import Array, Recording

WHOLE, EDITED = "model", "edited"

Edits = Sequence[tuple[str, tuple[int, ...]]]


@dataclass(frozen=True, eq=False, slots=True)
class Prediction:
    """What a model says of logs.

    Attributes:
        models: "model", and "edited" where something was taken out of it.
        logs: The logs.
        torque: Of each log, the torque of each model at its samples, not filtered
            [N m]. Shapes (n, dof).
        errors: Of each model over all logs, against what was measured.
        cutoff: Of the identification filter [Hz].
    """

    models: Mapping[str, Model | Corrected]
    logs: tuple[Recording, ...]
    torque: tuple[Mapping[str, Array], ...]
    errors: Mapping[str, Errors]
    cutoff: float


def predict(
    model: Model | Corrected, logs: Sequence[Recording], without: Edits = ()
) -> Prediction:
    """Compute the torque of a model on logs, and with effects taken out of it.

    Args:
        without: Name of each effect to take out, and joints from 1; () for all of
            that name.

    Raises:
        InputError: If the model does not have such an effect there.
    """
    models: dict[str, Model | Corrected] = {WHOLE: model}
    if without:
        models[EDITED] = taken_apart(model, without)
    base = model.model if isinstance(model, Corrected) else model
    ready = prepare_held_out(logs, base)
    errors, _ = compare(models, ready, base.filters)
    torque = [{name: one.predict(log) for name, one in models.items()} for log in logs]
    cutoff = min(one.track.cutoff for one in ready)
    return Prediction(models, tuple(logs), tuple(torque), errors, cutoff)


def taken_apart(model: Model | Corrected, without: Edits) -> Model | Corrected:
    """Return a model without some effects; tables on top of it stay as they are."""
    if isinstance(model, Corrected):
        edited = taken_apart(model.model, without)
        assert isinstance(edited, Model)
        return replace(model, model=edited)
    for name, joints in without:
        model = model.without(name, joints or None)
    return model
