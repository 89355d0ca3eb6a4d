"""The edit test on an arm of our own: simulated without what the verdict named.

Only for a verdict that is stored, since the seal of its runs is open by then.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from flows.inputs.given import load
from flows.steps.experiment import reference_of
from flows.storage.diagnosis import read_models, read_verdict
from residual.diagnosis.result import Edit, Place, Verdict
from residual.effects import registry, reported_joints
from residual.model.model import Model, Term
from residual.recording import Recording
from residual.robot.dynamics import inertial_parameters
from residual.threads import one_blas_thread
from residual.verdict.edit import dense_model, sealed_edit
from sim.engine.records import PlantEffect, PlantSpec, Rates, TrajectorySpec
from sim.experiment import run_experiment
from sim.plant.arm import build_arm
from sim.plant.catalogue import acting, changed, kinds
from warehouse.runs import read_manifest, read_run

Drives = Mapping[tuple[str, int], float]  # true values by name and joint from 1


@one_blas_thread
def sealed_edits(
    runs: Mapping[str, Sequence[str]], diagnosis: str, plant: PlantSpec, store: Path
) -> tuple[Edit, ...]:
    """Take each effect that was rightly named out of the model, and ask the arm.

    The arm without that effect, and with whatever else it hides, follows the reference
    of the first held-out run.
    """
    verdict = read_verdict(store, diagnosis)
    manifest = read_manifest(store, runs["held_out"][0])
    dof = load(manifest["robot"]).dof
    named = [
        (effect, place)
        for effect in plant.effects
        for place in [Place(effect.name, _joints(effect, dof))]
        if is_named(place, verdict)
    ]
    if not named:
        return ()
    models = {k: m for k, m in read_models(store, diagnosis).items() if k != "plsr"}
    fit = [read_run(store, id) for id in runs["fit"]]
    out = []
    models["dense"] = dense_model(models["nominal"], fit)
    for effect, place in named:
        others = tuple(e for e in plant.effects if e is not effect)
        arm = replace(plant, effects=others)
        models["oracle"] = truth_of(manifest, arm, models["augmented"])
        out.append(sealed_edit(place, models, [_simulated(manifest, arm)]))
    return tuple(out)


def is_named(place: Place, verdict: Verdict) -> bool:
    """Whether a verdict names an effect by its very name, on all of its joints."""
    return any(
        found.name == place.name and set(place.joints) <= set(found.joints)
        for found in verdict.effects
    )


def with_truth(
    like: Model, body: pin.Model, drives: Drives, effects: Sequence[PlantEffect]
) -> Model:
    """Return a model with the true parameters of an arm.

    Args:
        like: A model of the arm, for its signals and its declared effects.
        body: The true rigid body, loads and changed links included.
        drives: True friction and rotors, changes included.
        effects: What the arm has; those of bodies and drives are in the others, and
            those without a name no model can have.
    """
    terms = [
        replace(t, theta=np.array([drives[t.effect.name, t.joints[0] + 1]]))
        for t in like.terms
        if t.nominal is not None and (t.effect.name, t.joints[0] + 1) in drives
    ]
    for effect in effects:
        what = kinds()[effect.name]
        if what.named and what.body is None and not what.of_drive:
            terms.append(_term(effect, like))
    inertial = inertial_parameters(body)
    return replace(like, inertial=inertial, terms=tuple(terms), tables=())


def changed_drives(base: Drives, effects: Sequence[PlantEffect]) -> Drives:
    """Return friction and rotors with what effects change of them."""
    out = dict(base)
    for effect in effects:
        what = kinds()[effect.name]
        for joint in effect.joints if what.of_drive else ():
            out[effect.name, joint] += dict(effect.parameters)[what.amount[0]]
    return out


def _term(effect: PlantEffect, like: Model) -> Term:
    known = registry()[effect.name]
    p = {**kinds()[effect.name].defaults, **dict(effect.parameters)}
    numbers = np.array([float(p[key]) for key in known.parameters])
    theta, shape = known.from_values(numbers, like.robot)
    joints = tuple(j - 1 for j in effect.joints)
    return Term(known, joints, tuple(shape), np.asarray(theta, dtype=float))


def truth_of(manifest: Mapping, plant: PlantSpec, like: Model) -> Model:
    """Return the true model of a simulated arm; arguments as of `with_truth`."""
    arm = build_arm(load(manifest["robot"]), plant)
    body = changed(arm.model, acting(plant.effects))
    base = {
        (name, j + 1): float(getattr(arm.base, str(what.of_drive))[j])
        for name, what in kinds().items()
        if what.of_drive
        for j in range(arm.robot.dof)
    }
    return with_truth(like, body, changed_drives(base, plant.effects), plant.effects)


def _simulated(manifest: Mapping, plant: PlantSpec) -> Recording:
    robot, spec = load(manifest["robot"]), manifest["spec"]
    rates = Rates(**spec["rates"])
    motion = TrajectorySpec.from_record(spec["trajectory"])
    reference = reference_of(robot, motion, rates.control)
    return run_experiment(robot, reference, plant, rates, spec["start"]).log


def _joints(effect: PlantEffect, dof: int) -> tuple[int, ...]:
    return reported_joints(effect.name, effect.joints, dof)
