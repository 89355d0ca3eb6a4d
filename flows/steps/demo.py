"""Demonstrate a diagnosis on a simulated arm; each step takes and returns ids.

An arm hides one effect from its model, large enough to show on its motions
(`visible.json`). Six experiments are run on it and two more that no fit will see; they
are stored, diagnosed from the store, and reported; only then is the seal opened.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path

from flows.inputs import load_command_robot
from flows.outputs import Progress
from flows.specs import ExperimentSpec, derive_seed
from flows.steps.experiment import (
    Runs,
    parse_sealed_plant,
    plan_experiments,
    run_campaign_experiments,
)
from residual.effects import number_reported_joints
from residual.errors import InputError, RunError, check_name
from sim.engine.plant_records import BACKGROUNDS, CLEAN, HIDDEN, create_random_stream
from sim.plant.effect_catalogue import check_effect_name
from sim.plant.typical_sizes import draw_plant_effect
from sim.trajectories.excitation import draw_slow_coefficients
from warehouse import store_catalogue as stored

ROBOT = "irb140"
NOTHING = "none"  # as --effect: hide nothing
SLOW = "slow"  # a Fourier motion that creeps: some friction is there alone
FIT = (*2 * ("fourier",), "cyclic", SLOW, *2 * ("move_stop_move",))
HELD_OUT = ("welding", "fourier")  # of another family, and of one that was fitted
DURATION, PAUSE = 20.0, 10.0  # s
CREEP = 0.2  # rad/s that no joint of the slow motion exceeds


def build_demo_specs(
    seed: int, effect: str | None = None, background: str = CLEAN
) -> list[tuple[str, ExperimentSpec]]:
    """Return the experiments: those to fit, then those held out.

    All are on one arm and in one session, one after the other with pauses.

    Args:
        seed: Of the arm, the motions, the noise, and of what is hidden.
        effect: What is hidden; None to draw it, "none" for nothing.
    """
    if not 0 <= seed < 2**63:
        raise InputError(f"--seed is {seed}, expected 0 or more.")
    check_name(background, BACKGROUNDS, "background")
    plant = {
        "effect": _hidden_effect(seed, effect),
        "background": background,
        "seed": derive_seed(seed, "plant"),
        "salt": f"{derive_seed(seed, 'salt'):08x}",
    }
    experiments = []
    for kind, start, motion in generate_motion_tables(seed, (*FIT, *HELD_OUT)):
        content = {
            "robot": ROBOT,
            "seed": seed,
            "start": start,
            "trajectory": motion,
            "plant": plant,
        }
        experiments.append((kind.replace("_", "-"), ExperimentSpec.model_validate(content)))
    return experiments


def run_experiments(
    specs: Sequence[tuple[str, ExperimentSpec]], store: Path, progress: Progress | None = None
) -> Runs:
    """Run the experiments that are not in the store."""
    planned = plan_experiments(specs, store)
    summary = run_campaign_experiments(planned, store, progress)
    for why in summary.failed.values():
        raise RunError(f"An experiment failed: {why}")
    ids = [p.run_id for p in summary.planned]
    return {"fit": ids[: len(FIT)], "held_out": ids[len(FIT) :]}


def read_hidden_effects(runs: Runs, store: Path) -> list[dict]:
    """Return name, joints and parameters of each effect that the arm hid."""
    dof = load_command_robot(ROBOT).dof
    plant = parse_sealed_plant(stored.open_seal(store, runs["fit"][0]).spec)
    return [
        {
            "name": effect.name,
            "joints": list(number_reported_joints(effect.name, effect.joints, dof)),
            "parameters": dict(effect.parameters),
        }
        for effect in plant.effects
    ]


def generate_motion_tables(
    seed: int, families: tuple[str, ...]
) -> Iterator[tuple[str, float, dict]]:
    """Yield the name of each motion, its start [s], and its table."""
    for i, kind in enumerate(families):
        drawn = derive_seed(seed, f"reference/{i}")
        motion: dict = {"kind": kind, "duration": DURATION, "seed": drawn}
        if kind == SLOW:
            rng = create_random_stream(drawn, f"trajectory/{SLOW}")
            slow = draw_slow_coefficients(load_command_robot(ROBOT), DURATION, CREEP, rng)
            motion |= {"kind": "fourier", "periods": 1, "coefficients": slow}
        yield kind, i * (DURATION + PAUSE), motion


def _hidden_effect(seed: int, name: str | None) -> list[dict]:
    """Draw an effect that is detectable on the fitted motions.

    Its size is typical, or as large as needed to be detectable. Beyond the last seed of
    the table the seeds repeat, unless the effect is detectable at every one.
    """
    if name == NOTHING:
        return []
    if name is not None:
        check_effect_name(name)
    entry = list_visible_sizes().get(name or "")
    if entry and entry["larger"]:
        seed %= entry["seeds"]
        if larger := entry["larger"].get(str(seed)):
            effect, joints, values = larger
            return [{"name": effect, "joints": joints, **dict(sorted(values.items()))}]
    effect = draw_plant_effect(load_command_robot(ROBOT), create_random_stream(seed, HIDDEN), name)
    return [{"name": effect.name, "joints": list(effect.joints), **dict(effect.parameters)}]


@cache
def list_visible_sizes() -> Mapping[str, dict]:
    """Return the effects whose typical size would not be detectable.

    By the requested effect ("" for none) and by seed: effect, joints and
    parameters. Made by `tests/synthetic/visible.py`.
    """
    return json.loads(Path(__file__).with_name("visible.json").read_text("utf-8"))
