"""Nights of an arm with a spring that its model lacks, for tests of the loop."""

from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from flows.requests import Diagnose
from flows.specs import parse_spec
from flows.steps import experiment
from flows.steps.diagnose import diagnose_stored_runs
from residual.check.result import LogCheck
from residual.robot.robot import load_robot

ROBOT = "irb140"
SPRING = {"name": "spring", "joints": [2], "stiffness": 60.0}
# Of families that need no search: they are planned at once.
FIT, HELD_OUT = ("cyclic", "move_stop_move", "cyclic"), ("cyclic",)
SECONDS = 5.0


def spec(kind, night, number, effects=(SPRING,)):
    motion = {"kind": kind, "duration": SECONDS, "periods": 1}
    return {
        "start": number * (SECONDS + 10.0),
        "trajectory": motion | {"seed": 100 * night + number},
        "plant": {"seed": 5, "effect": list(effects)},
        "rates": {"control": 500, "log": 125},
    }


# Of the arm of all nights, by the seed of its plant.
SERIAL = experiment.name_arm(parse_spec(spec("cyclic", 1, 0), "SPEC.toml"), load_robot(ROBOT))


def night(store, number, effects=(SPRING,)):
    ids = [
        experiment.simulate_and_store(
            parse_spec(spec(kind, number, i, effects), "SPEC.toml"), store
        )
        for i, kind in enumerate((*FIT, *HELD_OUT))
    ]
    return tuple(ids[: len(FIT)]), tuple(ids[len(FIT) :])


def unchecked():
    """Leave out the check of the logs, half of the time: they are sound."""
    return patch("flows.steps.check.check_logs", lambda *_: LogCheck(()))


def diagnosed(store, runs, model=None):
    fit, held_out = runs
    request = Diagnose(fit, robot=ROBOT, held_out=held_out, store=store, model=model)
    with unchecked():
        return diagnose_stored_runs(request)[0]


@dataclass(frozen=True)
class Nights:
    """A store, what was fitted and held out of two nights, and their diagnoses:

    of the first against the nominal model, of the second by the model of the first.
    """

    store: Path
    first: tuple
    second: tuple
    id: str
    again: str


def make_nights(store: Path) -> Nights:
    first, second = night(store, 1), night(store, 2)
    id = diagnosed(store, first)
    return Nights(store, first, second, id, diagnosed(store, second, id))
