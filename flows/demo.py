"""The main job on logs that the program makes itself; the truth is shown last."""

import json
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from flows.steps import Progress, Request, diagnose
from residual.errors import InputError
from residual.names import check_name

ROBOT = "irb140"


@dataclass(frozen=True, slots=True)
class DemoRequest:
    """Which demonstration to run.

    Attributes:
        seed: Seed of motion, noise, and of the effect's joint and size.
        effect: Effect to hide.
        folder: Where logs, report and verdict go; made if it is not there.
    """

    seed: int
    effect: str
    folder: Path


def demo(
    request: DemoRequest, console: Console, progress: Progress | None = None
) -> None:
    """Write logs with a hidden effect, diagnose them, then tell what was hidden.

    Args:
        request: Which demonstration.
        console: Where people read.
        progress: Told the stage and the fraction done.

    Raises:
        InputError: If there is no such effect or seed, or the folder cannot be used.
    """
    # Late: the synthetic arm is compiled when it is loaded.
    from sim.synthetic.demo import write_demo
    from sim.synthetic.effects import ADDITIVE, NOT_ADDITIVE

    check_name(request.effect, (*ADDITIVE, *NOT_ADDITIVE), "effect to hide")
    if request.seed < 0:
        raise InputError(f"--seed is {request.seed}, expected 0 or more.")
    folder = request.folder
    try:
        *logs, truth = write_demo(folder, request.seed, request.effect)
    except OSError as error:
        raise InputError(
            f"Cannot write to --folder {folder}: {error.strerror}."
        ) from error
    *fit, held_out = map(str, logs)
    asked = Request(
        logs=tuple(fit),
        robot=ROBOT,
        held_out=(held_out,),
        report=str(folder / "report.html"),
        json=str(folder / "verdict.json"),
    )
    diagnose(asked, console, progress)
    told = json.loads(truth.read_text(encoding="utf-8"))
    again = f"{' '.join(fit)} --robot {ROBOT} --holdout {held_out}"
    for line in (f"truth: {_words(told)}", f"again: modelgap diagnose {again}"):
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _words(truth: dict) -> str:
    joints = ", ".join(map(str, truth["joints"]))
    sizes = ", ".join(
        f"{key} {value:.4g}" for key, value in truth["parameters"].items()
    )
    where = f" on joint {joints}" if joints else ""
    return f"{truth['name']}{where} was hidden ({sizes})"
