"""The edit test: what changed is taken out of the model again, and the arm is asked."""

from collections.abc import Sequence
from dataclasses import asdict

from benchmarks.attribution_parts.arms import Arm, Made, make_edited, moved_values
from flows.blind.score import Name
from flows.steps.edit import is_named, with_truth
from residual.diagnosis.causes.edit.dense import dense_model
from residual.diagnosis.causes.edit.edits import MOVING, sealed_edit
from residual.diagnosis.result import Diagnosis, Place
from residual.model.model import Model
from sim.catalogue import acting, changed
from sim.quasi_static import true_model
from sim.records import PlantEffect


def edit_rows(
    arm: Arm,
    effects: Sequence[PlantEffect],
    named: Sequence[Name],
    made: Made,
    found: Diagnosis,
) -> list[dict]:
    """Take each change that was named out of the model, and compare with the arm.

    The arm without that change, and with all others, moves in a way of its own.

    Args:
        effects: What changed.
        named: The same in the convention of the verdict.
    """
    models = {k: found.models[k] for k in ("nominal", "augmented")}
    out = []
    for effect, name in zip(effects, named, strict=True):
        place = Place(name.effect, name.joints)
        if not is_named(place, found.verdict):
            continue
        if "dense" not in models:
            models["dense"] = dense_model(models["nominal"], made.fit)
        others = [other for other in effects if other is not effect]
        models["oracle"] = true_arm(arm, others, models["augmented"])
        log = make_edited(arm, others)
        moving = sealed_edit(place, models, [log], MOVING)
        row = asdict(sealed_edit(place, models, [log]))
        out.append(
            row | {"moving": [moving.error, moving.reference, moving.least_squares]}
        )
    return out


def true_arm(arm: Arm, effects: Sequence[PlantEffect], like: Model) -> Model:
    """Return a model with the true parameters of an arm.

    Args:
        like: A model of the same declared effects, for its signals.
    """
    plant = arm.plant(effects)
    body = changed(true_model(plant), acting(plant.hidden))
    drives = {key: true for key, (_, true) in moved_values(arm, effects).items()}
    return with_truth(like, body, drives, effects)
