"""The edit test: what changed is taken out of the model again, and the arm is asked."""

from collections.abc import Sequence
from dataclasses import asdict, replace

import numpy as np

from benchmarks.attribution_parts.arms import Arm, Made, make_edited, moved_values
from flows.blind.score import Name
from residual.diagnosis.dense import dense_model
from residual.diagnosis.edit import MOVING, sealed_edit
from residual.diagnosis.result import Diagnosis, Place
from residual.effects import registry
from residual.model.model import Model
from residual.model.term import Term
from residual.robot.dynamics import inertial_parameters
from sim.catalogue import acting, changed, kinds
from sim.records import PlantEffect
from sim.synthetic.plant import true_model


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
        arm: The arm.
        effects: What changed.
        named: The same in the convention of the verdict.
        made: The logs.
        found: Their diagnosis.
    """
    said = {(e.name, j) for e in found.effects for j in e.joints or (0,)}
    models = {k: found.models[k] for k in ("nominal", "augmented")}
    out = []
    for effect, name in zip(effects, named, strict=True):
        if not all((name.effect, j) in said for j in name.joints or (0,)):
            continue
        if "dense" not in models:
            models["dense"] = dense_model(models["nominal"], made.fit)
        others = [other for other in effects if other is not effect]
        models["oracle"] = true_arm(arm, others, models["augmented"])
        log = make_edited(arm, others)
        place = Place(name.effect, name.joints)
        moving = sealed_edit(place, models, [log], MOVING)
        row = asdict(sealed_edit(place, models, [log]))
        out.append(row | {"moving": [moving.error, moving.reference]})
    return out


def true_arm(arm: Arm, effects: Sequence[PlantEffect], like: Model) -> Model:
    """Return a model with the true parameters of an arm.

    Args:
        arm: The arm.
        effects: What it has beside what its description says.
        like: A model of the same declared effects, for its signals.
    """
    plant = arm.plant(effects)
    body = changed(true_model(plant), acting(plant.hidden))
    values = moved_values(arm, effects)
    terms = [
        replace(t, theta=np.array([values[t.effect.name, t.joints[0] + 1][1]]))
        for t in like.terms
        if t.nominal is not None
    ]
    for effect in effects:
        what = kinds()[effect.name]
        if what.body is None and not what.of_drive:
            terms.append(_term(effect, what.defaults, like))
    inertial = inertial_parameters(body)
    return replace(like, inertial=inertial, terms=tuple(terms), tables=())


def _term(effect: PlantEffect, defaults, like: Model) -> Term:
    known, p = registry()[effect.name], {**defaults, **dict(effect.parameters)}
    numbers = np.array([float(p[key]) for key in known.parameters])
    theta, shape = known.from_values(numbers, like.robot)
    joints = tuple(j - 1 for j in effect.joints)
    return Term(known, joints, tuple(shape), np.asarray(theta, dtype=float))
