"""The edit test: a named effect is taken out again, and nothing is refitted.

A low error is no explanation. Dense least squares and a right cause predict unseen
motion equally well; but taken out of its model only the right cause leaves the arm as
it was without it ("Fidelity Is Not Identification", Kyung Hee University 2026).

E = 100 ||tau - tau_hat(model without the effect)|| / ||tau||, over all joints, both
sides through the identification filter, on logs of the arm that never had it.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol

from residual.diagnosis.causes.edit.dense import set_back
from residual.diagnosis.result import Edit, Number
from residual.model.compare import compare, prepare_held_out
from residual.model.model import Model
from residual.quantity import plain
from residual.recording import Recording

FILTERED, MOVING = "filtered", "moving"


class Placed(Protocol):
    """Whatever has a name and joints from 1: a finding, or what was hidden."""

    @property
    def name(self) -> str:
        """Its name."""

    @property
    def joints(self) -> tuple[int, ...]:
        """Its joints from 1; empty for the whole arm."""


def edited(model: Model, effects: Sequence[Placed]) -> Model:
    """Return a model without some effects; nothing is refitted.

    Raises:
        InputError: If it does not have one of them.
    """
    for effect in effects:
        model = model.without(effect.name, effect.joints or None)
    return model


def errors_on(
    models: Mapping[str, Model | None],
    logs: Sequence[Recording],
    kind: str = FILTERED,
) -> dict[str, Number]:
    """Return the error of each model on logs [%], None for one that there is not.

    Args:
        models: By name; logs are prepared with the signal path of the first.
        logs: Logs of the arm without what the models do not have.
        kind: Of which samples: "filtered", or "moving" for those that move alone, where
            friction is not any torque that holds.
    """
    some = {name: model for name, model in models.items() if model is not None}
    first = next(iter(some.values()))
    found, _ = compare(some, prepare_held_out(logs, first), first.filters)
    known = {name: plain(errors.overall(kind)) for name, errors in found.items()}
    return {name: known.get(name) for name in models}


def baseline_edits(
    models: Mapping[str, Model],
    dense: Model,
    found: tuple[Sequence[Placed], Sequence[Placed]],
    baseline: Sequence[Recording],
) -> tuple[Edit, ...]:
    """Take what was found out of the augmented model, and predict the baseline.

    The baseline had none of it, so all of it goes; ``kept`` is with this one back.

    Args:
        models: "nominal" and "augmented" of a diagnosis with a baseline.
        dense: Dense least squares on the same logs.
        found: Effects that are named, and those that are folded into the background.
    """
    effects, every = found[0], [*found[0], *found[1]]
    nominal, augmented = models["nominal"], models["augmented"]
    bare, back = edited(augmented, every), dense
    for effect in every:
        back = set_back(back, nominal, effect) or back
    tried: dict[str, Model | None] = {"bare": bare, "nominal": nominal, "dense": back}
    for i, effect in enumerate(effects):
        others = [other for other in every if other is not effect]
        tried[f"kept {i}"] = edited(augmented, others)
    errors = errors_on(tried, baseline)
    return tuple(
        Edit(
            effect.name,
            tuple(effect.joints),
            errors["bare"],
            errors[f"kept {i}"],
            None if set_back(dense, nominal, effect) is None else errors["dense"],
            errors["nominal"],
        )
        for i, effect in enumerate(effects)
    )


def sealed_edit(
    effect: Placed,
    models: Mapping[str, Model],
    logs: Sequence[Recording],
    kind: str = FILTERED,
) -> Edit:
    """Judge one effect on the arm that has everything but it.

    Args:
        models: "augmented", "dense" and "nominal"; "oracle", the true arm without the
            effect, where it is known.

    Raises:
        InputError: If the augmented model does not have the effect.
    """
    augmented, dense, nominal = (models[k] for k in ("augmented", "dense", "nominal"))
    found = errors_on(
        {
            "edited": edited(augmented, [effect]),
            "kept": augmented,
            "dense": set_back(dense, nominal, effect),
            "oracle": models.get("oracle"),
        },
        logs,
        kind,
    )
    numbers = (found[k] for k in ("edited", "kept", "dense", "oracle"))
    return Edit(effect.name, tuple(effect.joints), *numbers)
