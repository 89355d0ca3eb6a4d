"""The main job on an arm of our own, as plain steps: ids in, ids out.

An arm hides one effect from its model. Six experiments are run on it and two more that
no fit will see; they are stored, diagnosed from the store, and reported; only then is
the seal opened.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from flows.errors import RunError
from flows.keep.diagnosis import read_outcome, store_report
from flows.specs.experiment import ExperimentSpec, derived_seed
from flows.steps import study
from flows.steps.diagnose import verdict_json
from flows.steps.experiment import plan
from flows.workers.campaign import Tell, run_all
from flows.workers.pool import Here, Pool
from residual.effects import reported_joints
from residual.errors import InputError
from residual.robot.robot import load_robot

ROBOT = "irb140"
NOTHING = "none"  # as --effect: hide nothing
FIT = (*2 * ("fourier",), *2 * ("cyclic",), *2 * ("move_stop_move",))
HELD_OUT = ("welding", "fourier")  # of another family, and of one that was fitted
DURATION, PAUSE = 20.0, 10.0  # s
CLIP = 6.0  # s of motion in the picture

Runs = dict[str, list[str]]


@dataclass(frozen=True, slots=True)
class Asked:
    """Which demonstration.

    Attributes:
        seed: Seed of everything: arm, effect, motions, noise.
        effect: Effect to hide; None to draw it, "none" to hide nothing.
    """

    seed: int
    effect: str | None = None


def specs(asked: Asked) -> list[tuple[str, ExperimentSpec]]:
    """Return the experiments: those to fit, then those held out.

    All are on one arm and in one session, one after the other with pauses.

    Raises:
        InputError: If there is no such effect or seed.
    """
    if not 0 <= asked.seed < 2**63:
        raise InputError(f"--seed is {asked.seed}, expected 0 or more.")
    plant = {
        "effect": _hidden_effect(asked),
        "seed": derived_seed(asked.seed, "plant"),
        "salt": f"{derived_seed(asked.seed, 'salt'):08x}",
    }
    made = []
    for i, kind in enumerate((*FIT, *HELD_OUT)):
        motion = {
            "kind": kind,
            "duration": DURATION,
            "seed": derived_seed(asked.seed, f"reference/{i}"),
        }
        content = {
            "robot": ROBOT,
            "seed": asked.seed,
            "start": i * (DURATION + PAUSE),
            "trajectory": motion,
            "plant": plant,
        }
        made.append((kind.replace("_", "-"), ExperimentSpec.model_validate(content)))
    return made


def run_experiments(
    asked: Asked, store: Path, tell: Tell | None = None, pool: Pool | Here | None = None
) -> Runs:
    """Run the experiments that are not in the store.

    Returns:
        Ids of the runs by role: fit and held_out.

    Raises:
        RunError: If one of them failed.
    """
    summary = run_all(plan(specs(asked), store), store, tell, pool)
    if summary.failures:
        first = summary.failures[0]
        raise RunError(f"Experiment {first.planned.label} failed: {first.why}")
    ids = [p.run_id for p in summary.planned]
    return {"fit": ids[: len(FIT)], "held_out": ids[len(FIT) :]}


def diagnose(runs: Runs, store: Path, tell: Tell | None = None) -> tuple[str, str]:
    """Diagnose the runs from the store and put the verdict there.

    Returns:
        The ids of the diagnosis and of its proof.
    """
    asked = study.Study(ROBOT, tuple(runs["fit"]), tuple(runs["held_out"]))
    return study.diagnose(asked, store, tell)


def open_seal(runs: Runs, store: Path) -> list[dict]:
    """Return what the arm had and its model was not told of.

    Returns:
        Name, joints and parameters of each effect, as JSON can hold it.
    """
    from warehouse import seal

    dof = load_robot(ROBOT).dof
    found = seal.open_seal(store, runs["fit"][0]).spec["effects"]
    return [
        {
            "name": effect["name"],
            "joints": list(reported_joints(effect["name"], effect["joints"], dof)),
            "parameters": dict(effect["parameters"]),
        }
        for effect in found
    ]


def report(ids: tuple[str, str], runs: Runs, hidden: list[dict], store: Path) -> Path:
    """Write the page and the verdict into the store.

    Args:
        ids: Of the diagnosis and of its proof.
        runs: Ids of the runs.
        hidden: What the seal held.
        store: The store.

    Returns:
        The page.
    """
    from flows.report.page.diagnosis import render
    from flows.report.words.staged import Staged

    found = read_outcome(store, ids[1])
    gif = picture(runs["fit"][0], store)
    caption = f"The first {CLIP:g} s of run {runs['fit'][0]}, in the physics engine."
    staged = Staged(gif, caption, as_hidden(hidden), found.verdict)
    files = {
        "report.html": render(found, ROBOT, staged).encode(),
        "verdict.json": verdict_json(found.verdict).encode(),
        "truth.json": (json.dumps(hidden, indent=2) + "\n").encode(),
        "arm.gif": gif,
    }
    folder = store_report(store, {"robot": ROBOT, "kind": "demo"}, ids[0], files)
    return folder / "report.html"


def headline(proof: str, store: Path) -> str:
    """Return a stored verdict in a few sentences."""
    from flows.report.words.verdict import sentences

    return " ".join(sentences(read_outcome(store, proof).verdict))


def picture(run_id: str, store: Path) -> bytes:
    """Return a GIF of the arm along the first seconds of a run."""
    from sim.engine.render import gif_of
    from warehouse.runs import read_run

    run = read_run(store, run_id)
    rows = run.t - run.t[0] <= CLIP
    return gif_of(load_robot(ROBOT), run.t[rows], run.q[rows])


def as_hidden(found: Sequence[Mapping]) -> tuple:
    """Return what a seal held as the report takes it."""
    from flows.report.words.staged import Hidden

    return tuple(
        Hidden(e["name"], tuple(e["joints"]), dict(e["parameters"])) for e in found
    )


def _hidden_effect(asked: Asked) -> list[dict]:
    from sim.experiment import draw_hidden
    from sim.streams import HIDDEN, stream

    if asked.effect == NOTHING:
        return []
    rng = stream(asked.seed, HIDDEN)
    effect = draw_hidden(load_robot(ROBOT), rng, asked.effect)
    return [
        {"name": effect.name, "joints": list(effect.joints), **dict(effect.parameters)}
    ]
