"""Group errors: those of the paper's table 1 on a frozen set.

The frozen set: IRB 140 whose gears stick (Fs = 1.5 Fc, 0.05 rad/s), pull harder one way
(10 % of Fc) and under load (5 %), torque noise 1 % of range; six runs of 20 s, two
periods each. The twin knows rigid body and rotors alone, or friction as well.
"""

from dataclasses import replace
from functools import cache

import numpy as np

from benchmarks.figures import Figures, figure, missing
from benchmarks.plsr_parts.measured import NOT_WORSE, over_none, rounded
from residual.calibration.calibrate import Calibration, Settings, calibrate
from residual.calibration.methods import DEFAULT, LS, PAPER_FORM
from residual.calibration.rows import Run
from residual.calibration.scores import RANDOM, RUN, find
from residual.robot.robot import Robot, load_robot
from sim.experiment import run_experiment
from sim.plant import tables as at
from sim.records import Noise, PlantEffect, PlantSpec, Rates, TrajectorySpec
from sim.trajectories import make_reference
from sim.twin import twin_of

HALF = 0.5
BARS = (
    ("paper_form_over_ls_random", HALF),
    ("paper_form_over_ls_unseen", 1.0),
    ("default_over_ls_unseen", HALF),
    ("paper_declared_default_over_none", NOT_WORSE),
)
_SEED = 2017
_FAMILIES = (*2 * ("fourier",), *2 * ("move_stop_move",), *2 * ("cyclic",))


def paper_set_figures(quick: bool) -> Figures:
    """Return the figures of the frozen set.

    Args:
        quick: Whether to leave all of them to the full run: six runs take a minute, and
            fewer do not show what more of them do.
    """
    if quick:
        return {name: missing(bar, "the full run measures it") for name, bar in BARS}
    out = _frozen_figures(_calibrated(frozen_runs(0)))
    out["paper_declared_default_over_none"] = over_none(_calibrated(frozen_runs(1)))
    return out


def frozen_runs(side: int) -> list[Run]:
    """Return the six runs, against a twin without friction (0) or with it (1)."""
    return [_simulated(number)[side] for number in range(len(_FAMILIES))]


def _calibrated(runs: list[Run]) -> Calibration:
    return calibrate(_robot(), runs, Settings(paper=True, views=False))


@cache
def _simulated(number: int) -> tuple[Run, Run]:
    """One run, against a twin without friction and against one with it."""
    robot, family = _robot(), _FAMILIES[number]
    rates = Rates()
    spec = TrajectorySpec(family, 20.0, 2, _SEED + number)
    reference = make_reference(robot, spec, rates.control)
    made = run_experiment(robot, reference, _plant(robot), rates, 30.0 * number)
    log = replace(made.log, id=f"{family} {number + 1}")
    every = round(rates.control / rates.log)
    drive = twin_of(_without_friction(robot), reference).rows[::every, at.DRIVE]
    bare = Run(log, family, {"e_tau": log.tau - drive[: len(log.t)]})
    return bare, Run(log, family, made.twin)


def _without_friction(robot: Robot) -> Robot:
    """The arm whose friction is declared to be nothing; left out, it would be usual."""
    nothing = {
        name: replace(robot.declared[name], values={key: np.zeros(robot.dof)})
        for name, key in (("coulomb", "level"), ("viscous", "coefficient"))
    }
    return replace(robot, declared={**robot.declared, **nothing})


def _plant(robot: Robot) -> PlantSpec:
    levels = np.asarray(robot.declared["coulomb"].values["level"])
    effects = []
    for joint, level in enumerate(levels, 1):
        sticks = (("level", 0.5 * level), ("velocity", 0.05))
        effects += [
            PlantEffect("stribeck", (joint,), sticks),
            PlantEffect("coulomb_asymmetry", (joint,), (("level", 0.1 * level),)),
            PlantEffect("load_friction", (joint,), (("coefficient", 0.05),)),
        ]
    return PlantSpec(tuple(effects), scatter=0.0, noise=Noise(torque=0.01), seed=_SEED)


def _frozen_figures(made: Calibration) -> Figures:
    """The paper's table 1, and what it does not show."""
    pairs = {
        "paper_form_over_ls_random": (RANDOM, PAPER_FORM, True),
        "paper_form_over_ls_unseen": (RUN, PAPER_FORM, False),
        "default_over_ls_unseen": (RUN, DEFAULT, True),
    }
    out = {}
    for name, (scheme, model, at_most) in pairs.items():
        one, ls = find(made.scores, scheme, model), find(made.scores, scheme, LS)
        ratios = one.rmsev / ls.rmsev
        told = {"ratios": rounded(ratios), "percent": rounded(one.rmsev)}
        told |= {"ls_percent": rounded(ls.rmsev), "components": one.components}
        told["together"] = round(one.overall / ls.overall, 4)
        if at_most:
            out[name] = figure(float(ratios.max()), HALF, len(ratios), **told)
            continue
        # It must be seen to fail: the joint where it fails least.
        value = float(ratios.min())
        told |= {"ok": value > 1, "at_least": True}
        out[name] = figure(value, 1.0, len(ratios), **told)
    return out


@cache
def _robot() -> Robot:
    return load_robot("irb140")
