"""The arm of a loop: what it hides is drawn, sealed, and looked at in the end."""

import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tomli_w
from cyclopts import Parameter

from flows.inputs.given import load
from flows.requests import Request, Store
from flows.specs.experiment import ExperimentSpec, derived_seed
from flows.steps.experiment import plant_of, sealed_half
from residual.effects import reported_joints
from residual.robot.robot import Robot
from sim.draw import draw_hidden
from sim.engine.records import HIDDEN, PlantEffect, stream
from warehouse import ids
from warehouse import runs as stored
from warehouse.commit import sealed_hash
from warehouse.runs import keep_robot, robot_folder

MOST = 3  # effects
PAUSE = 10.0  # s between experiments
_TRIES = 50  # to draw effects that are not one thing twice


@dataclass(frozen=True, slots=True)
class Close(Request):
    """Which loop goes from a simulated arm to an adopted model.

    Attributes:
        robot: Built-in name (irb140), URDF file, or folder; the arm is simulated.
        budget: How many experiments it may run; 3 to 100.
        seed: Seed of the arm, of what it hides, and of the motions.
        effects: How many effects to hide, 0 to 3; drawn from 1 to 3 without it.
        seconds: Length of a standard motion [s].
        designed: Whether what is open is settled by a designed motion.
        drives: Whether the arm is driven by what was adopted.
    """

    robot: str = "irb140"
    budget: int = 8
    seed: int = 7
    effects: int | None = None
    seconds: Annotated[float, Parameter(parse=False)] = 20.0
    store: Store = None
    designed: Annotated[bool, Parameter(parse=False)] = True
    drives: Annotated[bool, Parameter(parse=False)] = True

    @property
    def serial(self) -> str:
        """Serial number of its arm: it is one of many of its kind."""
        count = "" if self.effects is None else f"-{self.effects}"
        return f"close-{self.seed}{count}"


@dataclass(frozen=True, eq=False, slots=True)
class Arm:
    """A simulated arm with a serial number of its own.

    Attributes:
        robot: Its description, which everybody may read.
        word: Where that description is kept.
        plant: The sealed half of its experiments, as their file has it.
        seal: Hash of the sealed half: the promise that it stays the same arm.
    """

    robot: Robot
    word: str
    plant: dict
    seal: str


def make_arm(asked: Close, store: Path) -> Arm:
    """Draw an arm; the same request is the same arm.

    Raises:
        InputError: If there is no such robot.
    """
    word = _numbered(load(asked.robot), asked.serial, store)
    robot = load(word)
    plant = {
        "effect": [
            {"name": e.name, "joints": list(e.joints), **dict(e.parameters)}
            for e in _hidden(robot, asked)
        ],
        "seed": derived_seed(asked.seed, "close/plant"),
        "salt": f"{derived_seed(asked.seed, 'close/salt'):08x}",
    }
    spec = ExperimentSpec.model_validate({"robot": word, "plant": plant})
    return Arm(robot, word, plant, sealed_hash(sealed_half(spec)))


def loop_id(asked: Close, arm: Arm) -> str:
    """Return the id of a loop: that of its arm, its motions and its way to choose.

    The budget is no part of it: with a larger one the same loop goes on.
    """
    parts = arm.robot.content_hash, asked.seed, asked.effects, asked.seconds
    return ids.digest("close", *parts, asked.designed)[: ids.ID_DIGITS]


def open_seal(store: Path, run: str, dof: int) -> list[dict]:
    """Return what an arm hid, once its loop has ended.

    Returns:
        Name, joints as a verdict counts them, and parameters of each effect.
    """
    return [
        {
            "name": effect.name,
            "joints": list(reported_joints(effect.name, effect.joints, dof)),
            "parameters": dict(effect.parameters),
        }
        for effect in plant_of(stored.open_seal(store, run).spec).effects
    ]


def _hidden(robot: Robot, asked: Close) -> list[PlantEffect]:
    """Draw what the arm hides; no effect twice on one joint."""
    rng = stream(asked.seed, HIDDEN)
    count = asked.effects
    if count is None:
        count = int(rng.integers(1, MOST + 1))
    made: dict[tuple, PlantEffect] = {}
    for _ in range(_TRIES):
        if len(made) == count:
            break
        one = draw_hidden(robot, rng)
        made.setdefault((one.name, one.joints), one)
    return list(made.values())


def _numbered(robot: Robot, serial: str, store: Path) -> str:
    """Keep a description with a serial number in the store, and return its folder."""
    content = json.loads(robot.toml)
    own = {**content.get("robot", {}), "name": robot.name, "serial": serial}
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / f"{robot.name}.urdf").write_text(robot.urdf, encoding="utf-8")
        text = tomli_w.dumps({**content, "robot": own})
        (Path(folder) / "robot.toml").write_text(text, encoding="utf-8")
        made = load(folder)
        keep_robot(store, folder, made)
    return str(robot_folder(store, made.content_hash))
