"""A simulated run once more, from the open half of its spec and its sealed half."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from flows.specs.experiment import ExperimentSpec
from flows.steps.experiment import (
    Made,
    checked_robot,
    make,
    open_half,
    plant_of,
    sealed_half,
)
from residual.errors import InputError
from warehouse.ids import plain
from warehouse.robots import robot_word
from warehouse.runs import open_seal

_OTHER = (
    "its spec is of another version of this program than this one. Check out the "
    "commit that 'modelgap show' names."
)


def again(store: Path, run_id: str, manifest: Mapping) -> Made:
    """Run the experiment of a run once more; nothing is written.

    Raises:
        InputError: If its sealed half or its robot is not there, or it was made by a
            version of this program that wrote other specs.
    """
    hidden = open_seal(store, run_id).spec
    word = robot_word(store, manifest["robot"], manifest.get("robot_hash"))
    spec = spec_of({**manifest, "robot": word}, hidden)
    halves = plain(sealed_half(spec)), plain(open_half(spec, checked_robot(spec)))
    if halves != (hidden, manifest["spec"]):
        raise InputError(f"Run {run_id} cannot be made again: {_OTHER}")
    made = make(spec, store)
    return replace(made, manifest={**made.manifest, "robot": manifest["robot"]})


def spec_of(manifest: Mapping, hidden: Mapping) -> ExperimentSpec:
    """Return the spec of a run, all seeds given.

    Raises:
        InputError: If one of the two has another form.
    """
    plant = plant_of(hidden)
    effects = [
        {"name": e.name, "joints": e.joints, "onset": e.onset, **dict(e.parameters)}
        for e in plant.effects
    ]
    noise = {"torque": plant.noise.torque, "encoder": plant.noise.encoder}
    seeds = {"seed": plant.seed, "salt": plant.salt}
    used = {"background": plant.background, "worked_before": plant.worked_before}
    try:
        half = manifest["spec"]
        return ExperimentSpec.model_validate(
            {
                **{key: half[key] for key in ("schema", "seed", "start")},
                **{key: half[key] for key in ("trajectory", "rates")},
                "controller": half.get("controller", {}),
                "robot": manifest["robot"],
                "plant": {
                    **seeds,
                    **used,
                    "scatter": plant.scatter,
                    "noise": noise,
                    "effect": effects,
                },
            }
        )
    except (KeyError, TypeError, ValueError):
        pass
    # Outside, for the error has values of the sealed half in it.
    raise InputError(f"A run cannot be made again: {_OTHER}")
