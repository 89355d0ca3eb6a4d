"""The main job on logs that the program makes itself; the truth is shown last."""

import json
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from flows.steps import Request
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


def write_logs(request: DemoRequest) -> tuple[Request, Path]:
    """Write logs of the built-in arm with a hidden effect.

    Args:
        request: Which demonstration.

    Returns:
        What to diagnose, and the file that holds the truth.

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
    return asked, truth


def open_the_truth(asked: Request, truth: Path, console: Console) -> None:
    """Say what was hidden, and how to do the diagnosis again by hand.

    Args:
        asked: What was diagnosed.
        truth: The file that holds the truth.
        console: Where people read.
    """
    told = json.loads(truth.read_text(encoding="utf-8"))
    logs, held_out = " ".join(asked.logs), " ".join(asked.held_out)
    again = f"{logs} --robot {asked.robot} --holdout {held_out}"
    for line in (f"truth: {_words(told)}", f"again: modelgap diagnose {again}"):
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _words(truth: dict) -> str:
    joints = ", ".join(map(str, truth["joints"]))
    sizes = ", ".join(
        f"{key} {value:.4g}" for key, value in truth["parameters"].items()
    )
    where = f" on joint {joints}" if joints else ""
    return f"{truth['name']}{where} was hidden ({sizes})"
